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

class Bank:
    """Curves of faults: of each its sizes, shifts (sizes, joints, parameters), and a key.

    Raises:
        ValueError: Shapes do not fit.
    """

    def __init__(self, sizes: list[Array], shifts: list[Array], keys: list[int]) -> None: ...
    def fit(self, moments: Moments, weight: Array, out: Array) -> float:
        """Writes size, spread and cost, (3, curves); returns the cost without any fault."""

    def chances(
        self, cost: Array, correlation: float, independent: float, noise: float, out: Array
    ) -> None:
        """Writes the probability of every key, (keys,); 0 independent errors count noise alone."""

class Monitor:
    """Notices a change, sums up its samples and fits a bank of faults to them.

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

    def seen(self) -> Moments:
        """Sums of the last look, about the base."""

    def regressors_before(self) -> Array:
        """Regressors of the blocks before the case's onset, (n, joints, parameters)."""

    def sum(self, samples: int = ...) -> bool:
        """Adds so many waiting samples of the case to its sums; returns whether none waits."""

    def begin_look(self, bank: Bank) -> None:
        """Begins to fit a bank to the sums as they are now.

        Raises:
            ValueError: No case is open, or the bank is of another size.
        """

    def look(self, curves: int = ...) -> bool:
        """Fits so many curves more; returns whether all are fitted."""

    def finding(self) -> tuple[float, float, Array, Array, Array, Array]:
        """Costs without any fault and of a machine that had not changed; all curves' results.

        Sizes, spreads and costs of all curves, (curves,), and chances of all keys, (keys,).

        Raises:
            ValueError: The look is not done.
        """
