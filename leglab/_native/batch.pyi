"""Types of the control periods of many machines, in threads.

Arrays are C-contiguous, with a row a machine; they are kept, and written in place.
"""

from collections.abc import Mapping
from typing import Any

from numpy import bool_, float64, int64
from numpy.typing import NDArray

Array = NDArray[float64]

class Batch:
    """Steps machines of one model, and measures them."""

    def __init__(
        self,
        *,
        machines: int,
        threads: int,
        timing: Mapping[str, float],
        qpos: NDArray[int64],
        dof: NDArray[int64],
        centre: Array,
        half: Array,
        pressures: NDArray[int64],
        supply: int,
        preview: NDArray[int64],
        out: Mapping[str, NDArray[Any]],
    ) -> None: ...
    def start(
        self,
        *,
        machine: int,
        model: int,
        data: int,
        noise: Array,
        shift: Array,
        lost: NDArray[bool_],
        pressure_noise: Array,
        position: Array,
        velocity: Array,
        acceleration: Array,
    ) -> None: ...
    def step(self, *, commands: Array, late: NDArray[bool_], rests: NDArray[bool_]) -> None: ...
    def measure(self, machine: int) -> None: ...
