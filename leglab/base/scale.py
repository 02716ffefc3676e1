"""Magnitude of errors: root mean square, and a standard deviation that is robust to outliers."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

# The median of |x| times this is the standard deviation of normal x (Rousseeuw and Croux 1993).
_NORMAL = 1.4826


def rms(values: ArrayLike, axis: int | tuple[int, ...] | None = None) -> Any:
    """Computes the root mean square along axes, in the unit of the values; NaN without values.

    Args:
        values: Array of any shape.
        axis: Axes of the mean; None for all.

    Returns:
        A number for None, otherwise an array over the remaining axes.
    """
    values = np.asarray(values)
    if axis is None and not values.size:
        return float("nan")
    return np.sqrt(np.mean(np.square(values), axis=axis))


def deviation(errors: np.ndarray) -> float:
    """Estimates the standard deviation about zero from the median absolute value; 0 if empty."""
    return _NORMAL * float(np.median(np.abs(errors))) if np.size(errors) else 0.0
