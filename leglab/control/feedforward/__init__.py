"""Adaptive feed-forward: the map from motion to valve command, learned while the machine moves."""
