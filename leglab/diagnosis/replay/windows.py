"""Channels of the recordings, their smoothing, and the windows cut from them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

import mujoco
import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.signal import savgol_coeffs

from leglab.base.errors import LeglabError
from leglab.base.recording import Recording
from leglab.diagnosis.intake.series import UniformSeries, common_period, readings_change
from leglab.diagnosis.plant.lately import Lately, alike
from leglab.diagnosis.plant.model import CHAMBERS, CYLINDER, Machine
from leglab.diagnosis.replay.pushes import Pushes
from leglab.diagnosis.thresholds import DEFAULT, UNSEEN_STEP, Thresholds
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
    Croux 1993). Where a signal rests on one reading it shows no noise, and does not count.

    Args:
        samples: Shape (n,).
        window: Length and order of the Savitzky-Golay filter.

    Returns:
        0 where the signal never changes, or is shorter than the filter.
    """
    if samples.size < window[0]:
        return 0.0
    rest = np.abs(samples - smoothed(samples, window))
    rest = rest[readings_change(samples, window[0])]
    centre = savgol_coeffs(*window)[window[0] // 2]
    return float(1.4826 * np.median(rest) / np.sqrt(1.0 - centre)) if rest.size else 0.0


def sensor_noise(series: Sequence[UniformSeries], channels: Sequence[Channel]) -> np.ndarray:
    """Standard deviation of each channel's samples, (recordings, channels).

    It averages over samples as the channel's noise does. A recording in which a channel rests on
    one reading has the noise of the others, and none has less than the rounding of the readings.
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
    """Rounding error of a column: its least step in any recording over sqrt(12).

    A recording that rests on one count has no step of its own, and one of the others counts. Of a
    column that never moves at all nobody knows the step.
    """
    if all(np.ptp(s.columns[column]) == 0.0 for s in series):
        return UNSEEN_STEP[column.endswith("_position")] / np.sqrt(12.0)
    steps = [s.steps[column] for s in series if s.steps.get(column, 0.0) > 0.0]
    largest = max(float(np.abs(s.columns[column]).max()) for s in series)
    return max(min(steps, default=0.0) / np.sqrt(12.0), 1e-9 * largest, 1e-12)


@cache
def _kernels(length: int, order: int, slope: bool, period: float) -> np.ndarray:
    """Weights of a window's samples in the polynomial at each of its places, (length, length)."""
    rule = {"deriv": int(slope), "delta": period, "use": "dot"}
    return np.stack([savgol_coeffs(length, order, pos=k, **rule) for k in range(length)])


def _savgol(samples: np.ndarray, kernels: np.ndarray) -> np.ndarray:
    """`scipy.signal.savgol_filter`, whose polynomials are fitted anew at every call."""
    length = len(kernels)
    half = length // 2
    middle = np.correlate(samples, kernels[half], "valid")
    first, last = kernels[:half] @ samples[:length], kernels[half + 1 :] @ samples[-length:]
    return np.concatenate([first, middle, last])


def smoothed(samples: np.ndarray, window: tuple[int, int]) -> np.ndarray:
    """Savitzky-Golay smoothing; series shorter than the filter stay as they are."""
    return _savgol(samples, _kernels(*window, False, 1.0)) if samples.size >= window[0] else samples


def derivative(samples: np.ndarray, window: tuple[int, int], period: float) -> np.ndarray:
    """First derivative by the same filter."""
    if samples.size < window[0]:
        return np.gradient(samples, period)
    return _savgol(samples, _kernels(*window, True, period))


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
        touched: Whether something touches what a joint carries, (n,) by joint; none where nothing
            can.
        pushes: What commands of native actuators do at once; None where there are none.
        known: By column, samples that were filtered lately and what came of them, each (n,).
        driven: Commands lately and the motion by them, as of `pushed`.
        lately: What was followed along the series lately.
    """

    series: UniformSeries
    firsts: np.ndarray
    levers: dict[str, np.ndarray]
    touched: dict[str, np.ndarray] = field(default_factory=dict)
    pushes: Pushes | None = None
    driven: list[tuple[dict[str, np.ndarray], dict[str, Driven]]] = field(default_factory=list)
    known: dict[str, list[tuple[np.ndarray, np.ndarray, np.ndarray]]] = field(default_factory=dict)
    lately: Lately = field(default_factory=Lately)

    def filtered(self, channel: Channel, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Smoothed samples of a channel, as a hypothesis corrects them, and their derivative.

        Most hypotheses of a search correct a channel alike, so the last few are kept.
        """
        known = self.known.setdefault(channel.column, [])
        place = next((i for i, k in enumerate(known) if alike(k[0], samples)), None)
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
            if all(alike(known[name], commands[name]) for name in self.pushes.response):
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


def window_length(period: float, thresholds: Thresholds = DEFAULT) -> tuple[int, int]:
    """Samples in a window, and bins into which it is divided, at a sampling period [s].

    `thresholds.window` and `bin` as far as the samples allow. Forces are told in
    `thresholds.force_blocks` parts of a window, and each is a change of velocity from one bin to
    the next but one. So a window has two bins for each part and a bin at least one sample: ten
    samples, seven of them beyond the reach of the shortest filter about the window's start. Of a
    log below 33 Hz a window lasts longer than 0.3 s.
    """
    fewest = 2 * thresholds.force_blocks
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
    """Cuts recordings into windows of `samples`, none before `lead` samples have passed.

    Of windows in which nothing moves one in a few is kept, for the others say the same. Whatever
    holds a machine at rest explains them, too much friction as well as the right one: of those, and
    of windows in which next to nothing moves, no more are kept than one for so many others. Each
    recording keeps at least one of its own.

    Args:
        machine: That was recorded.
        series: The recordings.
        channels: What is predicted.
        noise: As `sensor_noise` has it, (recordings, channels).
        samples: In a window.
        lead: Before a window that are replayed as well.
        thresholds: Of windows.
    """
    cuts = [
        _cut(machine, one, channels, own, samples, lead, thresholds)
        for one, own in zip(series, noise, strict=True)
    ]
    masks = resting(machine, cuts, channels, noise, samples, thresholds)
    few = thresholds.still_every
    kept = [_one_in(few, still) for still, _ in masks]
    calm = [calm & keep for keep, (_, calm) in zip(kept, masks, strict=True)]
    moving = sum(int((~calm).sum()) for _, calm in masks)
    every = -(-few * sum(int(c.sum()) for c in calm) // moving) if moving else 1
    for cut, keep, rests in zip(cuts, kept, calm, strict=True):
        cut.firsts = cut.firsts[keep & _one_in(max(1, every), rests)]
    return cuts


def _one_in(every: int, mask: np.ndarray) -> np.ndarray:
    """Mask of all that is not in another one, and of one in so many of what is."""
    return ~mask | ((np.cumsum(mask) - 1) % every == 0)


def _cut(
    machine: Machine,
    series: UniformSeries,
    channels: tuple[Channel, ...],
    noise: np.ndarray,
    samples: int,
    lead: int,
    thresholds: Thresholds,
) -> Cut:
    """Cuts one recording, `noise` its (channels,), as `cut_all` does."""
    reach = max(channel.filter[0] for channel in channels)
    margin = reach // 2 + thresholds.margin_samples
    last = series.time.size - samples - margin - 1
    unrest = _unrest(machine, series, channels, noise, reach, margin)
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
    stride = max(1, round(thresholds.bin / series.period))
    return Cut(
        series=series,
        firsts=firsts,
        levers={c: _lever(machine, series, c, stride) for c in machine.instances(CYLINDER)},
        touched=_touched(machine, series, stride),
        pushes=Pushes.of(machine, series),
    )


def resting(
    machine: Machine,
    cuts: Sequence[Cut],
    channels: tuple[Channel, ...],
    noise: np.ndarray,
    samples: int,
    thresholds: Thresholds,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Masks of the windows in which nothing moves, and in which next to nothing does.

    No command moves, and every channel moves by a few noise levels; or by next to nothing of what
    it moves in all windows together. A joint that sticks under a command that grows does not rest:
    that says what holds it.

    Args:
        machine: As all others as `cut_all` has it.
        cuts: All windows.
        channels: What is predicted.
        noise: Of each channel.
        samples: In a window.
        thresholds: Say what rests.

    Returns:
        By recording; the second holds the first.
    """

    def moved(cut: Cut, values: np.ndarray) -> np.ndarray:
        return np.ptp(values[cut.firsts[:, None] + np.arange(samples + 1)], axis=1)

    rows = []
    for cut in cuts:
        columns = cut.series.columns
        own = (moved(cut, smoothed(columns[c.column], c.filter)) for c in channels)
        rows.append(np.stack(list(own), axis=1))
    usual = np.sqrt((np.concatenate(rows) ** 2).sum(axis=0) / max(1, sum(map(len, rows))))
    found = []
    for cut, travel, own in zip(cuts, rows, noise, strict=True):
        held = np.ones(len(travel), dtype=bool)
        for actuator in machine.actuators:
            command = cut.series.columns[f"{actuator}_command"]
            held &= moved(cut, command) <= thresholds.still_command * np.ptp(command)
        least = thresholds.still_noise * own
        next_to = np.maximum(least, thresholds.still_motion * usual)
        found.append(tuple(held & (travel <= room).all(axis=1) for room in (least, next_to)))
    return found


def _unrest(
    machine: Machine,
    series: UniformSeries,
    channels: tuple[Channel, ...],
    noise: np.ndarray,
    reach: int,
    margin: int,
) -> np.ndarray:
    """Unrest around each sample, (n,): windows start where it is least.

    Disagreement of two smoothing filters of length `reach`, in noise levels, and jumps of the
    commands; the most within `margin` samples.
    """
    total = np.zeros(series.time.size)
    for channel, own in zip(channels, noise, strict=True):
        samples = series.columns[channel.column]
        total += (filter_difference(samples, (reach, 4)) / own) ** 2
    for actuator in machine.actuators:
        command = series.columns[f"{actuator}_command"]
        jump = np.abs(np.gradient(command)) / (command.std() or 1.0)
        total += (10.0 * jump) ** 2
    return maximum_filter1d(total, 2 * margin + 1)


def _lever(machine: Machine, series: UniformSeries, cylinder: str, stride: int) -> np.ndarray:
    """d(actuator length)/d(joint position) over a series, shape (n,), one in a stride exact."""
    model = machine.base.model
    actuator = model.actuator(cylinder).id
    dof = int(model.joint(machine.driven[cylinder][0]).dofadr[0])
    chosen = np.arange(0, series.time.size, stride)
    poses = _poses(machine, series, chosen)
    lever = np.array([actuator_moments(model, data)[actuator, dof] for data in poses])
    return np.interp(np.arange(series.time.size), chosen, lever)


def _touched(machine: Machine, series: UniformSeries, stride: int) -> dict[str, np.ndarray]:
    """Whether something touches what a joint carries, as `Cut` has it, one in a stride exact."""
    model = machine.base.model
    if model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CONTACT):
        return {}
    first = int(mujoco.mjtConstraint.mjCNSTR_CONTACT_FRICTIONLESS)
    chosen = np.arange(0, series.time.size, stride)
    found = np.zeros((chosen.size, model.nv), dtype=bool)
    for row, data in zip(found, _poses(machine, series, chosen), strict=True):
        for contact in data.contact[: data.ncon]:
            if contact.efc_address >= 0 and data.efc_type[contact.efc_address] >= first:
                for geom in contact.geom:
                    _carry(model, int(model.geom_bodyid[geom]), row)
    dofs = {joint: int(model.joint(joint).dofadr[0]) for joint in machine.joints}
    every = np.repeat(found, stride, axis=0)[: series.time.size]
    return {joint: every[:, dof] for joint, dof in dofs.items()}


def _carry(model: mujoco.MjModel, body: int, row: np.ndarray) -> None:
    """Marks the degrees of freedom that move a body, (nv,)."""
    while body:
        first = int(model.body_dofadr[body])
        row[first : first + int(model.body_dofnum[body])] = True
        body = int(model.body_parentid[body])


def _poses(machine: Machine, series: UniformSeries, chosen: np.ndarray) -> Iterator[mujoco.MjData]:
    """The machine at measured positions, one after the other."""
    model = machine.base.model
    data = mujoco.MjData(model)
    addresses = [int(model.joint(name).qposadr[0]) for name in machine.joints]
    positions = np.stack([series.columns[f"{name}_position"] for name in machine.joints], 1)
    for row in positions[chosen]:
        data.qpos[addresses] = row
        mujoco.mj_fwdPosition(model, data)
        yield data
