"""Blind tests: recordings of machines with hidden effects, made without the effect classes."""
