"""Fixed questions: the paper's results, the plugin's physics, the diagnosis on blind cases."""
