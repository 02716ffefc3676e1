"""Types of what a closed loop does with arrays in every control period.

Objects keep the arrays that they are made with, all C-contiguous, and work in place.
"""

from typing import Any

from numpy import bool_, float64, int64
from numpy.typing import NDArray

Array = NDArray[float64]

class Readings:
    """Encoders that sample positions at one instant and are read later."""

    def __init__(
        self,
        *,
        positions: Array,
        joints: NDArray[int64],
        noise: Array,
        shift: Array,
        lost: NDArray[bool_],
        counts: int,
        gain: float,
        keep: float,
        position: Array,
        velocity: Array,
    ) -> None: ...
    def sample(self) -> None: ...
    def noisy(self, period: int, out: Array) -> None: ...
    def start(self) -> None: ...
    def read(self, period: int) -> None: ...

class Rows:
    """Copies values out of one array into the rows of another."""

    def __init__(self, source: Array, index: NDArray[int64], rows: Array) -> None: ...
    def take(self, row: int) -> None: ...

class Reports:
    """Copies arrays (size,) of a dictionary into rows (most, size), while it holds the same ones.

    Raises:
        ValueError: A value of the dictionary is no array of numbers, or rows do not fit.
    """

    def __init__(self, reports: dict[str, Array], rows: list[Array]) -> None: ...
    def take(self, reports: dict[str, Array], row: int) -> bool:
        """Writes a row; False, and nothing written, where the dictionary holds others."""

class Drives:
    """Writes commands, clipped to [-1, 1], into an array as centre + half x command."""

    def __init__(self, target: Array, centre: Array, half: Array) -> None: ...
    def send(self, command: Any) -> bool: ...
