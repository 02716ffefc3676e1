"""Sweeps: many runs from one file, resumable, on this machine's processes or on a Dask cluster."""
