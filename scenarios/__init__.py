"""Scenarios, one a file, by name."""
