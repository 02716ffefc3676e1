"""Studies: adaptation benchmark, replication of the paper, verification of the plugin's physics."""
