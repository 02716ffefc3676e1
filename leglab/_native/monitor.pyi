"""Sums of learned samples, fits of a bank of faults, and the monitor that notices changes."""

from typing import Any

from numpy import float64
from numpy.typing import NDArray

Array = NDArray[float64]

class Moments:
    """Sums over learned samples of all joints that least squares needs.

    Attributes:
        information: Sums of regressor times regressor, (joints, parameters, parameters).
        correlation: Sums of regressor times output, (joints, parameters).
        power: Sums of squared outputs, (joints,).
        count: Samples, (joints,).

    Raises:
        ValueError: There is no joint or no parameter.
    """

    def __init__(self, joints: int, parameters: int) -> None: ...
    @property
    def information(self) -> Array: ...
    @property
    def correlation(self) -> Array: ...
    @property
    def power(self) -> Array: ...
    @property
    def count(self) -> Array: ...
    def add(self, samples: Array) -> None:
        """Adds samples as `AdaptiveFeedforward.kept` gives them, (n, joints, parameters + 3).

        Raises:
            ValueError: They have another shape.
        """

    def about(self, parameters: Array) -> Moments:
        """The sums with what a map of these (joints, parameters) predicts taken off the outputs.

        Raises:
            ValueError: The parameters have another shape.
        """

    def weight(self, normal: Array, discrepancy: float) -> Array:
        """Weights of squared errors by those that are normal and the share that a fault leaves.

        Both arrays are (joints,): 1 / (normal + discrepancy^2 times the mean square output).
        """

def chances(
    cost: Array, keys: list[int], correlation: float, independent: float, noise: float
) -> Array:
    """Probability of every key by the costs that have it, (keys,); see csrc/monitor/fault_fit.h.

    Raises:
        ValueError: Costs and keys differ in number, or a key is negative.
    """

class Bank:
    """Curves of faults: of each its sizes and shifts (sizes, joints, parameters).

    Raises:
        ValueError: Shapes do not fit.
    """

    def __init__(self, sizes: list[Array], shifts: list[Array]) -> None: ...
    def fit(
        self, moments: Moments, normal: Array, discrepancy: float, joint: int = -1
    ) -> tuple[Array, Array, Array, float, float]:
        """Sizes, spreads and costs, (curves,), and the costs without any fault and of noise.

        Raises:
            ValueError: The moments are of another size.
        """

class Monitor:
    """Notices a change and sums up its samples.

    `settings` has the fields of `MonitorSettings` in csrc/monitor/fault_monitor.h.
    """

    def __init__(self, joints: int, parameters: int, settings: dict[str, Any]) -> None: ...
    @property
    def open(self) -> bool: ...
    @property
    def onset(self) -> float: ...
    def reset(self, wait: float) -> None: ...
    def close(self, wait: float) -> None: ...
    def take(self, time: float, samples: Array, parameters: Array) -> bool:
        """Takes a block of samples and the map at its end; returns whether it opens a case."""

    def base(self) -> Array:
        """The map before the case, (joints, parameters)."""

    def normal(self) -> Array:
        """Mean square errors that are normal, (joints,)."""

    def look(self) -> Moments:
        """Sums of the case as they are now, about the base.

        Raises:
            ValueError: No case is open.
        """

    def regressors_before(self) -> Array:
        """Regressors of the blocks before the case's onset, (n, joints, parameters)."""

    def sum(self, samples: int = ...) -> bool:
        """Adds so many waiting samples of the case to its sums; returns whether none waits."""
