"""Replay of measured commands over short windows that start from measured states."""

from copy import copy
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from mujoco import rollout

from leglab.base.errors import LeglabError
from leglab.diagnosis.model import CYLINDER, Change, Machine, Measured, Variant
from leglab.diagnosis.starts import (
    PLUGIN,
    Nudge,
    measure,
    offset,
    pressure_slots,
    start_states,
)
from leglab.diagnosis.windows import Channel, Cut, Series, cut_series
from leglab.machine.plugin import headless

# Where no pressures are measured, a replay of this time before a window, which forgets where it
# began, says what they are at its start.
_WARM_UP = 0.15  # s


@dataclass(frozen=True, kw_only=True)
class Layout:
    """How recordings are cut.

    Attributes:
        window: Length of a window [s].
        bin: Predictions and data are averaged over this time [s].
    """

    window: float = 0.3
    bin: float = 0.01


class Replay:
    """Windows of several recordings, replayed together by `mujoco.rollout` threads.

    Args:
        machine: Its time step must divide the sampling period.
        series: Recordings of one sampling period.
        channels: What is predicted.
        layout: How recordings are cut.
        threads: Of the rollouts.

    Raises:
        LeglabError: No window fits into the recordings.

    Attributes:
        recording: Index of each window's recording, shape (windows,).
        start: Time at which each window starts [s], shape (windows,).
        bins: Number of bins in a window.
        blind: Whether chamber pressures are not measured; they are then replayed as well.
        noise_gain: Of each channel under the latest `error`, shape (channels,).
    """

    def __init__(
        self,
        machine: Machine,
        series: list[Series],
        channels: tuple[Channel, ...],
        layout: Layout,
        *,
        threads: int = 2,
    ) -> None:
        self.machine, self.channels, self.layout = machine, channels, layout
        period = series[0].period
        self._period = period
        self.substeps = max(1, round(period / machine.timestep))
        per_bin = max(1, round(layout.bin / period))
        self.bins = max(1, round(layout.window / period) // per_bin)
        self._per_bin = per_bin
        self.samples = self.bins * per_bin
        chambers = sum(1 for c in channels if c.chamber)
        self.blind = chambers < 2 * len(machine.instances(CYLINDER))
        self._lead = round(_WARM_UP / period) if self.blind else 0
        self._cuts = [cut_series(machine, s, channels, self.samples, self._lead) for s in series]
        self.recording = np.concatenate(
            [np.full(c.firsts.size, i) for i, c in enumerate(self._cuts)]
        )
        self.start = np.concatenate([c.series.time[c.firsts] for c in self._cuts])
        if not self.start.size:
            longest = max(float(s.time[-1] - s.time[0]) for s in series)
            raise LeglabError(
                f"no window of {layout.window:g} s fits: the longest recording lasts {longest:.3g} "
                "s; allowed: recordings without gaps, some seconds long"
            )
        self.noise_gain = np.ones(len(channels))
        self._threads = threads
        self._pool = rollout.Rollout(nthread=threads) if threads > 1 else rollout.Rollout(nthread=0)
        self._datas: dict[int, tuple[Variant, list[mujoco.MjData]]] = {}
        self._buffers: dict[tuple[int, ...], np.ndarray] = {}
        self.rollouts = 0.0

    @property
    def windows(self) -> int:
        """Number of windows."""
        return int(self.start.size)

    def on(self, machine: Machine) -> "Replay":
        """The same windows replayed by another model."""
        other = copy(self)
        other.machine = machine
        other._datas, other._buffers = {}, {}
        other.substeps = max(1, round(self._period / machine.timestep))
        return other

    def error(
        self, change: Change, *, chosen: np.ndarray | None = None, nudge: Nudge | None = None
    ) -> np.ndarray:
        """Measured less predicted, averaged over bins, shape (chosen windows, channels, bins).

        Args:
            change: What the hypothesis changes.
            chosen: Mask of the windows to replay, shape (windows,); None for all.
            nudge: Departure from the start states.
        """
        variant, parameters = self._changed(change)
        pairs = []
        for number, whole in enumerate(self._cuts):
            cut = whole
            if chosen is not None:
                cut = replace(whole, firsts=whole.firsts[chosen[self.recording == number]])
            if cut.firsts.size:
                pairs.append((cut, *measure(self.machine, cut, self.channels, change)))
        pressures = self._warmed_up(change, variant, parameters, pairs) if self.blind else None
        starts, controls, targets = [], [], []
        done = 0
        for cut, measured, corrected in pairs:
            count = cut.firsts.size
            starts.append(
                start_states(
                    self.machine,
                    cut,
                    change,
                    variant,
                    parameters,
                    measured,
                    self.channels,
                    pressures=None if pressures is None else pressures[done : done + count],
                    nudge=nudge,
                )
            )
            done += count
            index = cut.firsts[:, None] + np.arange(self.samples)
            controls.append(self._controls(measured, index))
            targets.append(np.stack([corrected[c.column][index + 1] for c in self.channels], 1))
        states = self._roll(variant, np.concatenate(starts), np.concatenate(controls))
        predicted = self._predicted(variant, states)
        errors = np.concatenate(targets) - predicted
        for k, channel in enumerate(self.channels):
            gains = [gain for _, gain in change.corrections.get(channel.column, ())]
            self.noise_gain[k] = np.prod(gains) if gains else 1.0
        shape = (len(errors), len(self.channels), self.bins, self._per_bin)
        binned = errors.reshape(shape).mean(axis=3)
        return np.nan_to_num(binned, nan=1e12, posinf=1e12, neginf=-1e12)

    def respond(self, change: Change, window: int, commands: np.ndarray) -> np.ndarray:
        """Predictions from the start of one window under other commands.

        Args:
            change: What the hypothesis changes.
            window: Whose start state is taken.
            commands: Measured commands, shape (series, samples, actuators).

        Returns:
            Shape (series, channels, samples).
        """
        variant, parameters = self._changed(change)
        number = int(self.recording[window])
        first = window - int(np.argmax(self.recording == number))
        whole = self._cuts[number]
        cut = replace(whole, firsts=whole.firsts[first : first + 1])
        measured, corrected = measure(self.machine, cut, self.channels, change)
        pairs = [(cut, measured, corrected)]
        start = start_states(
            self.machine,
            cut,
            change,
            variant,
            parameters,
            measured,
            self.channels,
            pressures=self._warmed_up(change, variant, parameters, pairs) if self.blind else None,
        )
        faulty = commands.copy()
        for i, actuator in enumerate(self.machine.actuators):
            for path in change.commands.get(actuator, ()):
                faulty[:, :, i] = [path(row, self._period) for row in faulty[:, :, i]]
        controls = np.repeat(faulty, self.substeps, axis=1)
        states = self._roll(variant, np.repeat(start, len(commands), axis=0), controls)
        return self._predicted(variant, states, commands.shape[1])

    def _changed(self, change: Change) -> tuple[Variant, np.ndarray]:
        """The compiled model under a change, and its plugin state with parameters set."""
        variant = self.machine.variant(tuple(change.edits))
        parameters = variant.plugin_state.copy()
        for (element, name), value in change.parameters.items():
            parameters[variant.slot(element, name)] = value
        return variant, parameters

    def _warmed_up(
        self,
        change: Change,
        variant: Variant,
        parameters: np.ndarray,
        pairs: list[tuple[Cut, Measured, dict[str, np.ndarray]]],
    ) -> np.ndarray:
        """Chamber pressures at window starts from a replay before them, (windows, chambers)."""
        starts, controls = [], []
        for cut, measured, _ in pairs:
            earlier = cut.firsts - self._lead
            before = replace(measured, samples=earlier)
            starts.append(
                start_states(
                    self.machine,
                    cut,
                    change,
                    variant,
                    parameters,
                    before,
                    self.channels,
                )
            )
            controls.append(self._controls(measured, earlier[:, None] + np.arange(self._lead)))
        states = self._roll(variant, np.concatenate(starts), np.concatenate(controls))
        slots = offset(variant.model, PLUGIN) + pressure_slots(self.machine, variant)
        return states[:, -1][:, slots].copy()

    def _controls(self, measured: Measured, index: np.ndarray) -> np.ndarray:
        """Controls at the steps of windows, (windows, steps, actuators); `index` their samples."""
        actuators = self.machine.actuators
        controls = np.stack([measured.command[a][index] for a in actuators], 2)
        controls = np.repeat(controls, self.substeps, axis=1)
        # Velocities lag half a step, so a kick spans half a step to both sides of its time: the
        # first of a sample sees the command before as well. A valve follows its command itself.
        native = [i for i, a in enumerate(actuators) if a in self.machine.native_actuators()]
        for i in native:
            controls[:, :: self.substeps, i] += measured.command[actuators[i]][index - 1]
            controls[:, :: self.substeps, i] *= 0.5
        return controls

    def measured(self) -> np.ndarray:
        """Samples of all windows as measured, shape (windows, channels, samples + 1)."""
        rows = []
        for cut in self._cuts:
            index = cut.firsts[:, None] + np.arange(self.samples + 1)
            rows.append(np.stack([cut.series.columns[c.column][index] for c in self.channels], 1))
        return np.concatenate(rows)

    def at_starts(self, values: list[np.ndarray]) -> np.ndarray:
        """Values at window starts, shape (windows,), from one array of shape (n,) a recording."""
        return np.concatenate([v[c.firsts] for v, c in zip(values, self._cuts, strict=True)])

    def _roll(self, variant: Variant, starts: np.ndarray, controls: np.ndarray) -> np.ndarray:
        """Full physics states after every step, (windows, steps, nstate); overwritten next time."""
        model = variant.model
        # Data carry their own plugin instances, so every variant has its own.
        key = id(variant)
        if key not in self._datas or self._datas[key][0] is not variant:
            count = max(1, self._threads if self._threads > 1 else 1)
            self._datas[key] = (variant, [mujoco.MjData(model) for _ in range(count)])
            while len(self._datas) > 8:
                self._datas.pop(next(iter(self._datas)))
        shape = (starts.shape[0], controls.shape[1], starts.shape[1])
        if shape not in self._buffers:
            if len(self._buffers) > 1:
                self._buffers.clear()
            self._buffers[shape] = np.empty(shape)
        states = self._buffers[shape]
        sensors = np.empty((shape[0], shape[1], model.nsensordata))  # else made every time
        with headless(model):
            self._pool.rollout(
                model, self._datas[key][1], starts, controls, state=states, sensordata=sensors
            )
        self.rollouts += shape[0] / self.windows
        return states

    def _predicted(
        self, variant: Variant, states: np.ndarray, samples: int | None = None
    ) -> np.ndarray:
        """Predictions at the samples of all windows, shape (windows, channels, samples)."""
        model = variant.model
        seen = states[:, self.substeps - 1 :: self.substeps]
        plugin = offset(model, PLUGIN)
        out = np.empty((len(states), len(self.channels), samples or self.samples))
        for k, channel in enumerate(self.channels):
            if channel.chamber and channel.cylinder:
                index = plugin + variant.slot(channel.cylinder, channel.chamber)
            else:
                index = 1 + int(model.joint(channel.joint).qposadr[0])
            out[:, k] = seen[:, :, index]
        return out
