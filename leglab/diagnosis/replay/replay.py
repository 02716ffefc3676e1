"""Replay of measured commands over short windows that start from measured states."""

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from mujoco import rollout

from leglab.base.errors import LeglabError, RecordingError
from leglab.diagnosis.intake.series import UniformSeries
from leglab.diagnosis.plant.model import Change, Machine, Measured, Variant
from leglab.diagnosis.plant.moments import commands_at, plugin_offset
from leglab.diagnosis.replay.lacking import balanced_joints, comparable_forces, lacking_forces
from leglab.diagnosis.replay.starts import (
    Nudge,
    activated,
    closed,
    commanded,
    hidden_slots,
    measure,
    place,
    start_states,
)
from leglab.diagnosis.replay.windows import Channel, Cut, cut_all, sensor_noise, window_length
from leglab.diagnosis.thresholds import DEFAULT, FORCE_BLOCKS, LOUDER, Thresholds
from leglab.machine.plugin import headless

_CACHED_VARIANTS = 8
# Maximum memory for the states of the windows in one batch of a replay [bytes].
_MEMORY = 50_000_000

# Windows of one recording, its measured series, and its signals after sensor corrections.
Part = tuple[Cut, Measured, dict[str, np.ndarray]]
# Windows of one recording, its series at the samples of interest, and full physics states there.
Along = tuple[Cut, Measured, np.ndarray]


@dataclass(frozen=True, kw_only=True, eq=False)
class ReplayErrors:
    """Errors of a replay: measured less predicted outputs."""

    values: np.ndarray  #: Means over bins, after sensor corrections, (windows, channels, bins)
    normalised: np.ndarray  #: Divided by the gain of sensor corrections, same shape
    left: np.ndarray | None  #: Residual forces, see `Replay.lacking`; None if not requested
    pushed: np.ndarray | None  #: Change of `left` with commands, see `Replay.lacking`, or None


@dataclass(frozen=True, kw_only=True, eq=False)
class Course:
    """Data for the simulation of a recording from the start of one of its windows."""

    period: float  #: Sampling period [s]
    time: np.ndarray  #: Times of the samples [s], (samples,)
    #: Positions by joint, corrected and smoothed, each (samples,).
    positions: dict[str, np.ndarray]
    state: np.ndarray  #: Full physics state at the start, (nstate,)
    controls: np.ndarray  #: Controls at every time step, (steps, actuators)
    #: Displacement of each joint by a unit step of each command, after half a window and after a
    #: whole window, median over windows, (2, actuators, joints).
    moves: np.ndarray


def at_replay_step(machine: Machine, period: float) -> Machine:
    """Returns the machine at the time step of replays; `Problem` corrects errors by this step.

    The step is the longest that divides the sampling period [s], is at most twice the model's step
    and is accepted by the model.

    Raises:
        LeglabError: The model accepts none of these steps.
    """
    own = machine.file_timestep
    fewest, most = (max(1, int(np.ceil(period / h - 1e-9))) for h in (2.0 * own, own))
    for steps in range(fewest, most):
        with suppress(LeglabError):
            return machine.at_timestep(period / steps)
    return machine.at_timestep(period / most)


class Replay:
    """Windows (short pieces) of several recordings, replayed together by `mujoco.rollout` threads.

    All recordings have the same sampling period, which the machine's time step must divide.

    Raises:
        RecordingError: No window fits into the recordings.
    """

    def __init__(
        self,
        machine: Machine,
        series: list[UniformSeries],
        channels: tuple[Channel, ...],
        thresholds: Thresholds = DEFAULT,
        *,
        threads: int = 2,
    ) -> None:
        self.machine, self.channels, self.thresholds = machine, channels, thresholds
        self._period = period = series[0].period
        self.substeps = max(1, round(period / machine.timestep))
        self.samples, self.bins = window_length(period, thresholds)  #: per window
        self.window = self.samples * period  # length of a window [s]
        self.rest_time = max(thresholds.rest_time, period)  #: for `Instances.balance` [s]
        chambers = sum(1 for c in channels if c.chamber)
        #: Whether some chamber pressures are not measured, so that a longer replay estimates them.
        self.blind = chambers < 2 * len(machine.cylinders)
        self._lead = round(thresholds.warm_up / period) if self.blind else 0
        #: Standard deviation of each channel's samples, (recordings, channels).
        self.sensor_noise = sensor_noise(series, channels)
        #: Windows of each recording.
        self.cuts = cut_all(
            machine, series, channels, self.sensor_noise, self.samples, self._lead, thresholds
        )
        counts = [cut.firsts.size for cut in self.cuts]
        #: Index of each window's recording, and time at which it starts [s], (windows,).
        self.recording = np.repeat(np.arange(len(self.cuts)), counts)
        self.start = np.concatenate([c.series.time[c.firsts] for c in self.cuts])
        if not self.start.size:
            longest = max(float(s.time[-1] - s.time[0]) for s in series)
            raise RecordingError(
                f"no window of {self.window:.3g} s fits: the longest recording lasts "
                f"{longest:.3g} s; allowed: ",
                given=longest,
                allowed="recordings without gaps, some seconds long",
            )
        self._threads = max(1, threads)
        self._pool = rollout.Rollout(nthread=threads if threads > 1 else 0)
        self._datas: dict[int, tuple[Variant, list[mujoco.MjData]]] = {}
        self._room = np.empty(0)  # buffer of states
        self.rollouts = 0.0  #: number of replays; a replay of some windows counts as a fraction

    @property
    def windows(self) -> int:
        """Number of windows."""
        return int(self.start.size)

    def on(self, machine: Machine) -> "Replay":
        """Returns a replay of the same windows with another machine."""
        other = copy(self)
        other.machine, other.rollouts = machine, 0.0
        other._datas, other._room = {}, np.empty(0)
        other.substeps = max(1, round(self._period / machine.timestep))
        return other

    def use_one_thread(self) -> None:
        """Replaces the thread pool that a forked process inherited from its parent."""
        # The old pool stays referenced: deleting it would hang, since its threads are the parent's.
        self._abandoned, self._threads = self._pool, 1
        self._pool, self._datas = rollout.Rollout(nthread=0), {}

    def error(
        self,
        change: Change,
        *,
        chosen: np.ndarray | None = None,
        nudge: Nudge | None = None,
        lead: float = 0.0,
        forces: bool = False,
    ) -> ReplayErrors:
        """Computes measured less predicted outputs of chosen windows, or of all, under a change.

        `chosen` is a mask, (windows,). `nudge` perturbs the start states, commands of native
        actuators act earlier by `lead` [s], and `forces` adds the residual forces of the windows.
        """
        parts = list(self._parts(change, chosen))
        left: np.ndarray | None = None
        pushed: np.ndarray | None = None
        if forces and not self.blind:
            # Hidden states at window starts and inside windows are reconstructed together.
            along = list(self._along(change, parts, starts=True))
            starts = np.concatenate([states[: cut.firsts.size] for cut, _, states in along])
            inside = [
                (cut, replace(at, samples=at.samples[n:]), states[n:])
                for cut, at, states in along
                for n in [cut.firsts.size]
            ]
            left, pushed = self._left(change, inside)
        else:
            if forces:
                left, pushed = self._left(change, self._along(change, parts))
            starts = self._starts(change, parts)
        if nudge is not None:
            starts[:, place(change.variant, nudge.element, nudge.quantity)] += nudge.size
            starts = closed(change, starts)
        controls, targets = [], []
        for cut, measured, corrected in parts:
            index = cut.firsts[:, None] + np.arange(self.samples)
            controls.append(self._controls(cut, measured, index, lead))
            targets.append(np.stack([corrected[c.column][index + 1] for c in self.channels], 1))
        predicted = self._predicted(change.variant, starts, np.concatenate(controls))
        errors = np.concatenate(targets) - predicted
        binned = errors.reshape((*errors.shape[:2], self.bins, -1)).mean(axis=3)
        values = np.nan_to_num(binned, nan=1e12, posinf=1e12, neginf=-1e12)
        undone = [change.corrections.get(c.column, ()) for c in self.channels]
        gain = np.array([np.prod([gain for _, gain in found]) for found in undone])
        return ReplayErrors(
            values=values, normalised=values / gain[:, None], left=left, pushed=pushed
        )

    def lacking(self, change: Change, chosen: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Computes residual forces along the measured motion, and their change with commands.

        The first array, (windows, balanced joints, blocks), has means of `comparable_forces` over
        blocks of a window; the second has their change if native commands are scaled by `LOUDER`.
        """
        return self._left(change, self.along(change, chosen))

    def along(self, change: Change, chosen: np.ndarray | None) -> Iterator[Along]:
        """Yields, per recording, samples inside chosen windows, with the full physics states."""
        return self._along(change, self._parts(change, chosen))

    @property
    def half(self) -> int:
        """Samples before and after a sample over which accelerations are averaged: one bin each."""
        return self.samples // self.bins

    def _along(
        self, change: Change, parts: Iterable[Part], *, starts: bool = False
    ) -> Iterator[Along]:
        """Yields `along` for recordings `parts`; if `starts`, with the samples at starts first."""
        inside = np.arange(self.half, self.samples - self.half + 1, 2 * self.half)
        blocks = FORCE_BLOCKS
        inside = inside[: inside.size // blocks * blocks]
        for cut, measured, _ in parts:
            samples = (cut.firsts[:, None] + inside).ravel()
            if starts:
                samples = np.concatenate([cut.firsts, samples])
            at = replace(measured, samples=samples)
            yield cut, at, start_states(cut, change, at, self.channels, self.rest_time)

    def _left(self, change: Change, along: Iterable[Along]) -> tuple[np.ndarray, np.ndarray]:
        """Computes the two arrays that `lacking` returns from the results of `along`."""
        joints = balanced_joints(self.machine, self.channels)
        native = self.machine.native_actuators()

        def left(cut: Cut, measured: Measured, states: np.ndarray) -> np.ndarray:
            found = lacking_forces(change, measured, states, self.half)
            rows = comparable_forces(change, measured, found, joints)
            rows = rows.reshape(cut.firsts.size, FORCE_BLOCKS, -1, len(joints)).mean(axis=2)
            return np.nan_to_num(rows.transpose(0, 2, 1), nan=1e12, posinf=1e12, neginf=-1e12)

        found, pushed = [], []
        for cut, measured, states in along:
            own = left(cut, measured, states)
            sent = {a: LOUDER * cut.series.columns[f"{a}_command"] for a in native}
            loud = {a: commanded(change, a, u, self._period) for a, u in sent.items()}
            louder = replace(measured, command={**measured.command, **loud})
            louder = replace(louder, activation=activated(change, louder, measured.activation))
            found.append(own)
            pushed.append(left(cut, louder, states) - own if native else np.zeros_like(own))
        return np.concatenate(found), np.concatenate(pushed)

    def respond(self, change: Change, window: int, commands: np.ndarray) -> np.ndarray:
        """Predicts outputs from the start of a window under commands other than the measured ones.

        Commands have the shape (series, samples, actuators), outputs (series, channels, samples).
        """
        parts = list(self._parts(change, np.arange(self.windows) == window))
        start = self._starts(change, parts)
        each = zip(self.machine.actuators, np.moveaxis(commands, 2, 0), strict=True)
        faulty = [[commanded(change, a, row, self._period) for row in rows] for a, rows in each]
        controls = np.repeat(np.stack(faulty, axis=2), self.substeps, axis=1)
        return self._predicted(change.variant, np.repeat(start, len(commands), axis=0), controls)

    def course(self, change: Change, recording: int, after: float) -> Course | None:
        """Returns a recording from its first window at or after a time [s] to its next data gap.

        Returns None if no such window exists.
        """
        cut = self.cuts[recording]
        cut = replace(cut, firsts=cut.firsts[cut.series.time[cut.firsts] >= after])
        if not cut.firsts.size:
            return None
        measured, corrected = measure(cut, self.channels, change)
        starts = self._starts(change, [(cut, measured, corrected)])
        index = cut.firsts[:, None] + np.arange(self.samples)
        controls = self._controls(cut, measured, index)
        moves = np.zeros((2, len(self.machine.actuators), len(self.machine.joints)))
        places = np.array([place(change.variant, j, "position") for j in self.machine.joints])
        late = np.array([controls.shape[1] // 2, controls.shape[1]]) - 1
        there = self._roll(change.variant, starts, controls, late, places)
        for i, actuator in enumerate(self.machine.actuators):
            # Perturbation: 5 % of the command's standard deviation is small and yet visible.
            step = 0.05 * float(np.std(cut.series.columns[f"{actuator}_command"]))
            if step > 0.0:
                moved = controls.copy()
                moved[:, :, i] += step
                gone = self._roll(change.variant, starts, moved, late, places) - there
                moves[:, i] = np.nan_to_num(np.median(gone, axis=0)) / step
        first = int(cut.firsts[0])
        valid = np.append(cut.series.valid[first:], False)
        inside = first + np.arange(int(np.argmin(valid)))
        return Course(
            period=self._period,
            time=cut.series.time[inside],
            positions={joint: q[inside] for joint, q in measured.position.items()},
            state=starts[0],
            controls=self._controls(cut, measured, inside[None])[0],
            moves=moves,
        )

    def measured(self) -> np.ndarray:
        """Returns the measured samples of all windows, shape (windows, channels, samples + 1)."""
        rows = []
        for cut in self.cuts:
            index = cut.firsts[:, None] + np.arange(self.samples + 1)
            rows.append(np.stack([cut.series.columns[c.column][index] for c in self.channels], 1))
        return np.concatenate(rows)

    def at_starts(self, values: list[np.ndarray]) -> np.ndarray:
        """Returns values at window starts, (windows,), from one array (n,) per recording."""
        return np.concatenate([v[c.firsts] for v, c in zip(values, self.cuts, strict=True)])

    def _parts(self, change: Change, chosen: np.ndarray | None) -> Iterator[Part]:
        """Yields each recording with chosen windows, and its measured series under a change."""
        for number, cut in enumerate(self.cuts):
            if chosen is not None:
                cut = replace(cut, firsts=cut.firsts[chosen[self.recording == number]])
            if cut.firsts.size:
                yield cut, *measure(cut, self.channels, change)

    def _starts(self, change: Change, parts: list[Part]) -> np.ndarray:
        """Returns full physics states at window starts, (windows, nstate)."""

        def states(earlier: int, pressures: Sequence[np.ndarray | None]) -> np.ndarray:
            then = [(cut, replace(m, samples=m.samples - earlier)) for cut, m, _ in parts]
            rows = [
                start_states(cut, change, m, self.channels, self.rest_time, known)
                for (cut, m), known in zip(then, pressures, strict=True)
            ]
            return np.concatenate(rows)

        unknown = [None] * len(parts)
        if not self.blind:
            return states(0, unknown)
        # A replay of the time before each window ends with the pressures at the window's start.
        controls = [
            self._controls(cut, m, cut.firsts[:, None] - self._lead + np.arange(self._lead))
            for cut, m, _ in parts
        ]
        given, before = np.concatenate(controls), states(self._lead, unknown)
        slots = plugin_offset(change.variant.model) + hidden_slots(change)
        warm = self._roll(change.variant, before, given, np.array([given.shape[1] - 1]), slots)
        counts = np.cumsum([cut.firsts.size for cut, _, _ in parts])[:-1]
        return states(0, np.split(warm[:, 0], counts))

    def _controls(
        self, cut: Cut, measured: Measured, index: np.ndarray, lead: float = 0.0
    ) -> np.ndarray:
        """Returns controls at the time steps of the samples `index`, (windows, steps, actuators).

        Commands of native actuators act `lead` [s] before their recorded times.
        """
        actuators, steps = self.machine.actuators, self.substeps
        controls = commands_at(self.machine, measured, index)
        controls = np.repeat(controls, steps, axis=1)
        # MuJoCo's velocities are half a step older than its positions. So a command acts from half
        # a step before to half a step after its time, as a mean over this span. Activations have
        # dynamics of their own; with `actearly` they use the previous command.
        lead = ((cut.series.command_lead or 0.0) + lead) / self._period
        early = self.machine.base.model.actuator_actearly
        for name in self.machine.native_actuators():
            i, command = actuators.index(name), measured.command[name]
            begins = np.arange(controls.shape[1]) / steps
            begins += -int(early[i]) / steps if name in measured.activation else lead - 0.5 / steps
            sample = np.floor(begins).astype(np.int64)
            later = np.maximum(begins + 1.0 / steps - (sample + 1), 0.0) * steps
            now = index[:, :1] + sample
            after = np.minimum(now + 1, command.size - 1)
            kicks = (1.0 - later) * command[np.minimum(now, after)] + later * command[after]
            controls[:, :, i] = kicks
        return controls

    def _roll(
        self,
        variant: Variant,
        starts: np.ndarray,
        controls: np.ndarray,
        steps: np.ndarray,
        places: np.ndarray,
    ) -> np.ndarray:
        """Simulates windows; returns entries `places` of the states after `steps`.

        The shape is (windows, steps, places). A batch of windows takes at most `_MEMORY`.
        """
        model = variant.model
        # An MjData contains the plugin instances of one model, so each variant needs an MjData.
        if id(variant) not in self._datas:
            made = [mujoco.MjData(model) for _ in range(self._threads)]
            self._datas[id(variant)] = variant, made
            if len(self._datas) > _CACHED_VARIANTS:
                self._datas.pop(next(iter(self._datas)))
        datas = self._datas[id(variant)][1]
        windows, count = controls.shape[:2]
        most = max(self._threads, _MEMORY // (8 * count * starts.shape[1]))
        found = np.empty((windows, steps.size, places.size))
        for first in range(0, windows, most):
            part = slice(first, min(first + most, windows))
            shape = part.stop - part.start, count, starts.shape[1]
            if self._room.size < math.prod(shape):
                self._room = np.empty(math.prod(shape))
            states = self._room[: math.prod(shape)].reshape(shape)
            sensors = np.empty((*shape[:2], model.nsensordata))  # otherwise each call allocates it
            with headless(model):
                self._pool.rollout(
                    model, datas, starts[part], controls[part], state=states, sensordata=sensors
                )
            found[part] = states[:, steps[:, None], places]
        self.rollouts += windows / self.windows
        return found

    def _predicted(self, variant: Variant, starts: np.ndarray, controls: np.ndarray) -> np.ndarray:
        """Predicts the channels at all samples of windows, shape (windows, channels, samples)."""
        places = [
            place(variant, c.cylinder or c.joint, c.chamber or "position") for c in self.channels
        ]
        steps = np.arange(self.substeps - 1, controls.shape[1], self.substeps)
        seen = self._roll(variant, starts, controls, steps, np.array(places))
        return seen.transpose(0, 2, 1)
