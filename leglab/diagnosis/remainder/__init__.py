"""Learned remainder: a static map of the error that no effect explains, in model and words."""
