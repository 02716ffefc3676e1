"""What no effect explains is learned: a static remainder, in the model and in words."""

from leglab.diagnosis.remainder.learning import Remainder, learn_remainder

__all__ = ["Remainder", "learn_remainder"]
