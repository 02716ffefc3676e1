"""Learned remainder: static forces and command offsets that no effect of the library explains."""
