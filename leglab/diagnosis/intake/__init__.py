"""Intake of recordings: admission, a common time grid, unwrapped encoders, remarks."""
