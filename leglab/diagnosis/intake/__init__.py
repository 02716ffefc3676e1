"""Recordings come in: what is admitted, one grid for all, encoders unwrapped, remarks."""
