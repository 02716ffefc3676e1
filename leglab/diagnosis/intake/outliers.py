"""Samples that no motion explains: drop-outs to zero, single outliers, invalid first values."""

import numpy as np
from scipy.ndimage import percentile_filter

from leglab.diagnosis.intake.series import quantum
from leglab.diagnosis.thresholds import CERTAIN

# Window [samples] and percentile that define the usual step, which a few outliers do not change.
_NEAR, _MOST = 41, 80


def unsupported(samples: np.ndarray) -> np.ndarray:
    """Masks impossible samples of a signal with inertia, (n,), NaN where missing.

    These are single samples or runs of zeros to which the signal jumps and from which it returns,
    and first values from which it jumps away. A jump is a step many times larger than both the
    usual steps nearby and the quantisation step. Impacts are kept, because they reverse a motion
    by steps of the usual size. Commands may jump and therefore must not be passed.
    """
    good = np.flatnonzero(np.isfinite(samples))
    found = np.zeros(samples.size, dtype=bool)
    values = samples[good]
    if good.size < _NEAR or not np.ptp(values):
        return found
    steps = np.diff(values)
    sizes = np.abs(steps)
    usual = percentile_filter(sizes, _MOST, size=_NEAR, mode="nearest")
    least = max(quantum(values), float(np.median(sizes[sizes > 0.0])))
    far = sizes > CERTAIN * np.maximum(usual, least)
    zeros = np.flatnonzero((values[:-1] == 0.0) & (values[1:] != 0.0))
    for start in np.flatnonzero(far).tolist():  # an outlier begins after this step
        if found[good[start]]:
            continue
        end = start + 1
        if values[end] == 0.0 and zeros.size and zeros[-1] >= end:
            end = int(zeros[np.searchsorted(zeros, end)])
        if end < steps.size and far[end] and steps[end] * steps[start] < 0.0:
            found[good[start + 1 : end + 1]] = True
    first = int(np.argmax(steps != 0.0))
    if first < _NEAR and far[first] and not found[good[first + 1]]:
        found[good[: first + 1]] = True
    return found


def alternates(samples: np.ndarray) -> bool:
    """Tests whether every other sample of a signal, (n,), belongs to another signal.

    In this case steps between neighbours mostly alternate in sign, and are many times larger than
    the differences over two samples and the quantisation step.
    """
    values = samples[np.isfinite(samples)]
    if values.size < _NEAR:
        return False
    steps = np.diff(values)
    turns = float(np.mean(steps[1:] * steps[:-1] < 0.0))
    across = float(np.median(np.abs(values[2:] - values[:-2])))
    usual = max(across, quantum(values[::2]))
    return turns > 0.9 and float(np.median(np.abs(steps))) > CERTAIN * usual > 0.0
