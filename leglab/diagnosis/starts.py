"""Bristles of joints at rest: what friction holds there follows from the balance of forces.

A bristle that slid further than it bends is known from the motion (`bristle`). At rest the
measured motion is all noise, and the balance says what dry friction carries; where several
bristles rest on one joint (a cylinder's seals, a bearing) they share it by their limits.
"""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from leglab.diagnosis.model import CYLINDER, FRICTION, Change, Machine, Measured, Variant
from leglab.diagnosis.paths import play
from leglab.diagnosis.windows import Channel, Cut, derivative, smoothed
from leglab.machine.parameters import PluginTable

# A bristle forgets over some tenths of a millimetre; this much history is enough.
_BRISTLE_HISTORY = 0.5  # s

# Fills hidden states into `state`, shape (windows, npluginstate), for one instance.
Rule = Callable[[Machine, Measured, Variant, str, np.ndarray], None]
_RULES: dict[str, Rule] = {}


def reconstructs(plugin: str) -> Callable[[Rule], Rule]:
    """Registers how the hidden states of a plugin's instances follow from measured series."""

    def add(rule: Rule) -> Rule:
        _RULES[plugin] = rule
        return rule

    return add


def reconstruct(machine: Machine, measured: Measured, variant: Variant, state: np.ndarray) -> None:
    """Fills the hidden states of all plugin instances in place.

    Args:
        machine: The unmodified machine.
        measured: Series of one recording.
        variant: Compiled model.
        state: Parameters and states at window starts, shape (windows, npluginstate).
    """
    for element, (_, table) in variant.elements.items():
        if table.plugin in _RULES:
            _RULES[table.plugin](machine, measured, variant, element, state)


def bristle(
    velocity: np.ndarray, level: np.ndarray, sigma: float, period: float, samples: np.ndarray
) -> np.ndarray:
    """LuGre bristle at samples, shape (windows,), by its exact solution between samples.

    z' = v - sigma |v| z / g with v and g held over a sample (Canudas de Wit et al. 1995).

    Args:
        velocity: Of sliding, shape (n,).
        level: Steady friction g, shape (n,).
        sigma: Bristle stiffness.
        period: s.
        samples: Where it is wanted.
    """
    if sigma <= 0.0:
        return np.zeros(samples.size)
    decay = sigma * np.abs(velocity) / level * period
    gain = np.sign(velocity) * level / sigma * -np.expm1(-decay)
    history = np.arange(-round(_BRISTLE_HISTORY / period), 0)
    index = samples[:, None] + history
    before = index < 0
    index = index.clip(0)
    passed = np.where(before, 0.0, decay[index])
    # Everything that fades after sample j, exclusive of j itself.
    later = np.cumsum(passed[:, ::-1], axis=1)[:, ::-1] - passed
    return np.sum(np.where(before, 0.0, gain[index]) * np.exp(-later), axis=1)


def spool(command: np.ndarray, frequency: float, damping: float, period: float) -> np.ndarray:
    """Spool position and velocity, shape (n, 2), that follow a held command from rest.

    Args:
        command: Shape (n,).
        frequency: rad/s.
        damping: Damping ratio.
        period: s.
    """
    w, z = frequency, damping
    transition = expm(np.array([[0.0, 1.0], [-w * w, -2.0 * z * w]]) * period)
    drive = (np.eye(2) - transition) @ np.array([1.0, 0.0])
    # x[k+1] = A x[k] + b u[k] as two filters with the characteristic polynomial of A.
    trace, determinant = np.trace(transition), np.linalg.det(transition)
    first = command[0]
    out = []
    for row in (0, 1):
        other = 1 - row
        cross = transition[row, other] * drive[other] - transition[other, other] * drive[row]
        numerator = [0.0, drive[row], cross]
        out.append(lfilter(numerator, [1.0, -trace, determinant], command - first))
    return np.stack([out[0] + first, out[1]], axis=1)


@reconstructs(CYLINDER)
def _cylinder(
    machine: Machine, measured: Measured, variant: Variant, element: str, state: np.ndarray
) -> None:
    start, table = variant.elements[element]

    def get(name: str) -> float:
        return float(state[0, start + table.entry(name).offset])

    def put(name: str, values: np.ndarray) -> None:
        state[:, start + table.entry(name).offset] = values

    samples = measured.samples
    command = np.clip(measured.command[element], -1.0, 1.0)
    behind = play(command, get("hysteresis"))
    target = np.clip(behind + get("null_bias"), -1.0, 1.0)
    moved = spool(target, 2.0 * np.pi * get("bandwidth_hz"), get("damping_ratio"), measured.period)
    put("play_output", behind[np.maximum(samples - 1, 0)])
    put("spool_position", np.clip(moved[samples, 0], -1.0, 1.0))
    put("spool_velocity", moved[samples, 1])

    velocity = measured.piston_velocity[element]
    joint = machine.driven[element][0]
    pressures = sum(measured.pressure.get(f"{joint}_pressure_{c}", 0.0) for c in "ab")
    seal = get("pressure_coefficient") * np.maximum(pressures, 0.0)
    share = np.exp(-((velocity / get("stribeck_velocity")) ** 2))
    level = get("coulomb") + seal + (get("static") - get("coulomb")) * share
    level = np.maximum(level, 1e-9)
    sigma = get("sigma_0")
    if sigma <= 0.0:
        return
    put("bristle", bristle(velocity, level, sigma, measured.period, samples))


@reconstructs(FRICTION)
def _joint_friction(
    machine: Machine, measured: Measured, variant: Variant, element: str, state: np.ndarray
) -> None:
    start, table = variant.elements[element]

    def get(name: str) -> float:
        return float(state[0, start + table.entry(name).offset])

    joint = variant.joint_of[element]
    velocity = measured.velocity[joint]
    share = np.exp(-((velocity / get("stribeck_velocity")) ** 2))
    level = get("coulomb") + (get("static") - get("coulomb")) * share
    side = 1.0 + np.sign(velocity) * get("direction_asymmetry")
    level = np.maximum(level * get("wear") * side, 1e-9)
    values = bristle(velocity, level, get("sigma_0"), measured.period, measured.samples)
    state[:, start + table.entry("bristle").offset] = values


# A bristle that slid less than twice its deflection in this time rests.
_REST = 0.03  # s


@dataclass(frozen=True, kw_only=True, eq=False)
class Bristle:
    """A bristle on a joint, at every window start; arrays of shape (windows,).

    Attributes:
        slot: Place of its deflection in the plugin state.
        stiffness: sigma_0, force a deflection.
        lever: d(deflection)/d(joint position) while it sticks.
        forward: Largest friction against motion towards positive joint positions, as a force on
            the joint.
        backward: The same for the other direction, positive.
    """

    slot: int
    stiffness: float
    lever: np.ndarray
    forward: np.ndarray
    backward: np.ndarray

    @property
    def travel(self) -> np.ndarray:
        """Full deflection as a travel of the joint."""
        most = np.maximum(self.forward, self.backward)
        return most / (self.lever**2 * self.stiffness + 1e-300)


def bristles(
    machine: Machine, measured: Measured, variant: Variant, state: np.ndarray, joint: str
) -> list[Bristle]:
    """Bristles that act on a joint.

    Args:
        machine: The unmodified machine.
        measured: Series of one recording.
        variant: Compiled model.
        state: Parameters and states at window starts, shape (windows, npluginstate).
        joint: Name.
    """
    found = []
    for element, (start, table) in variant.elements.items():
        seal = table.plugin == CYLINDER and joint in machine.driven[element]
        if not seal and (table.plugin != FRICTION or variant.joint_of[element] != joint):
            continue

        def get(name: str, start: int = start, table: PluginTable = table) -> np.ndarray:
            return state[:, start + table.entry(name).offset]

        stiffness = float(get("sigma_0")[0])
        if stiffness <= 0.0:
            continue
        slot = start + table.entry("bristle").offset
        breakaway = np.maximum(get("coulomb"), get("static"))
        if seal:
            lever = measured.lever[element][measured.samples]
            pressures = [measured.pressure.get(f"{joint}_pressure_{c}") for c in "ab"]
            total = sum(p[measured.samples] for p in pressures if p is not None)
            seals = get("pressure_coefficient") * np.maximum(total, 0.0)
            forward = backward = np.abs(lever) * (breakaway + seals)
        else:
            lever = np.ones(len(state))
            half = 0.5 * get("coulomb_difference")
            forward, backward = (
                get("wear")
                * (1.0 + side * get("direction_asymmetry"))
                * np.maximum(breakaway + side * half + get("load"), 0.0)
                for side in (1.0, -1.0)
            )
        found.append(
            Bristle(slot=slot, stiffness=stiffness, lever=lever, forward=forward, backward=backward)
        )
    return found


def balance(machine: Machine, measured: Measured, variant: Variant, state: np.ndarray) -> None:
    """Sets the deflection of resting bristles in place.

    Joints of cylinders without measured pressures are left as they are.

    Args:
        machine: The unmodified machine.
        measured: Series of one recording.
        variant: Compiled model.
        state: Parameters and states at window starts, shape (windows, npluginstate).
    """
    for joint in machine.joints:
        acting = bristles(machine, measured, variant, state, joint)
        cylinders = [c for c in machine.instances(CYLINDER) if joint in machine.driven[c]]
        chambers = [f"{joint}_pressure_{c}" for c in "ab"]
        if not acting or (cylinders and not all(c in measured.pressure for c in chambers)):
            continue
        position = measured.position[joint]
        back = np.maximum(measured.samples - round(_REST / measured.period), 0)
        travel = np.abs(position[measured.samples] - position[back])
        resting = np.stack([travel < 2.0 * bristle.travel for bristle in acting])
        rows = np.flatnonzero(resting.any(axis=0))
        if not rows.size:
            continue
        for bristle, rests in zip(acting, resting, strict=True):
            state[rests, bristle.slot] = 0.0
        held = _unbalanced(machine, measured, variant, state, rows, joint)
        limit = np.stack([np.where(held > 0, b.forward[rows], b.backward[rows]) for b in acting])
        limit *= resting[:, rows]
        share = held / np.maximum(limit.sum(axis=0), np.abs(held) + 1e-300)
        for bristle, rests, part in zip(acting, resting[:, rows], limit * share, strict=True):
            deflection = part / (bristle.lever[rows] * bristle.stiffness)
            state[rows[rests], bristle.slot] = deflection[rests]


def _unbalanced(
    machine: Machine,
    measured: Measured,
    variant: Variant,
    state: np.ndarray,
    rows: np.ndarray,
    joint: str,
) -> np.ndarray:
    """Force on a joint that the measured motion leaves over at some windows, (rows,)."""
    model = variant.model
    data = mujoco.MjData(model)
    dof = int(model.joint(joint).dofadr[0])
    out = np.empty(rows.size)
    for i, (row, k) in enumerate(zip(rows.tolist(), measured.samples[rows].tolist(), strict=True)):
        data.plugin_state[:] = state[row]
        for name in machine.joints:
            data.qpos[model.joint(name).qposadr[0]] = measured.position[name][k]
            data.qvel[model.joint(name).dofadr[0]] = measured.velocity[name][k]
        for number, name in enumerate(machine.actuators):
            data.ctrl[number] = measured.command[name][k]
        mujoco.mj_forward(model, data)
        for name in machine.joints:
            v = measured.velocity[name]
            slope = (v[k + 1] - v[k - 1]) / (2.0 * measured.period)
            data.qacc[model.joint(name).dofadr[0]] = slope
        mujoco.mj_inverseSkip(model, data, mujoco.mjtStage.mjSTAGE_VEL, 1)
        out[i] = data.qfrc_actuator[dof] - data.qfrc_inverse[dof]
    return out


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
    balance(machine, measured, variant, plugin)
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
