"""How well a run tracked its reference. Pure functions of arrays; errors in rad, times in s."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from leglab.base.errors import ModelError, RecordingError, SettingsError
from leglab.base.scale import rms
from leglab.base.scenario import Phase

# Share of a sampling period by which time stamps may be off through rounding.
_ROUNDING = 1e-6

# Samples that are taken together where intermediate results are larger than the samples.
_BLOCK = 65536


def joint_rms(error: np.ndarray) -> np.ndarray:
    """Returns the root mean square over the samples, (joints,), of errors (n, joints)."""
    return np.asarray(rms(_samples(error), axis=0))


# Of errors (n, joints), by joint.
_FIGURES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "rms_rad": joint_rms,
    "peak_rad": lambda error: np.max(np.abs(error), axis=0),
    "p95_rad": lambda error: np.percentile(np.abs(error), 95, axis=0, overwrite_input=True),
}


def by_joint(
    figure: Callable[[np.ndarray], np.ndarray], values: np.ndarray, joints: Sequence[str]
) -> dict[str, float]:
    """Returns a figure of samples by joint, and under "all" that of the samples of all joints.

    Args:
        figure: Of samples (n, joints), (joints,).
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
        phases: Parts of the run; the last one includes its end.

    Returns:
        One dict a phase with `name`, `start`, `end` [s], and `rms_rad`, `peak_rad` and `p95_rad`
        (95 % of the samples are no larger), each by joint and under "all", which pools the samples
        of all joints. A phase that the run did not reach is left out, one that it did not finish
        ends with the last sample.

    Raises:
        LeglabError: Shapes do not fit, or a joint is called "all".
    """
    error = _samples(error)
    if error.shape != (len(time), len(joints)):
        raise RecordingError(
            f"error has shape {error.shape}, {len(time)} samples of {len(joints)} joints need ",
            given=error.shape,
            allowed=f"({len(time)}, {len(joints)})",
        )
    if "all" in joints:
        told = "a joint named 'all' cannot be told from all joints: rename it"
        raise ModelError(told, given="all")
    table = []
    for phase, part in _parts(time, phases):
        # The end of a run may come a period after its last sample.
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
    """Summarises in each phase what tracking cost.

    Args:
        time: Sample times [s], increasing. Shape (n,).
        command: Valve commands in [-1, 1]. Shape (n, joints).
        energy: Hydraulic energy drawn since some time before [J], NaN for a joint that draws none
            from a supply. Shape (n, joints).
        joints: Names of the columns.
        phases: Parts of the run; the last one includes its end.

    Returns:
        One dict a phase with `effort` (RMS command), `valve_activity_per_s` (RMS rate of the
        command between samples [1/s]) and `energy_j` (drawn from the supply less given to the tank
        [J], left out where no joint draws any), each by joint and under "all": the RMS over all
        joints, and the sum of the energies.
        Phases as in `phase_table`. A difference belongs to the phase of its later sample.
    """
    table = []
    for _, part in _parts(time, phases):
        start = max(part.start, 1)
        rates = np.zeros_like(command[:1])  # of a phase that is no longer than the first sample
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
    """Yields each phase that has samples, and which they are; the last one includes its end."""
    phases = tuple(phases)
    for phase in phases:
        first = int(np.searchsorted(time, phase.start))
        end = int(np.searchsorted(time, phase.end, "right" if phase is phases[-1] else "left"))
        if first < end:
            yield phase, slice(first, end)


def sliding_rms(time: np.ndarray, error: np.ndarray, window: float) -> np.ndarray:
    """Returns the RMS error, all joints pooled, over the window that ends at each sample.

    Takes a running sum, so the cost does not grow with the window.

    Args:
        time: Sample times [s], increasing. Shape (n,).
        error: Tracking error [rad]. Shape (n, joints).
        window: Length of the window [s]: samples in (t - window, t] count.

    Returns:
        Windowed RMS error [rad], NaN where the window starts before the run. Shape (n,).

    Raises:
        LeglabError: The window is not positive.
    """
    if not window > 0:
        raise SettingsError(f"window {window!r} s must be ", given=window, allowed="positive")
    error = _samples(error)
    period = float(time[1] - time[0]) if len(time) > 1 else 0.0
    slack = _ROUNDING * period
    result = np.empty(len(time))
    # Extended precision: the sum over the whole run must not swamp a window of small errors.
    # `total` holds the sums of all samples before number `begin`, before the next one, and so on.
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
    # The first full window has its first sample a period after its beginning.
    result[time - time[0] < window - (1 + _ROUNDING) * period] = np.nan
    return result


def settling_time(
    time: np.ndarray, windowed: np.ndarray, change: float, window: float, threshold: float
) -> float | None:
    """Time from a change on from which no window that begins later exceeds a threshold.

    Args:
        time: Times at which windows end [s], increasing. Shape (n,).
        windowed: Windowed error; NaN where there is none. Shape (n,).
        change: [s].
        window: Length of the windows [s].
        threshold: In the unit of the error.

    Returns:
        [s], 0 where none exceeds it, None where the last window still does.
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
    """Integrates what the windowed error exceeds its value before a change by.

    How much a change costs in all: high and short as low and long. Times at which the error is
    below its value before do not make up for others.

    Args:
        time: Sample times [s], increasing. Shape (n,).
        error: Tracking error [rad]. Shape (n, joints).
        change: When the machine starts to change [s].
        window: One stride [s].

    Returns:
        Area from the change to the end of the run [rad s], trapezoidal; None where there is no full
        window before the change, or no sample from it on.
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
        told = f"error has shape {error.shape}, allowed is "
        raise RecordingError(told, given=error.shape, allowed="(n, joints) with n >= 1")
    finite = np.isfinite(error)
    if not finite.all():
        row, column = np.argwhere(~finite)[0]
        told = f"error, row {row}, joint {column}: {error[row, column]} is not "
        raise RecordingError(told, given=float(error[row, column]), allowed="finite")
    return error
