"""Learned remainder: a static map of the error that no effect explains, in model and words."""

from leglab.diagnosis.remainder.learning import Remainder, learn_remainder

__all__ = ["Remainder", "learn_remainder"]
