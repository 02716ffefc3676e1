"""Statistics that single values far off change little."""

import numpy as np

# The median of |x| times this is the standard deviation of normal x (Rousseeuw and Croux 1993).
_NORMAL = 1.4826


def deviation(errors: np.ndarray) -> float:
    """Standard deviation about zero by the median of the absolute values; 0 of none."""
    return _NORMAL * float(np.median(np.abs(errors))) if np.size(errors) else 0.0
