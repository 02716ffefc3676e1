"""Measurements and tuning on a machine before a controller runs on it."""
