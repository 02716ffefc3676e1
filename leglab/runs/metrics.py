"""Tracking metrics of a run. Pure functions of arrays; errors in rad, times in s."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from leglab.base.errors import ModelError, RecordingError, SettingsError
from leglab.base.scale import rms
from leglab.base.scenario import Phase

# Tolerance for the rounding of time stamps, as a share of the sampling period.
_ROUNDING = 1e-6

# Number of samples that are processed at a time, so that intermediate results need little memory.
_BLOCK = 65536


def joint_rms(error: np.ndarray) -> np.ndarray:
    """Returns the root mean square over the samples, (joints,), of errors (n, joints)."""
    return np.asarray(rms(_samples(error), axis=0))


# Functions that map errors (n, joints) to a figure of each joint (joints,).
_FIGURES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "rms_rad": joint_rms,
    "peak_rad": lambda error: np.max(np.abs(error), axis=0),
    "p95_rad": lambda error: np.percentile(np.abs(error), 95, axis=0, overwrite_input=True),
}


def by_joint(
    figure: Callable[[np.ndarray], np.ndarray], values: np.ndarray, joints: Sequence[str]
) -> dict[str, float]:
    """Computes a figure by joint, and under "all" from the pooled samples of all joints.

    Args:
        figure: Function that maps samples (n, joints) to figures (joints,).
        values: Samples, (n, joints).
        joints: Names of the columns.
    """
    found = dict(zip(joints, figure(values).tolist(), strict=True))
    return {**found, "all": float(figure(values.reshape(-1, 1))[0])}


def phase_table(
    time: np.ndarray, error: np.ndarray, joints: Sequence[str], phases: Iterable[Phase]
) -> list[dict[str, Any]]:
    """Summarises the tracking error in each phase.

    Args:
        time: Sample times [s], increasing. Shape (n,).
        error: Tracking error [rad]. Shape (n, joints).
        joints: Names of the columns.
        phases: Time intervals of the run; the last interval includes its end.

    Returns:
        One dict per phase with `name`, `start`, `end` [s], and `rms_rad`, `peak_rad` and `p95_rad`
        (95th percentile), each by joint and under "all", which pools the samples of all joints.
        Phases that the run did not reach are left out; an unfinished phase ends at the last sample.

    Raises:
        LeglabError: Shapes do not match, or a joint is named "all".
    """
    error = _samples(error)
    if error.shape != (len(time), len(joints)):
        raise RecordingError(
            f"error has shape {error.shape}, {len(time)} samples of {len(joints)} joints need ",
            given=error.shape,
            allowed=f"({len(time)}, {len(joints)})",
        )
    if "all" in joints:
        text = "a joint named 'all' cannot be told from all joints: rename it"
        raise ModelError(text, given="all")
    table = []
    for phase, part in _parts(time, phases):
        # The last sample may be one period before the nominal end of the run.
        last, period = float(time[-1]), float(time[-1] - time[-2]) if len(time) > 1 else np.inf
        end = last if phase.end > last + 1.5 * period and part.stop == len(time) else phase.end
        row: dict[str, Any] = {"name": phase.name, "start": phase.start, "end": end}
        row |= {key: by_joint(figure, error[part], joints) for key, figure in _FIGURES.items()}
        table.append(row)
    return table


def usage_table(
    time: np.ndarray,
    command: np.ndarray,
    energy: np.ndarray,
    joints: Sequence[str],
    phases: Iterable[Phase],
) -> list[dict[str, Any]]:
    """Summarises the effort and energy of tracking in each phase.

    Args:
        time: Sample times [s], increasing. Shape (n,).
        command: Valve commands in [-1, 1]. Shape (n, joints).
        energy: Cumulative hydraulic energy drawn from the supply [J], NaN for a joint without a
            supply. Shape (n, joints).
        joints: Names of the columns.
        phases: Time intervals of the run; the last interval includes its end.

    Returns:
        One dict per phase with `effort` (RMS command), `valve_activity_per_s` (RMS rate of the
        command between samples [1/s]) and `energy_j` (drawn from the supply less returned to the
        tank [J], left out if no joint has a supply), each by joint and under "all": the RMS over
        all joints, and the sum of the energies. Phases as in `phase_table`. A difference between
        two samples counts to the phase of the later sample.
    """
    table = []
    for _, part in _parts(time, phases):
        start = max(part.start, 1)
        rates = np.zeros_like(command[:1])  # for a phase with only the first sample of the run
        if part.stop > start:
            rates = np.diff(command[start - 1 : part.stop], axis=0)
            rates /= np.diff(time[start - 1 : part.stop])[:, None]
        drawn = energy[part.stop - 1] - energy[start - 1]
        row = {
            "effort": by_joint(joint_rms, command[part], joints),
            "valve_activity_per_s": by_joint(joint_rms, rates, joints),
        }
        spent = {j: e for j, e in zip(joints, drawn.tolist(), strict=True) if not np.isnan(e)}
        if spent:
            row["energy_j"] = {**spent, "all": float(sum(spent.values()))}
        table.append(row)
    return table


def _parts(time: np.ndarray, phases: Iterable[Phase]) -> Iterator[tuple[Phase, slice]]:
    """Yields each phase that has samples, with their slice; the last phase includes its end."""
    phases = tuple(phases)
    for phase in phases:
        first = int(np.searchsorted(time, phase.start))
        end = int(np.searchsorted(time, phase.end, "right" if phase is phases[-1] else "left"))
        if first < end:
            yield phase, slice(first, end)


def sliding_rms(time: np.ndarray, error: np.ndarray, window: float) -> np.ndarray:
    """Computes the RMS error, all joints pooled, over the window that ends at each sample.

    A running sum makes the cost independent of the window length.

    Args:
        time: Sample times [s], increasing. Shape (n,).
        error: Tracking error [rad]. Shape (n, joints).
        window: Length of the window [s]: samples in (t - window, t] count.

    Returns:
        Windowed RMS error [rad], NaN if the window starts before the run. Shape (n,).

    Raises:
        LeglabError: The window is not positive.
    """
    if not window > 0:
        raise SettingsError(f"window {window!r} s must be ", given=window, allowed="positive")
    error = _samples(error)
    period = float(time[1] - time[0]) if len(time) > 1 else 0.0
    slack = _ROUNDING * period
    result = np.empty(len(time))
    # Extended precision: differences of sums over a long run shall resolve windows of small errors.
    # `total[i]` is the sum over all samples before sample number `begin + i`.
    total, begin = np.zeros(1, dtype=np.longdouble), 0
    for start in range(0, len(time), _BLOCK):
        part = slice(start, min(start + _BLOCK, len(time)))
        squares = np.mean(np.square(error[part]), axis=1, dtype=np.float64)
        first = np.searchsorted(time, time[part] - window + slack, side="right")
        sums = np.cumsum(np.append(total[-1], squares), dtype=np.longdouble)
        total, begin = np.append(total[first[0] - begin :], sums[1:]), int(first[0])
        last = np.arange(part.start, part.stop) + 1
        mean = np.maximum(total[last - begin] - total[first - begin], 0) / (last - first)
        result[part] = np.sqrt(mean)
    # The first sample in a window (t - window, t] is one period after the window's start.
    result[time - time[0] < window - (1 + _ROUNDING) * period] = np.nan
    return result


def settling_time(
    time: np.ndarray, windowed: np.ndarray, change: float, window: float, threshold: float
) -> float | None:
    """Computes the time after a change from which no later window exceeds a threshold.

    Args:
        time: Times at which windows end [s], increasing. Shape (n,).
        windowed: Windowed error; NaN without a full window. Shape (n,).
        change: Time of the change [s].
        window: Length of the windows [s].
        threshold: Threshold in the unit of the error.

    Returns:
        Time from the change to the start of the window that follows the last exceeding window [s];
        0 if no window exceeds the threshold, None if the last window of the run does.
    """
    exceeding = np.flatnonzero((time >= change) & (windowed > threshold))
    if exceeding.size == 0:
        return 0.0
    last = int(exceeding[-1])
    if last + 1 == len(time):
        return None
    return max(0.0, float(time[last + 1] - window - change))


def excess_error_area(
    time: np.ndarray, error: np.ndarray, change: float, window: float
) -> float | None:
    """Integrates the excess of the windowed error over its value before a change.

    A short high excess counts as much as a long low excess of the same area. Times at which the
    error is below its value before the change count as 0.

    Args:
        time: Sample times [s], increasing. Shape (n,).
        error: Tracking error [rad]. Shape (n, joints).
        change: Time at which the machine starts to change [s].
        window: Period of a stride [s].

    Returns:
        Area from the change to the end of the run [rad s], trapezoidal; None without a full window
        before the change, or without a sample after it.
    """
    windowed = sliding_rms(time, error, window)
    first = int(np.searchsorted(time, change))
    if first in (0, len(time)) or np.isnan(windowed[first - 1]):
        return None
    excess = np.maximum(windowed[first:] - windowed[first - 1], 0.0)
    return float(np.trapezoid(excess, time[first:]))


def _samples(error: np.ndarray) -> np.ndarray:
    """Returns the error as a float array of shape (n, joints), n >= 1, without NaN or infinity."""
    error = np.asarray(error, dtype=np.float64)
    if error.ndim != 2 or error.size == 0:
        text = f"error has shape {error.shape}, allowed is "
        raise RecordingError(text, given=error.shape, allowed="(n, joints) with n >= 1")
    finite = np.isfinite(error)
    if not finite.all():
        row, column = np.argwhere(~finite)[0]
        text = f"error, row {row}, joint {column}: {error[row, column]} is not "
        raise RecordingError(text, given=float(error[row, column]), allowed="finite")
    return error
