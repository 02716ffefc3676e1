"""Moves of the search: each proposes sets to fit, with a reason."""
