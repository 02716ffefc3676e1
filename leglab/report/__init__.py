"""Figures, films and pages of runs and diagnoses."""
