"""Ranges of a state (position, velocity ...) in which errors are largest."""

from collections.abc import Mapping

import numpy as np

EVERYWHERE = "everywhere alike"


def equally_filled(state: np.ndarray) -> list[np.ndarray]:
    """Divides points, sorted by state, into at most 20 equal bins; returns the indices per bin.

    Each bin has at least eight points, because fewer give no reliable mean.
    """
    count = min(20, state.size // 8)
    return np.array_split(np.argsort(state, kind="stable"), count) if count else []


def worst_region(error: np.ndarray, states: Mapping[str, tuple[np.ndarray, str]]) -> str:
    """Describes in words the range of a state in which an error, (samples,), is largest.

    The range is reported if the mean absolute error of a bin exceeds the overall mean by a third.
    It includes adjacent bins with over half of this excess. `states`: values, (samples,), and unit.
    """
    finite = np.isfinite([error, *(values for values, _ in states.values())]).all(axis=0)
    error = error[finite]
    overall = float(np.mean(np.abs(error))) if error.size else 0.0
    if overall <= 0.0:
        return EVERYWHERE
    values, unit = states["position"]
    if (period := _period(error, values[finite])) is not None:
        return f"repeating every {period:.3g} {unit} of the position"
    best, text = 4.0 / 3.0, EVERYWHERE
    for name, (values, unit) in states.items():
        values = values[finite]
        parts = equally_filled(values)
        if len(parts) < 3 or np.ptp(values) <= 0.0:
            continue
        size = np.array([np.mean(np.abs(error[part])) for part in parts]) / overall
        peak = int(np.argmax(size))
        if size[peak] <= best:
            continue
        small = np.flatnonzero(size <= 0.5 * (1.0 + size[peak]))
        first = max(small[small < peak], default=-1) + 1
        last = min(small[small > peak], default=len(parts)) - 1
        ends = np.quantile(values, [0.01, 0.99])  # so that outliers do not extend the range
        low = max(float(values[parts[first]].min()), float(ends[0]))
        high = min(float(values[parts[last]].max()), float(ends[1]))
        message = f"{low:.3g} to {high:.3g}{unit and ' '}{unit}"
        narrow = low <= 0.0 <= high and high - low < np.ptp(ends) / 3.0
        best, text = float(size[peak]), f"at a {name} of {message}"
        if narrow and name in ("velocity", "command"):
            text = f"near zero {name} ({message})"
    return text


def _period(error: np.ndarray, position: np.ndarray) -> float | None:
    """Returns the period over the position with which an error repeats; None if it does not.

    The period must fit into the range 2 to 8 times, and a sine must explain 1/3 of the variance.
    """
    low, high = np.quantile(position, [0.01, 0.99])
    span = float(high - low)
    centred = error - error.mean()
    power = float(centred @ centred)
    if span <= 0.0 or error.size < 200 or power <= 0.0:
        return None
    x = (position - low) / span
    smooth = np.vander(2.0 * x - 1.0, 4)
    rest = error - smooth @ np.linalg.lstsq(smooth, error, rcond=None)[0]
    grid = np.linspace(2.0, 8.0, 61)
    left = []
    for cycles in grid.tolist():
        waves = np.exp(2j * np.pi * cycles * x).view(float).reshape(-1, 2)
        fit = waves @ np.linalg.lstsq(waves, rest, rcond=None)[0]
        left.append(float((rest - fit) @ (rest - fit)))
    best = int(np.argmin(left))
    told = float(rest @ rest) - left[best] > power / 3.0
    return span / float(grid[best]) if told and 0 < best < grid.size - 1 else None
