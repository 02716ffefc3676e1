"""Figures and the page of a finished diagnosis."""
