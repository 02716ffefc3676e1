"""Moves of the search: each proposes sets of effects to fit, with a reason."""
