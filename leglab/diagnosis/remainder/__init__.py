"""What no effect explains is learned: a static remainder, in the model and in words."""

from leglab.diagnosis.remainder.learning import Remainder, learn_remainder, memory_words
from leglab.diagnosis.remainder.part import Part, Period
from leglab.diagnosis.remainder.words import Described, Shape

__all__ = [
    "Described",
    "Part",
    "Period",
    "Remainder",
    "Shape",
    "learn_remainder",
    "memory_words",
]
