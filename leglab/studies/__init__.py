"""Studies: adaptation benchmark and verification of the plugin's physics."""
