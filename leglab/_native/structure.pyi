"""Free runs from many starts; the front-end checks what it passes."""

from collections.abc import Sequence
from typing import Any

from numpy import float64, int64
from numpy.typing import NDArray

Array = NDArray[float64]

class StateRuns:
    """A state-space model, the argument of a further curve or none (empty), and segments.

    Of each segment inputs, outputs, and the sample at which it begins in these. The parameters
    theta are followed by the starts of all segments.
    """

    def __init__(
        self, settings: Any, segments: list[tuple[Array, Array, int]], further: Array
    ) -> None: ...
    def states(self, theta: Array) -> Array: ...
    def sums(self, theta: Array, sensitivities: bool) -> tuple[float, int, Array, Array]: ...

class Runs:
    """A model, further features, and one record."""

    def __init__(self, settings: Any, further: Sequence[Any], u: Array, y: Array) -> None: ...
    @property
    def depth(self) -> int: ...
    def sums(
        self, theta: Array, starts: NDArray[int64], lengths: NDArray[int64], sensitivities: bool
    ) -> tuple[float, int, Array, Array, Array]: ...
