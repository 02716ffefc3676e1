"""Parts of the model-based adaptive controller; plain NumPy, no simulation."""
