"""Size of errors: root mean square, and a scale that single values far off change little."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

# The median of |x| times this is the standard deviation of normal x (Rousseeuw and Croux 1993).
_NORMAL = 1.4826


def rms(values: ArrayLike, axis: int | tuple[int, ...] | None = None) -> Any:
    """Root mean square along axes, in the unit of the values; NaN of none.

    Args:
        values: Any shape.
        axis: Over which the mean is taken; None for all values.

    Returns:
        A number; with axes an array of the remaining ones.
    """
    values = np.asarray(values)
    if axis is None and not values.size:
        return float("nan")
    return np.sqrt(np.mean(np.square(values), axis=axis))


def deviation(errors: np.ndarray) -> float:
    """Standard deviation about zero by the median of the absolute values; 0 of none."""
    return _NORMAL * float(np.median(np.abs(errors))) if np.size(errors) else 0.0
