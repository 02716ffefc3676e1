"""What an engineer measures and tunes on a machine before a controller runs on it."""
