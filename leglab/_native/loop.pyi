"""Types of what a closed loop does with arrays in every control period.

Objects keep the arrays that they are made with, all C-contiguous, and work in place.
"""

from typing import Any

from numpy import bool_, float64, int64
from numpy.typing import NDArray

class Readings:
    """Encoders that sample positions at one instant and are read later."""

    def __init__(
        self,
        *,
        positions: NDArray[float64],
        joints: NDArray[int64],
        noise: NDArray[float64],
        shift: NDArray[float64],
        lost: NDArray[bool_],
        counts: int,
        gain: float,
        keep: float,
        position: NDArray[float64],
        velocity: NDArray[float64],
    ) -> None: ...
    def sample(self) -> None: ...
    def noisy(self, period: int, out: NDArray[float64]) -> None: ...
    def start(self) -> None: ...
    def read(self, period: int) -> None: ...

class Rows:
    """Copies values out of one array into the rows of another."""

    def __init__(
        self, source: NDArray[float64], index: NDArray[int64], rows: NDArray[float64]
    ) -> None: ...
    def take(self, row: int) -> None: ...

class Valves:
    """Writes commands into an array, clipped to [-1, 1]."""

    def __init__(self, target: NDArray[float64]) -> None: ...
    def send(self, command: Any) -> bool: ...
