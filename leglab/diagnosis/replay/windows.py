"""Channels (measured signals) of recordings, their smoothing, and windows of the recordings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.signal import savgol_coeffs

from leglab.base.recording import Recording
from leglab.base.scale import deviation
from leglab.diagnosis.intake.series import UniformSeries, common_period, readings_change
from leglab.diagnosis.plant.hidden_states import HiddenStates
from leglab.diagnosis.plant.model import CHAMBERS, Machine
from leglab.diagnosis.replay.pushes import Pushes, poses
from leglab.diagnosis.thresholds import DEFAULT, FORCE_BLOCKS, SAME, UNSEEN_STEP, Thresholds
from leglab.machine.simulation import actuator_moments


@dataclass(frozen=True, kw_only=True)
class Channel:
    """One measured output that a replay predicts."""

    column: str  #: Column of the recordings
    joint: str  #: Joint of the position, or joint that the cylinder drives
    cylinder: str | None = None  #: Cylinder of the chamber; None for a position
    chamber: str | None = None  #: "pressure_a" or "pressure_b"; None for a position
    #: Length in samples and order of the Savitzky-Golay filter that smooths the channel.
    filter: tuple[int, int] = (21, 4)


def channels(
    machine: Machine, recordings: Mapping[str, Recording], thresholds: Thresholds = DEFAULT
) -> tuple[Channel, ...]:
    """Returns the measured outputs that all recordings share: positions, then chamber pressures.

    `admit` has already rejected recordings that lack a position or a command.
    """
    shared = set.intersection(*(set(r.columns) for r in recordings.values()))
    period = common_period(recordings, thresholds)
    position = _filter(thresholds.position_filter, period)
    pressure = _filter(thresholds.pressure_filter, period)
    found = [Channel(column=f"{j}_position", joint=j, filter=position) for j in machine.joints]
    for cylinder in machine.cylinders:
        joint = machine.driven[cylinder][0]
        found += [
            Channel(column=name, joint=joint, cylinder=cylinder, chamber=chamber, filter=pressure)
            for chamber in CHAMBERS
            if (name := f"{joint}_{chamber}") in shared
        ]
    return tuple(found)


def _filter(choice: tuple[float, int, int], period: float) -> tuple[int, int]:
    """Converts a filter's length [s], minimum length in samples and order to samples and order."""
    duration, least, order = choice
    return max(least, 2 * round(0.5 * (duration / period - 1.0)) + 1), order


def noise_level(samples: np.ndarray, window: tuple[int, int]) -> float:
    """Estimates the standard deviation of white sensor noise from the residual of smoothing.

    `window` is the filter's length and order. With the centre coefficient c of the filter, white
    noise of variance s^2 leaves a residual of variance s^2 (1 - c). A median is used, so that steps
    have little influence (Rousseeuw and Croux 1993). Samples of a constant reading are left out, as
    they show no noise. Returns 0 if the signal never changes or is shorter than the filter.
    """
    if samples.size < window[0]:
        return 0.0
    rest = (samples - smoothed(samples, window))[readings_change(samples, window[0])]
    centre = savgol_coeffs(*window)[window[0] // 2]
    return deviation(rest) / float(np.sqrt(1.0 - centre))


def sensor_noise(series: Sequence[UniformSeries], channels: Sequence[Channel]) -> np.ndarray:
    """Estimates the standard deviation of each channel's sensor noise, (recordings, channels).

    If a channel shows no noise in a recording, the median over the other recordings is used. The
    estimate is at least the rounding error of the readings.
    """
    level = np.zeros((len(series), len(channels)))
    for k, channel in enumerate(channels):
        column = channel.column
        for i, one in enumerate(series):
            own = one.noise.get(column)
            level[i, k] = noise_level(one.columns[column], channel.filter) if own is None else own
        shown = level[:, k] > 0.0
        if shown.any():
            level[~shown, k] = np.median(level[shown, k])
        level[:, k] = np.maximum(level[:, k], resolution(series, column))
    return level


def resolution(series: Sequence[UniformSeries], column: str) -> float:
    """Computes a column's rounding error: its smallest quantisation step divided by sqrt(12).

    The step of a column that never changes is unknown; `UNSEEN_STEP` is used instead.
    """
    if all(np.ptp(s.columns[column]) == 0.0 for s in series):
        return UNSEEN_STEP[column.endswith("_position")] / np.sqrt(12.0)
    steps = [s.steps[column] for s in series if s.steps.get(column, 0.0) > 0.0]
    largest = max(float(np.abs(s.columns[column]).max()) for s in series)
    return max(min(steps, default=0.0) / np.sqrt(12.0), 1e-9 * largest, 1e-12)


@cache
def _kernels(length: int, order: int, period: float | None) -> np.ndarray:
    """Computes the filter's weights at each position of its window, (length, length)."""
    rule = {"deriv": int(period is not None), "delta": period or 1.0, "use": "dot"}
    return np.stack([savgol_coeffs(length, order, pos=k, **rule) for k in range(length)])


def smoothed(
    samples: np.ndarray, window: tuple[int, int], period: float | None = None
) -> np.ndarray:
    """Smooths samples by Savitzky-Golay, or computes their slope if `period` [s] is passed, (n,).

    Series shorter than the filter are not smoothed. Unlike `scipy.signal.savgol_filter`, it keeps
    the filter's kernels from call to call.
    """
    length, half = window[0], window[0] // 2
    if samples.size < length:
        return samples if period is None else np.gradient(samples, period)
    kernels = _kernels(*window, period)
    middle = np.correlate(samples, kernels[half], "valid")
    first, last = kernels[:half] @ samples[:length], kernels[half + 1 :] @ samples[-length:]
    return np.concatenate([first, middle, last])


def filter_difference(
    samples: np.ndarray, window: tuple[int, int], period: float | None = None
) -> np.ndarray:
    """Computes the samples smoothed by a filter minus by a filter of an order lower by 2, (n,)."""
    less = window[0], max(window[1] - 2, 0 if period is None else 1)
    return smoothed(samples, window, period) - smoothed(samples, less, period)


@dataclass(kw_only=True)
class Cut:
    """Windows of one recording, and quantities along the whole recording."""

    series: UniformSeries  #: The recording
    firsts: np.ndarray  #: Indices of the samples at which windows start, (windows,)
    #: d(actuator length)/d(joint position) of the cylinders, each (n,).
    levers: dict[str, np.ndarray]
    touched: dict[str, np.ndarray]  #: Whether bodies that a joint moves are in contact, (n,) each
    pushes: Pushes  #: Accelerations by commands of native actuators
    hidden_states: HiddenStates = field(default_factory=HiddenStates)  #: Cache along the series

    def filtered(self, channel: Channel, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Smooths corrected samples of a channel; returns the smooth samples and their slope."""

        def both() -> tuple[np.ndarray, np.ndarray]:
            level = smoothed(samples, channel.filter)
            return level, smoothed(samples, channel.filter, self.series.period)

        return self.hidden_states.get(f"filter of {channel.column}", (samples,), both)


def window_length(period: float, thresholds: Thresholds) -> tuple[int, int]:
    """Returns the number of samples and of bins of a window, at a sampling period [s].

    A window and a bin last `thresholds.window` and `thresholds.bin`, but a window has at least two
    bins for each of its `FORCE_BLOCKS` blocks, and a bin at least one sample. At sampling rates
    below 33 Hz a window therefore lasts longer than 0.3 s.
    """
    fewest = 2 * FORCE_BLOCKS
    samples = max(round(thresholds.window / period), fewest)
    per_bin = min(max(1, round(thresholds.bin / period)), samples // fewest)
    return samples // per_bin * per_bin, samples // per_bin


def cut_all(
    machine: Machine,
    series: Sequence[UniformSeries],
    channels: tuple[Channel, ...],
    noise: np.ndarray,
    samples: int,
    lead: int,
    thresholds: Thresholds,
) -> list[Cut]:
    """Cuts recordings into windows of `samples` samples, none in the first `lead` samples.

    Of the windows without motion only one in `still_every` is kept, since any force that holds the
    machine explains them. These and windows with hardly any motion (below `still_motion` of the
    usual travel) are then thinned to one per `still_every` windows with motion. Each recording
    keeps at least one of its windows. `noise` is the result of `sensor_noise`.
    """
    made = [
        _cut(machine, one, channels, own, samples, lead, thresholds)
        for one, own in zip(series, noise, strict=True)
    ]
    rows = np.concatenate([travel for _, travel, _ in made])
    usual = np.sqrt((rows**2).sum(axis=0) / max(1, len(rows)))
    few, moving, masks = thresholds.still_every, 0, []
    for (_, travel, held), own in zip(made, noise, strict=True):
        least = thresholds.still_noise * own
        next_to = np.maximum(least, thresholds.still_motion * usual)
        still, calm = (held & (travel <= room).all(axis=1) for room in (least, next_to))
        keep = _one_in(few, still)
        masks.append((keep, calm & keep))
        moving += int((~calm).sum())
    every = -(-few * sum(int(calm.sum()) for _, calm in masks) // moving) if moving else 1
    for (cut, *_), (keep, calm) in zip(made, masks, strict=True):
        cut.firsts = cut.firsts[keep & _one_in(max(1, every), calm)]
    return [cut for cut, *_ in made]


def _one_in(every: int, mask: np.ndarray) -> np.ndarray:
    """Selects all entries at which `mask` is false and each `every`-th at which it is true."""
    return ~mask | ((np.cumsum(mask) - 1) % every == 0)


def _cut(
    machine: Machine,
    series: UniformSeries,
    channels: tuple[Channel, ...],
    noise: np.ndarray,
    samples: int,
    lead: int,
    thresholds: Thresholds,
) -> tuple[Cut, np.ndarray, np.ndarray]:
    """Cuts all windows of one recording; `noise` has the shape (channels,).

    Also returns each channel's travel in the windows, (windows, channels), and whether all commands
    are constant, (windows,), since under changing commands, rest is informative (stiction).
    """
    commands = [series.columns[f"{actuator}_command"] for actuator in machine.actuators]
    reach = max(channel.filter[0] for channel in channels)
    margin = reach // 2 + thresholds.margin_samples
    # Windows start where two filters agree best, relative to noise, and no command jumps.
    unrest = np.zeros(series.time.size)
    for channel, own in zip(channels, noise, strict=True):
        unrest += (filter_difference(series.columns[channel.column], (reach, 4)) / own) ** 2
    for command in commands:
        unrest += (10.0 * (np.abs(np.gradient(command)) / (command.std() or 1.0))) ** 2
    unrest = maximum_filter1d(unrest, 2 * margin + 1)
    last = series.time.size - samples - margin - 1
    room = round(thresholds.start_room * samples)
    grid = np.arange(max(margin, lead), last + 1, samples)
    best = [g + int(np.argmin(unrest[g : min(g + room, last) + 1])) for g in grid.tolist()]
    firsts = np.array(best, dtype=np.int64)
    missing = np.concatenate([[0], np.cumsum(~series.valid)])
    keep = missing[firsts + samples + 1] == missing[firsts - lead]
    levels = [smoothed(series.columns[c.column], c.filter) for c in channels]
    for channel, level in zip(channels, levels, strict=True):
        if channel.chamber:
            keep &= level[firsts] > thresholds.vapour_pressure
    firsts = firsts[keep]
    inside = firsts[:, None] + np.arange(samples + 1)
    travel = np.stack([np.ptp(level[inside], axis=1) for level in levels], axis=1)
    held = np.ones(firsts.size, dtype=bool)
    for command in commands:
        held &= np.ptp(command[inside], axis=1) <= SAME * np.ptp(command)
    levers, touched = _along(machine, series, max(1, round(thresholds.bin / series.period)))
    pushes = Pushes(machine, series, thresholds.pose_every)
    cut = Cut(series=series, firsts=firsts, levers=levers, touched=touched, pushes=pushes)
    return cut, travel, held


def _along(
    machine: Machine, series: UniformSeries, stride: int
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Computes `levers` and `touched` of a `Cut`, interpolated between each `stride`-th sample."""
    model, count = machine.base.model, series.time.size
    moves = np.zeros((model.nbody, model.nv), dtype=bool)  # degrees of freedom that move a body
    for body in range(1, model.nbody):
        first = int(model.body_dofadr[body])
        moves[body] = moves[model.body_parentid[body]]
        moves[body, first : first + int(model.body_dofnum[body])] = True
    moments, touched = [], []
    for data in poses(machine, series, slice(None, None, stride)):
        moments.append(actuator_moments(model, data))
        pairs = data.contact.geom[data.contact.efc_address >= 0]
        touched.append(moves[model.geom_bodyid[pairs]].any(axis=(0, 1)))
    dofs = {joint: int(model.joint(joint).dofadr[0]) for joint in machine.joints}
    lever, there = np.stack(moments), np.repeat(touched, stride, axis=0)[:count]
    levers = {}
    for cylinder in machine.cylinders:
        own = lever[:, model.actuator(cylinder).id, dofs[machine.driven[cylinder][0]]]
        levers[cylinder] = np.interp(np.arange(count), np.arange(0, count, stride), own)
    return levers, {joint: there[:, dof] for joint, dof in dofs.items()}
