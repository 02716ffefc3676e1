"""Replay of short windows of the recordings by the model, from smoothed start states."""
