"""Windows of the recordings are replayed by the model from smoothed start states."""
