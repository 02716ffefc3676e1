"""Where errors are largest over a state, by the equally filled bins that the page draws."""

from collections.abc import Mapping

import numpy as np

BINS = 20
# Fewest points of a bin that says something.
FEWEST = 8
EVERYWHERE = "everywhere alike"
# A region counts where the error there exceeds the mean by this factor ...
_PEAK = 1.3
# ... and reaches as far as this share of the peak's excess over the mean.
_SHOULDER = 0.5
# A region that holds zero and is narrower than this share of the range is "near zero".
_NARROW = 0.35
# Outliers set no ends.
_OUTER = (0.01, 0.99)
# A force that repeats: cycles over the range, and share of the variance that it must explain.
_CYCLES = (2.0, 8.0)
_REPEATS = 0.3


def equally_filled(state: np.ndarray, bins: int = BINS) -> list[np.ndarray]:
    """Indices of the points of every bin, along the state; bins that are nearly empty go."""
    parts = np.array_split(np.argsort(state, kind="stable"), bins)
    return [part for part in parts if part.size >= FEWEST]


def worst_region(error: np.ndarray, states: Mapping[str, tuple[np.ndarray, str]]) -> str:
    """Where an error is largest, in words.

    Args:
        error: Shape (samples,).
        states: Values of the state, shape (samples,), and unit by name.
    """
    finite = np.isfinite(error)
    for values, _ in states.values():
        finite &= np.isfinite(values)
    error = error[finite]
    overall = float(np.mean(np.abs(error))) if error.size else 0.0
    if overall <= 0.0:
        return EVERYWHERE
    if "position" in states:
        values, unit = states["position"]
        period = _period(error, values[finite])
        if period is not None:
            return f"repeating every {period:.3g} {unit} of the position"
    best, text = _PEAK, EVERYWHERE
    for name, (values, unit) in states.items():
        values = values[finite]
        parts = equally_filled(values)
        if len(parts) < 3 or np.ptp(values) <= 0.0:
            continue
        size = np.array([np.mean(np.abs(error[part])) for part in parts]) / overall
        peak = int(np.argmax(size))
        if size[peak] <= best:
            continue
        first = last = peak
        limit = 1.0 + _SHOULDER * (size[peak] - 1.0)
        while first > 0 and size[first - 1] > limit:
            first -= 1
        while last + 1 < len(parts) and size[last + 1] > limit:
            last += 1
        outer = np.quantile(values, _OUTER)
        low = float(max(values[parts[first]].min(), outer[0]))
        high = float(min(values[parts[last]].max(), outer[1]))
        narrow = high - low < _NARROW * float(outer[1] - outer[0])
        best, text = float(size[peak]), _words(name, low, high, unit, narrow=narrow)
    return text


def _words(name: str, low: float, high: float, unit: str, *, narrow: bool) -> str:
    """A region: by its ends, or as near zero."""
    ends = f"{low:.3g} to {high:.3g}{unit and ' '}{unit}"
    if name in ("velocity", "command") and low <= 0.0 <= high and narrow:
        return f"near zero {name} ({ends})"
    return f"at a {name} of {ends}"


def _period(error: np.ndarray, position: np.ndarray) -> float | None:
    """Period over the position of what repeats in an error; None where nothing does."""
    low, high = np.quantile(position, _OUTER)
    span = float(high - low)
    centred = error - error.mean()
    power = float(centred @ centred)
    if span <= 0.0 or error.size < 10 * BINS or power <= 0.0:
        return None
    x = (position - low) / span
    smooth = np.vander(2.0 * x - 1.0, 4)
    rest = error - smooth @ np.linalg.lstsq(smooth, error, rcond=None)[0]

    def repeats(cycles: float) -> float:
        waves = np.stack([np.cos(2 * np.pi * cycles * x), np.sin(2 * np.pi * cycles * x)], axis=1)
        left = rest - waves @ np.linalg.lstsq(waves, rest, rcond=None)[0]
        return float(rest @ rest - left @ left) / power

    grid = np.linspace(*_CYCLES, 61)
    shares = [repeats(float(cycles)) for cycles in grid]
    best = int(np.argmax(shares))
    inside = 0 < best < grid.size - 1
    return span / float(grid[best]) if inside and shares[best] > _REPEATS else None
