"""Measured series of one recording on a uniform grid, and the machine's channels in it."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_coeffs, savgol_filter

from leglab.diagnosis.machine import CYLINDER, Machine
from leglab.errors import LeglabError
from leglab.recording import Recording

# Further than this many periods from a true sample, a value on the grid is not measured.
_GAP = 1.5
_CHAMBERS = ("pressure_a", "pressure_b")
# Quartic over 21 samples for positions, quadratic over 5 for pressures: at 1 kHz they pass the
# motion of a leg and take noise to a third.
POSITION_FILTER = (21, 4)
PRESSURE_FILTER = (5, 2)


@dataclass(frozen=True, kw_only=True)
class Channel:
    """One measured output that a replay predicts.

    Attributes:
        column: Of the recordings.
        joint: That it belongs to.
        cylinder: Whose chamber it is; None for a position.
        chamber: "pressure_a" or "pressure_b"; None for a position.
    """

    column: str
    joint: str
    cylinder: str | None = None
    chamber: str | None = None

    @property
    def filter(self) -> tuple[int, int]:
        """Window length and order of the smoothing filter."""
        return PRESSURE_FILTER if self.chamber else POSITION_FILTER


@dataclass(frozen=True, kw_only=True)
class Series:
    """One recording, ready for replay.

    Attributes:
        name: Of its file.
        period: s.
        time: Shape (n,), s.
        columns: Samples on the grid by column, each (n,), gaps bridged linearly.
        valid: Where every channel was measured, shape (n,).
    """

    name: str
    period: float
    time: np.ndarray
    columns: dict[str, np.ndarray]
    valid: np.ndarray

    @classmethod
    def from_recording(cls, recording: Recording, name: str, needed: tuple[str, ...]) -> "Series":
        """Puts the needed columns of a recording on a uniform grid.

        Raises:
            LeglabError: The recording is too short to have a period.
        """
        if len(recording) < 3:
            raise LeglabError(f"{name}: {len(recording)} samples are too few to replay")
        intervals = np.diff(recording.time)
        period = float(np.median(intervals))
        # A clock that counts in whole samples of a rounded period: use the mean of usual intervals.
        usual = intervals[np.abs(intervals - period) < 0.5 * period]
        period = float(usual.mean())
        count = round(recording.duration / period) + 1
        grid = recording.time[0] + period * np.arange(count)
        valid = np.ones(count, dtype=bool)
        columns = {}
        for column in needed:
            good = np.isfinite(recording[column])
            if good.sum() < 2:
                raise LeglabError(f"{name}: column {column!r} holds no numbers")
            times = recording.time[good]
            columns[column] = np.interp(grid, times, recording[column][good])
            after = np.searchsorted(times, grid).clip(1, times.size - 1)
            distance = np.minimum(np.abs(grid - times[after - 1]), np.abs(times[after] - grid))
            near = np.maximum(times[after] - times[after - 1], 0.0)
            valid &= (near <= _GAP * period) | (distance < 1e-3 * period)
        return cls(name=name, period=period, time=grid, columns=columns, valid=valid)


def channels(machine: Machine, recordings: list[Recording]) -> tuple[Channel, ...]:
    """Measured outputs that all recordings share: positions, then chamber pressures.

    Raises:
        LeglabError: A joint's position or an actuator's command is missing; lists both sides.
    """
    shared = set(recordings[0].columns)
    for recording in recordings[1:]:
        shared &= set(recording.columns)
    wanted = [f"{joint}_position" for joint in machine.joints]
    wanted += [f"{actuator}_command" for actuator in machine.actuators]
    missing = [column for column in wanted if column not in shared]
    if missing:
        raise LeglabError(
            f"the recordings have no column {', '.join(map(repr, missing))}: the model needs "
            f"{', '.join(wanted)}; all recordings have {', '.join(sorted(shared))}. Measured under "
            "other names? Give a column map"
        )
    found = [Channel(column=f"{joint}_position", joint=joint) for joint in machine.joints]
    for cylinder in machine.instances(CYLINDER):
        joint = machine.driven[cylinder][0]
        for chamber in _CHAMBERS:
            if f"{joint}_{chamber}" in shared:
                found.append(
                    Channel(
                        column=f"{joint}_{chamber}", joint=joint, cylinder=cylinder, chamber=chamber
                    )
                )
    return tuple(found)


def noise_level(samples: np.ndarray, window: tuple[int, int]) -> float:
    """Standard deviation of white sensor noise, from what a smoothing filter leaves over.

    The filter keeps its centre coefficient c of each sample, so that white noise of variance s^2
    leaves s^2 (1 - c). The median makes jumps of the signal count little (Rousseeuw and Croux 1993).

    Args:
        samples: Shape (n,).
        window: Length and order of the Savitzky-Golay filter.
    """
    if samples.size < window[0]:
        return 0.0
    rest = samples - savgol_filter(samples, *window)
    centre = savgol_coeffs(*window)[window[0] // 2]
    return float(1.4826 * np.median(np.abs(rest)) / np.sqrt(1.0 - centre))


def smoothed(samples: np.ndarray, window: tuple[int, int]) -> np.ndarray:
    """Savitzky-Golay smoothing; series shorter than the filter stay as they are."""
    return savgol_filter(samples, *window) if samples.size >= window[0] else samples


def derivative(samples: np.ndarray, window: tuple[int, int], period: float) -> np.ndarray:
    """First derivative by the same filter."""
    if samples.size < window[0]:
        return np.gradient(samples, period)
    return savgol_filter(samples, *window, deriv=1, delta=period)


def filter_difference(
    samples: np.ndarray, window: tuple[int, int], period: float | None = None
) -> np.ndarray:
    """Difference that a filter of the same length and two orders less makes, shape (n,)."""
    length, order = window
    other = (length, max(order - 2, 0 if period is None else 1))
    if period is None:
        return smoothed(samples, window) - smoothed(samples, other)
    return derivative(samples, window, period) - derivative(samples, other, period)
