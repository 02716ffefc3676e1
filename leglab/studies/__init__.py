"""Fixed questions: the paper's results, and the plugin's physics."""
