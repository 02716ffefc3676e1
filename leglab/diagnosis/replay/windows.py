"""Channels of the recordings, their smoothing, and the windows cut from them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.signal import savgol_coeffs, savgol_filter

from leglab.base.errors import LeglabError
from leglab.base.recording import Recording
from leglab.diagnosis.intake.series import UniformSeries, common_period
from leglab.diagnosis.plant.lately import Lately
from leglab.diagnosis.plant.model import CHAMBERS, CYLINDER, Machine
from leglab.diagnosis.replay.pushes import Pushes
from leglab.diagnosis.thresholds import DEFAULT, Thresholds
from leglab.machine.simulation import actuator_moments

# Filtered versions of a channel that are kept: the present one and those of a trial.
_KNOWN = 3


@dataclass(frozen=True, kw_only=True)
class Channel:
    """One measured output that a replay predicts.

    Attributes:
        column: Of the recordings.
        joint: That it belongs to.
        cylinder: Whose chamber it is; None for a position.
        chamber: "pressure_a" or "pressure_b"; None for a position.
        filter: Length in samples and order of the Savitzky-Golay filter that smooths it.
    """

    column: str
    joint: str
    cylinder: str | None = None
    chamber: str | None = None
    filter: tuple[int, int] = (21, 4)


def channels(
    machine: Machine, recordings: Mapping[str, Recording], thresholds: Thresholds = DEFAULT
) -> tuple[Channel, ...]:
    """Measured outputs that all recordings share: positions, then chamber pressures.

    Raises:
        LeglabError: A joint's position or an actuator's command is missing; lists both sides.
    """
    shared = set.intersection(*(set(r.columns) for r in recordings.values()))
    missing = [column for column in machine.columns if column not in shared]
    if missing:
        raise LeglabError(
            f"the recordings have no column {', '.join(map(repr, missing))}: the model needs "
            f"{', '.join(machine.columns)}; all recordings have {', '.join(sorted(shared))}. "
            "Measured under other names? Give a column map"
        )
    period = common_period(recordings, thresholds)
    position = _filter(thresholds.position_filter, period)
    pressure = _filter(thresholds.pressure_filter, period)
    found = [Channel(column=f"{j}_position", joint=j, filter=position) for j in machine.joints]
    for cylinder in machine.instances(CYLINDER):
        joint = machine.driven[cylinder][0]
        columns = {f"{joint}_{chamber}": chamber for chamber in CHAMBERS}
        found += [
            Channel(column=name, joint=joint, cylinder=cylinder, chamber=chamber, filter=pressure)
            for name, chamber in columns.items()
            if name in shared
        ]
    return tuple(found)


def _filter(choice: tuple[float, int, int], period: float) -> tuple[int, int]:
    duration, least, order = choice
    return max(least, 2 * round(0.5 * (duration / period - 1.0)) + 1), order


def noise_level(samples: np.ndarray, window: tuple[int, int]) -> float:
    """Standard deviation of white sensor noise, from what a smoothing filter leaves over.

    The filter keeps its centre coefficient c of each sample, so that white noise of variance s^2
    leaves s^2 (1 - c). The median makes jumps of the signal count little (Rousseeuw and
    Croux 1993).

    Args:
        samples: Shape (n,).
        window: Length and order of the Savitzky-Golay filter.
    """
    if samples.size < window[0]:
        return 0.0
    rest = samples - savgol_filter(samples, *window)
    centre = savgol_coeffs(*window)[window[0] // 2]
    return float(1.4826 * np.median(np.abs(rest)) / np.sqrt(1.0 - centre))


def channel_noise(series: UniformSeries, channel: Channel) -> float:
    """Standard deviation of white noise that averages over samples as a channel's noise does."""
    column = channel.column
    if column in series.noise:
        return series.noise[column]
    return noise_level(series.columns[column], channel.filter)


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


@dataclass(frozen=True, kw_only=True, eq=False)
class Driven:
    """Motion of a joint by the commands of native actuators; all (n,).

    Attributes:
        position: What a filter of positions takes away of it.
        velocity: What the derivative of a filter takes away of it.
        whole: Its velocity, from rest.
    """

    position: np.ndarray
    velocity: np.ndarray
    whole: np.ndarray


@dataclass(kw_only=True)
class Cut:
    """Windows of one series.

    Attributes:
        series: The recording.
        firsts: Samples at which windows start, shape (windows,).
        levers: d(actuator length)/d(joint position) of the cylinders, each (n,).
        pushes: What commands of native actuators do at once; None where there are none.
        known: By column, samples that were filtered lately and what came of them, each (n,).
        driven: Commands lately and the motion by them, as of `pushed`.
        lately: What was followed along the series lately.
    """

    series: UniformSeries
    firsts: np.ndarray
    levers: dict[str, np.ndarray]
    pushes: Pushes | None = None
    driven: list[tuple[dict[str, np.ndarray], dict[str, Driven]]] = field(default_factory=list)
    known: dict[str, list[tuple[np.ndarray, np.ndarray, np.ndarray]]] = field(default_factory=dict)
    lately: Lately = field(default_factory=Lately)

    def filtered(self, channel: Channel, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Smoothed samples of a channel, as a hypothesis corrects them, and their derivative.

        Most hypotheses of a search correct a channel alike, so the last few are kept.
        """
        known = self.known.setdefault(channel.column, [])
        place = next((i for i, k in enumerate(known) if np.array_equal(k[0], samples)), None)
        if place is None:
            slope = derivative(samples, channel.filter, self.series.period)
            known.append((samples, smoothed(samples, channel.filter), slope))
            del known[:-_KNOWN]
        else:
            known.append(known.pop(place))
        return known[-1][1:]

    def pushed(
        self, channels: Sequence[Channel], commands: dict[str, np.ndarray]
    ) -> dict[str, Driven]:
        """What filters of the positions take away of the motion by commands, by joint."""
        if self.pushes is None:
            return {}
        for place, (known, found) in enumerate(self.driven):
            if all(np.array_equal(known[name], commands[name]) for name in self.pushes.response):
                self.driven.append(self.driven.pop(place))
                return found
        period = self.series.period
        rows = zip(self.pushes.joints, *self.pushes.moved(commands, period), strict=True)
        filters = {c.joint: c.filter for c in channels if not c.chamber}
        found = {
            joint: Driven(
                position=position - smoothed(position, filters[joint]),
                velocity=velocity - derivative(position, filters[joint], period),
                whole=velocity,
            )
            for joint, position, velocity in rows
            if joint in filters
        }
        self.driven.append((commands, found))
        del self.driven[:-_KNOWN]
        return found


def cut_series(
    machine: Machine,
    series: UniformSeries,
    channels: tuple[Channel, ...],
    samples: int,
    lead: int,
    thresholds: Thresholds,
) -> Cut:
    """Cuts a series into windows of `samples`, none before `lead` samples have passed."""
    margin = thresholds.margin_samples
    last = series.time.size - samples - margin - 1
    unrest = _unrest(machine, series, channels, margin)
    room = round(thresholds.start_room * samples)
    grid = np.arange(max(margin, lead), last + 1, samples)
    calm = [g + int(np.argmin(unrest[g : min(g + room, last) + 1])) for g in grid.tolist()]
    firsts = np.array(calm, dtype=np.int64)
    missing = np.concatenate([[0], np.cumsum(~series.valid)])
    keep = missing[firsts + samples + 1] == missing[firsts - lead]
    for channel in channels:
        if channel.chamber:
            level = smoothed(series.columns[channel.column], channel.filter)
            keep &= level[firsts] > thresholds.vapour_pressure
    firsts = firsts[keep]
    still = resting(machine, series, channels, firsts, samples, thresholds)
    firsts = firsts[~still | ((np.cumsum(still) - 1) % thresholds.still_every == 0)]
    levers = {c: _lever(machine, series, c) for c in machine.instances(CYLINDER)}
    return Cut(series=series, firsts=firsts, levers=levers, pushes=Pushes.of(machine, series))


def resting(
    machine: Machine,
    series: UniformSeries,
    channels: tuple[Channel, ...],
    firsts: np.ndarray,
    samples: int,
    thresholds: Thresholds = DEFAULT,
) -> np.ndarray:
    """Mask of windows in which neither a command nor a channel moves beyond its noise.

    A joint that sticks under a command that grows does not rest: that says what holds it.
    """
    index = firsts[:, None] + np.arange(samples + 1)
    still = np.ones(firsts.size, dtype=bool)
    for actuator in machine.actuators:
        command = series.columns[f"{actuator}_command"]
        still &= np.ptp(command[index], axis=1) <= thresholds.still_command * np.ptp(command)
    for channel in channels:
        step = series.steps.get(channel.column, 0.0)
        room = max(thresholds.still_noise * channel_noise(series, channel), 1.01 * step)
        level = smoothed(series.columns[channel.column], channel.filter)
        still &= np.ptp(level[index], axis=1) <= room
    return still


def _unrest(
    machine: Machine, series: UniformSeries, channels: tuple[Channel, ...], margin: int
) -> np.ndarray:
    """Unrest around each sample, (n,): windows start where it is least.

    Disagreement of two smoothing filters, in noise levels, and jumps of the commands.
    """
    total = np.zeros(series.time.size)
    for channel in channels:
        samples = series.columns[channel.column]
        level = channel_noise(series, channel) or 1.0
        length = max(2 * margin - 3, channel.filter[0])
        total += (filter_difference(samples, (length, 4)) / level) ** 2
    for actuator in machine.actuators:
        command = series.columns[f"{actuator}_command"]
        jump = np.abs(np.gradient(command)) / (command.std() or 1.0)
        total += (10.0 * jump) ** 2
    return maximum_filter1d(total, 2 * margin + 1)


def _lever(machine: Machine, series: UniformSeries, cylinder: str) -> np.ndarray:
    """d(actuator length)/d(joint position) over a series, shape (n,), every tenth exact."""
    model = machine.base.model
    data = mujoco.MjData(model)
    actuator = model.actuator(cylinder).id
    dof = int(model.joint(machine.driven[cylinder][0]).dofadr[0])
    chosen = np.arange(0, series.time.size, 10)
    lever = np.empty(chosen.size)
    addresses = [int(model.joint(name).qposadr[0]) for name in machine.joints]
    positions = np.stack([series.columns[f"{name}_position"] for name in machine.joints], 1)
    for i, row in enumerate(positions[chosen]):
        data.qpos[addresses] = row
        mujoco.mj_fwdPosition(model, data)
        lever[i] = actuator_moments(model, data)[actuator, dof]
    return np.interp(np.arange(series.time.size), chosen, lever)
