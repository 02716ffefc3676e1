"""States in which windows start: measured, smoothed, reconstructed."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leglab.diagnosis import rest
from leglab.diagnosis.change import Change, Measured
from leglab.diagnosis.cutting import Cut
from leglab.diagnosis.machine import CYLINDER, Machine, Variant
from leglab.diagnosis.series import Channel, derivative, smoothed
from leglab.diagnosis.states import reconstruct

STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
PLUGIN = mujoco.mjtState.mjSTATE_PLUGIN


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


def measure(
    machine: Machine, cut: Cut, channels: tuple[Channel, ...], change: Change
) -> tuple[Measured, dict[str, np.ndarray]]:
    """Smoothed series under the sensor and command faults of a change, and corrected columns."""
    series, period = cut.series, cut.series.period
    corrected = {}
    for channel in channels:
        samples = series.columns[channel.column]
        for function, _ in change.corrections.get(channel.column, ()):
            samples = function(samples, period)
        corrected[channel.column] = samples
    position, velocity, pressure = {}, {}, {}
    for channel in channels:
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
    for actuator in machine.actuators:
        samples = series.columns[f"{actuator}_command"]
        for path in change.commands.get(actuator, ()):
            samples = path(samples, period)
        command[actuator] = samples
    measured = Measured(
        period=period,
        position=position,
        velocity=velocity,
        piston_velocity={
            cylinder: lever * velocity[machine.driven[cylinder][0]]
            for cylinder, lever in cut.levers.items()
        },
        lever=cut.levers,
        command=command,
        pressure=pressure,
        samples=cut.firsts,
    )
    return measured, corrected


def start_states(
    machine: Machine,
    cut: Cut,
    change: Change,
    variant: Variant,
    parameters: np.ndarray,
    measured: Measured,
    channels: tuple[Channel, ...],
    *,
    pressures: np.ndarray | None = None,
    nudge: Nudge | None = None,
) -> np.ndarray:
    """Full physics states at window starts, shape (windows, nstate).

    Args:
        machine: The unmodified machine.
        cut: Windows.
        change: What the hypothesis changes.
        variant: Compiled model.
        parameters: Plugin state with parameters set, (npluginstate,).
        measured: Smoothed series; its samples say where windows start.
        channels: What is measured.
        pressures: Of the chambers where none are measured, (windows, 2 cylinders).
        nudge: Departure from these states.
    """
    model, firsts = variant.model, measured.samples
    plugin = np.tile(parameters, (firsts.size, 1))
    qpos = np.tile(variant.qpos, (firsts.size, 1))
    qvel = np.zeros((firsts.size, model.nv))
    lag = 0.5 * machine.timestep
    for joint in machine.joints:
        q, v = measured.position[joint], measured.velocity[joint]
        qpos[:, model.joint(joint).qposadr[0]] = q[firsts]
        # MuJoCo's velocity lags half a step behind its position.
        slope = (v[firsts + 1] - v[firsts - 1]) / (2.0 * measured.period)
        qvel[:, model.joint(joint).dofadr[0]] = v[firsts] - lag * slope
    for channel in channels:
        if channel.chamber and channel.cylinder:
            slot = variant.slot(channel.cylinder, channel.chamber)
            plugin[:, slot] = measured.pressure[channel.column][firsts]
    if pressures is not None:
        slots = pressure_slots(machine, variant)
        plugin[:, slots] = pressures
    reconstruct(machine, measured, variant, plugin)
    for (element, name), function in change.starts.items():
        plugin[:, variant.slot(element, name)] = function(measured, variant, plugin)
    rest.balance(machine, measured, variant, plugin)
    if nudge is not None:
        if nudge.quantity == "position":
            qpos[:, model.joint(nudge.joint).qposadr[0]] += nudge.size
        elif nudge.quantity == "velocity":
            qvel[:, model.joint(nudge.joint).dofadr[0]] += nudge.size
        else:
            plugin[:, variant.slot(nudge.cylinder, nudge.quantity)] += nudge.size
    return _assemble(model, cut.series.time[firsts], qpos, qvel, plugin)


def pressure_slots(machine: Machine, variant: Variant) -> np.ndarray:
    """Places of all chamber pressures in the plugin state: A and B of each cylinder in turn."""
    return np.array(
        [
            variant.slot(cylinder, chamber)
            for cylinder in machine.instances(CYLINDER)
            for chamber in ("pressure_a", "pressure_b")
        ],
        dtype=int,
    )


def offset(model: mujoco.MjModel, part: mujoco.mjtState) -> int:
    """Place of a part in the full physics state: parts follow in the order of their bits."""
    below = int(STATE) & (int(part) - 1)
    return mujoco.mj_stateSize(model, below) if below else 0


def _assemble(
    model: mujoco.MjModel,
    time: np.ndarray,
    qpos: np.ndarray,
    qvel: np.ndarray,
    plugin: np.ndarray,
) -> np.ndarray:
    states = np.zeros((time.size, mujoco.mj_stateSize(model, STATE)))
    states[:, 0] = time
    states[:, 1 : 1 + model.nq] = qpos
    states[:, 1 + model.nq : 1 + model.nq + model.nv] = qvel
    start = offset(model, PLUGIN)
    states[:, start : start + model.npluginstate] = plugin
    return states
