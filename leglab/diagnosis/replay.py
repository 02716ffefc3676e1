"""Replay of measured commands over short windows that start from measured states."""

from copy import copy
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np
from mujoco import rollout
from scipy.ndimage import maximum_filter1d

from leglab.diagnosis.change import Change, Measured
from leglab.diagnosis.machine import CYLINDER, Machine, Variant
from leglab.diagnosis.series import (
    Channel,
    Series,
    derivative,
    filter_difference,
    noise_level,
    smoothed,
)
from leglab.diagnosis.states import reconstruct

_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_PLUGIN = mujoco.mjtState.mjSTATE_PLUGIN
# Smoothing filters reach this far to both sides of a window's start.
_MARGIN = 12  # samples
# Windows start at the calmest sample within this share of their length from the regular grid.
_ROOM = 0.35
# A chamber this low may hold vapour, whose amount no pressure sensor tells: no window starts there.
_VAPOUR = 2e4  # Pa gauge
# A prediction further off than this many noise levels is lost; how far does not matter any more.
_LOST = 1e5


@dataclass(frozen=True, kw_only=True)
class Layout:
    """How recordings are cut.

    Attributes:
        window: Length of a window [s].
        bin: Predictions and data are averaged over this time [s].
    """

    window: float = 0.3
    bin: float = 0.01


@dataclass(frozen=True, kw_only=True)
class Nudge:
    """Departure from the reconstructed start states, to see how predictions depend on them.

    Attributes:
        joint: Whose position or velocity moves.
        cylinder: Whose pressure or bristle moves.
        quantity: "position", "velocity", "pressure_a", "pressure_b" or "bristle".
        size: rad, rad/s, Pa or m.
    """

    joint: str = ""
    cylinder: str = ""
    quantity: str
    size: float


@dataclass(kw_only=True)
class _Cut:
    """Windows of one series: first samples, shape (windows,), and the levers of its cylinders."""

    series: Series
    firsts: np.ndarray
    levers: dict[str, np.ndarray] = field(default_factory=dict)
    smooth: dict[str, tuple[np.ndarray, ...]] = field(default_factory=dict)


class Replay:
    """Windows of several recordings, replayed together by `mujoco.rollout` threads.

    Args:
        machine: Its time step must divide the sampling period.
        series: Recordings of one sampling period.
        channels: What is predicted.
        layout: How recordings are cut.
        threads: Of the rollouts.

    Attributes:
        recording: Index of each window's recording, shape (windows,).
        start: Time at which each window starts [s], shape (windows,).
        bins: Number of bins in a window.
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
        self._cuts = [self._cut(one) for one in series]
        self.recording = np.concatenate(
            [np.full(c.firsts.size, i) for i, c in enumerate(self._cuts)]
        )
        self.start = np.concatenate([c.series.time[c.firsts] for c in self._cuts])
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
        variant = self.machine.variant(tuple(change.edits))
        parameters = variant.plugin_state.copy()
        for (element, name), value in change.parameters.items():
            parameters[variant.slot(element, name)] = value
        starts, controls, targets = [], [], []
        for number, whole in enumerate(self._cuts):
            cut = whole
            if chosen is not None:
                cut = replace(whole, firsts=whole.firsts[chosen[self.recording == number]])
            if cut.firsts.size:
                measured, corrected = self._measure(cut, change)
                starts.append(self._states(cut, change, variant, parameters, measured, nudge))
                index = cut.firsts[:, None] + np.arange(self.samples)
                controls.append(self._controls(measured, index))
                index = index + 1
                targets.append(np.stack([corrected[c.column][index] for c in self.channels], 1))
        predicted = self._roll(variant, np.concatenate(starts), np.concatenate(controls))
        errors = np.concatenate(targets) - predicted
        for k, channel in enumerate(self.channels):
            gains = [gain for _, gain in change.corrections.get(channel.column, ())]
            self.noise_gain[k] = np.prod(gains) if gains else 1.0
        shape = (len(errors), len(self.channels), self.bins, self._per_bin)
        binned = errors.reshape(shape).mean(axis=3)
        return np.nan_to_num(binned, nan=1e12, posinf=1e12, neginf=-1e12)

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

    def _cut(self, series: Series) -> _Cut:
        last = series.time.size - self.samples - _MARGIN - 1
        step = self.samples
        unrest = self._unrest(series)
        room = round(_ROOM * step)
        grid = np.arange(_MARGIN, last + 1, step)
        firsts = np.array(
            [g + int(np.argmin(unrest[g : min(g + room, last) + 1])) for g in grid], dtype=int
        )
        whole = np.concatenate([[0], np.cumsum(~series.valid)])
        keep = whole[firsts + self.samples + 1] == whole[firsts]
        for channel in self.channels:
            if channel.chamber:
                level = smoothed(series.columns[channel.column], channel.filter)
                keep &= level[firsts] > _VAPOUR
        cut = _Cut(series=series, firsts=firsts[keep])
        for cylinder in self.machine.instances(CYLINDER):
            cut.levers[cylinder] = self._lever(series, cylinder)
        return cut

    def _unrest(self, series: Series) -> np.ndarray:
        """How badly smoothing serves around each sample, (n,): windows start where it is calm.

        What two filters disagree about, in noise levels, and jumps of the commands.
        """
        total = np.zeros(series.time.size)
        for channel in self.channels:
            samples = series.columns[channel.column]
            level = noise_level(samples, channel.filter) or 1.0
            length = max(2 * _MARGIN - 3, channel.filter[0])
            total += (filter_difference(samples, (length, 4)) / level) ** 2
        for actuator in self.machine.actuators:
            command = series.columns[f"{actuator}_command"]
            jump = np.abs(np.gradient(command)) / (command.std() or 1.0)
            total += (10.0 * jump) ** 2
        return maximum_filter1d(total, 2 * _MARGIN + 1)

    def _lever(self, series: Series, cylinder: str) -> np.ndarray:
        """d(actuator length)/d(joint position) over a series, shape (n,), every tenth exact."""
        model = self.machine.base.model
        data = mujoco.MjData(model)
        actuator = model.actuator(cylinder).id
        joint = self.machine.driven[cylinder][0]
        dof = int(model.joint(joint).dofadr[0])
        moment = np.zeros((model.nu, model.nv))
        chosen = np.arange(0, series.time.size, 10)
        lever = np.empty(chosen.size)
        addresses = [int(model.joint(name).qposadr[0]) for name in self.machine.joints]
        positions = np.stack(
            [series.columns[f"{name}_position"] for name in self.machine.joints], 1
        )
        for i, row in enumerate(positions[chosen]):
            data.qpos[addresses] = row
            mujoco.mj_fwdPosition(model, data)
            mujoco.mju_sparse2dense(
                moment,
                data.actuator_moment,
                data.moment_rownnz,
                data.moment_rowadr,
                data.moment_colind,
            )
            lever[i] = moment[actuator, dof]
        return np.interp(np.arange(series.time.size), chosen, lever)

    def _measure(self, cut: _Cut, change: Change) -> tuple[Measured, dict[str, np.ndarray]]:
        series, period = cut.series, self._period
        corrected = {}
        for channel in self.channels:
            samples = series.columns[channel.column]
            for function, _ in change.corrections.get(channel.column, ()):
                samples = function(samples, period)
            corrected[channel.column] = samples
        position, velocity, pressure = {}, {}, {}
        for channel in self.channels:
            column, known = channel.column, cut.smooth.get(channel.column)
            if known is None or column in change.corrections:
                smooth = smoothed(corrected[column], channel.filter)
                known = (smooth, derivative(corrected[column], channel.filter, period))
                if column not in change.corrections:
                    cut.smooth[column] = known
            if channel.chamber:
                pressure[column] = known[0]
            else:
                position[channel.joint], velocity[channel.joint] = known
        command = {}
        for actuator in self.machine.actuators:
            samples = series.columns[f"{actuator}_command"]
            for path in change.commands.get(actuator, ()):
                samples = path(samples, period)
            command[actuator] = samples
        measured = Measured(
            period=period,
            position=position,
            velocity=velocity,
            piston_velocity={
                cylinder: lever * velocity[self.machine.driven[cylinder][0]]
                for cylinder, lever in cut.levers.items()
            },
            lever=cut.levers,
            command=command,
            pressure=pressure,
            samples=cut.firsts,
        )
        return measured, corrected

    def _states(
        self,
        cut: _Cut,
        change: Change,
        variant: Variant,
        parameters: np.ndarray,
        measured: Measured,
        nudge: Nudge | None,
    ) -> np.ndarray:
        """Full physics states at window starts, shape (windows, nstate)."""
        model, firsts = variant.model, cut.firsts
        plugin = np.tile(parameters, (firsts.size, 1))
        qpos = np.tile(variant.qpos, (firsts.size, 1))
        qvel = np.zeros((firsts.size, model.nv))
        lag = 0.5 * self.machine.timestep
        for joint in self.machine.joints:
            q, v = measured.position[joint], measured.velocity[joint]
            qpos[:, model.joint(joint).qposadr[0]] = q[firsts]
            # MuJoCo's velocity lags half a step behind its position.
            slope = (v[firsts + 1] - v[firsts - 1]) / (2.0 * self._period)
            qvel[:, model.joint(joint).dofadr[0]] = v[firsts] - lag * slope
        for channel in self.channels:
            if channel.chamber and channel.cylinder:
                slot = variant.slot(channel.cylinder, channel.chamber)
                plugin[:, slot] = measured.pressure[channel.column][firsts]
        reconstruct(self.machine, measured, variant, plugin)
        for (element, name), function in change.starts.items():
            plugin[:, variant.slot(element, name)] = function(measured, variant, plugin)
        if nudge is not None:
            if nudge.quantity == "position":
                qpos[:, model.joint(nudge.joint).qposadr[0]] += nudge.size
            elif nudge.quantity == "velocity":
                qvel[:, model.joint(nudge.joint).dofadr[0]] += nudge.size
            else:
                plugin[:, variant.slot(nudge.cylinder, nudge.quantity)] += nudge.size
        return _assemble(model, cut.series.time[firsts], qpos, qvel, plugin)

    def _roll(self, variant: Variant, starts: np.ndarray, controls: np.ndarray) -> np.ndarray:
        """Predictions at the samples of all windows, shape (windows, channels, samples)."""
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
            self._buffers = {shape: np.empty(shape)}
        states = self._buffers[shape]
        sensors = np.empty((shape[0], shape[1], model.nsensordata))
        self._pool.rollout(
            model, self._datas[key][1], starts, controls, state=states, sensordata=sensors
        )
        self.rollouts += shape[0] / self.windows
        seen = states[:, self.substeps - 1 :: self.substeps]
        plugin = _offset(model, _PLUGIN)
        out = np.empty((shape[0], len(self.channels), self.samples))
        for k, channel in enumerate(self.channels):
            if channel.chamber and channel.cylinder:
                index = plugin + variant.slot(channel.cylinder, channel.chamber)
            else:
                index = 1 + int(model.joint(channel.joint).qposadr[0])
            out[:, k] = seen[:, :, index]
        return out


def _offset(model: mujoco.MjModel, part: mujoco.mjtState) -> int:
    """Place of a part in the full physics state: parts follow in the order of their bits."""
    below = int(_STATE) & (int(part) - 1)
    return mujoco.mj_stateSize(model, below) if below else 0


def _assemble(
    model: mujoco.MjModel,
    time: np.ndarray,
    qpos: np.ndarray,
    qvel: np.ndarray,
    plugin: np.ndarray,
) -> np.ndarray:
    states = np.zeros((time.size, mujoco.mj_stateSize(model, _STATE)))
    states[:, 0] = time
    states[:, 1 : 1 + model.nq] = qpos
    states[:, 1 + model.nq : 1 + model.nq + model.nv] = qvel
    start = _offset(model, _PLUGIN)
    states[:, start : start + model.npluginstate] = plugin
    return states
