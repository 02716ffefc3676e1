"""Runs from settings to results: single closed loops with metrics and files, and sweeps of runs."""
