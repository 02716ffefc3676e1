"""Start states of windows: measured motion, and hidden states reconstructed from this motion.

At rest the measured velocity is only noise. Dry friction (a LuGre "bristle" that deflects) is then
computed from the balance of forces; several bristles on one joint (a cylinder's seals, a bearing)
share it in proportion to their limits. A joint in contact keeps the deflection of its last slide.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from leglab._native import hydraulics as native
from leglab.diagnosis.plant import moments
from leglab.diagnosis.plant.activation import INTEGRATOR, activations, attributes
from leglab.diagnosis.plant.model import (
    CHAMBERS,
    CYLINDER,
    FRICTION,
    Change,
    Machine,
    Measured,
    Variant,
)
from leglab.diagnosis.plant.paths import play
from leglab.diagnosis.replay.windows import Channel, Cut, smoothed
from leglab.diagnosis.thresholds import FLANK, PRESSED

# Parameters of a cylinder that change the flow from its supply at known pressures.
FLOW = (
    *("rated_flow", "rated_pressure_drop", "flow_asymmetry", "laminar_transition_pressure"),
    *("lap", "lap_difference_tank", "lap_difference_chambers", "edge_rounding", "edge_exponent"),
)
# Sliding speed at break-away [m/s or rad/s], at which the Stribeck curve peaks: nearly zero.
_BREAKAWAY = np.finfo(float).tiny


class Nudge(NamedTuple):
    """Perturbation by `size` [rad, rad/s, Pa or m] of one start state of all windows.

    The state is a quantity of an element, named as in `place`.
    """

    element: str
    quantity: str
    size: float


def bristle(velocity: np.ndarray, level: np.ndarray, sigma: float, period: float) -> np.ndarray:
    """Computes the deflection z of a LuGre bristle that starts at 0; all (n,).

    Solves z' = v - sigma |v| z / g with v and g, the steady friction `level`, held over a sample
    (Canudas de Wit et al. 1995).
    """
    out = np.empty(velocity.size)
    native.bristle(velocity, level, max(sigma, 0.0), period, out)
    return out


def spool(command: np.ndarray, frequency: float, damping: float, period: float) -> np.ndarray:
    """Computes spool position and velocity, (n, 2), from rest under held commands, (n,).

    `frequency` is angular [rad/s], `damping` a ratio, `period` the sampling period [s].
    """
    out = np.empty((command.size, 2))
    native.spool(command, frequency, damping, period, out)
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class Instances:
    """Parameters and states of all plugin instances at window starts; methods write to `state`."""

    machine: Machine  #: The unmodified machine
    measured: Measured  #: Series of one recording
    variant: Variant  #: Compiled model with the hypothesis's changes
    state: np.ndarray  #: Parameters and states at window starts, shape (windows, npluginstate)
    #: Reconstructed series by element and name, each (n,): "spool_position", "bristle", and the
    #: quantity "carried" on which friction depends, that is, a joint's load or the sum of a
    #: cylinder's gauge pressures.
    followed: dict[tuple[str, str], np.ndarray] = field(default_factory=dict)

    def get(self, element: str, name: str) -> np.ndarray:
        """Returns a parameter or state at window starts, shape (windows,); a view."""
        return self.state[:, self.variant.slot(element, name)]

    def value(self, element: str, name: str) -> float:
        """Returns a parameter that is the same in all windows."""
        return float(self.get(element, name)[0])

    def put(self, element: str, name: str, values: np.ndarray) -> None:
        """Sets a state at window starts, shape (windows,)."""
        self.state[:, self.variant.slot(element, name)] = values

    def pressures(self, joint: str) -> dict[str, np.ndarray]:
        """Returns measured pressures of a joint by chamber, each (n,)."""
        known = self.measured.pressure
        return {c: known[f"{joint}_{c}"] for c in CHAMBERS if f"{joint}_{c}" in known}

    def chambers(self, cylinder: str) -> list[np.ndarray]:
        """Returns measured pressures of a cylinder's chambers, each (n,)."""
        return [*self.pressures(self.machine.driven[cylinder][0]).values()]

    def reconstruct(self) -> None:
        """Sets the hidden states of cylinders, joint friction and supplies from measured series.

        A supply keeps its initial state if pressures of one of its cylinders are not measured.
        """
        # Cylinders are set first, because the load of joint friction depends on their forces.
        for plugin, follow in ((CYLINDER, self._cylinder), (FRICTION, self._joint_friction)):
            for element, (_, table) in self.variant.elements.items():
                if table.plugin == plugin:
                    follow(element)
        for supply, cylinders in self.variant.drawn_by.items():
            self._supply(supply, cylinders)

    def _cylinder(self, element: str) -> None:
        measured, samples = self.measured, self.measured.samples
        command = measured.command[element]
        names = ("hysteresis", "null_bias", "bandwidth_hz", "damping_ratio")
        hysteresis, bias, bandwidth, damping = given = [self.value(element, n) for n in names]

        def followed() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            behind = play(np.clip(command, -1.0, 1.0), hysteresis)
            shifted = np.clip(behind + bias, -1.0, 1.0)
            moved = spool(shifted, 2.0 * np.pi * bandwidth, damping, measured.period)
            return behind, moved[:, 0], moved[:, 1]

        by = command, np.array(given)
        behind, position, speed = measured.hidden_states.get(f"spool of {element}", by, followed)
        self.followed[element, "spool_position"] = position
        self.put(element, "play_output", behind[np.maximum(samples - 1, 0)])
        self.put(element, "spool_position", np.clip(position[samples], -1.0, 1.0))
        self.put(element, "spool_velocity", speed[samples])
        velocity = measured.piston_velocity[element]
        carried = sum(self.chambers(element), np.zeros(velocity.size))
        level = self._slide(element, velocity, carried)
        if self.value(element, "play") > 0.0:
            self._seat(element, velocity, level)

    def _seat(self, element: str, velocity: np.ndarray, level: np.ndarray) -> None:
        """Places a piston at the flank of the pin's play against which it pressed last.

        A piston crosses the play within milliseconds; only friction can hold it between flanks.
        """
        samples, play = self.measured.samples, self.value(element, "play")
        pressures = self.chambers(element)
        if len(pressures) < len(CHAMBERS):
            return
        bore, rod = self.value(element, "bore"), self.value(element, "rod")
        cap, ring = bore**2, bore**2 - rod**2
        force = 0.25 * np.pi * (cap * pressures[0] - ring * pressures[1])
        stuck = self.value(element, "sigma_0") * self.followed[element, "bristle"]
        pressed = force - stuck - self.value(element, "viscous") * velocity
        sure = np.abs(pressed) > PRESSED * level
        last = np.maximum.accumulate(np.where(sure, np.arange(sure.size), -1))
        side = np.where(last >= 0, np.sign(pressed[last]), np.sign(force[0]))
        stiffness = self.value(element, "play_stiffness")
        reach = 0.5 * play + np.maximum(np.abs(pressed / stiffness), FLANK / stiffness)
        self.put(element, "play_offset", (side * reach)[samples])
        before = 0.5 * self.machine.timestep * np.gradient(velocity, self.measured.period)
        self.put(element, "pin_load", -pressed[samples])
        self.put(element, "piston_velocity", (velocity - before)[samples])
        self.put(element, "seated_play", np.full(samples.size, play))

    def _supply(self, element: str, cylinders: tuple[str, ...]) -> None:
        """Sets a supply's pressure, which falls with the flow to its cylinders."""
        chambers = [self.chambers(cylinder) for cylinder in cylinders]
        if not cylinders or any(len(pair) < len(CHAMBERS) for pair in chambers):
            return
        period, samples = self.measured.period, self.measured.samples
        supply = self._parameters(element)
        spools = [self.followed[cylinder, "spool_position"] for cylinder in cylinders]
        flow = np.array([[self.value(c, name) for name in FLOW] for c in cylinders])

        def followed() -> np.ndarray:
            # Steps of at most 0.5 ms, which is some hundredths of a supply's time constant.
            out, steps = np.empty(chambers[0][0].size), np.ceil(period / 5e-4 - 1e-9)
            whole = np.stack([self._parameters(c) for c in cylinders])
            caps, rods = (np.stack(series) for series in zip(*chambers, strict=True))
            position, substeps = np.stack(spools), max(1, int(steps))
            native.supply_pressure(supply, whole, position, caps, rods, period, substeps, out)
            return out

        by = supply, flow, *spools, *(one for pair in chambers for one in pair)
        pressure = self.measured.hidden_states.get(element, by, followed)
        self.put(element, "pressure", pressure[samples])
        self.put(element, "started", np.ones(samples.size))

    def _parameters(self, element: str) -> np.ndarray:
        """Returns all parameters of an element in the order of its table."""
        start, table = self.variant.elements[element]
        return self.state[0, start : start + len(table.parameters)].copy()

    def _joint_friction(self, element: str) -> None:
        """Sets the load |k_a qfrc_actuator + k_b qfrc_bias| and bristle of a joint's friction."""
        joint = self.variant.joint_of[element]
        velocity = self.measured.velocity[joint]
        names = (f"{load}_load_coefficient" for load in ("actuator", "bias"))
        shares = np.array([self.value(element, name) for name in names])
        load = np.zeros(velocity.size)
        if shares.any():
            chosen, forces = self._loads
            force = forces[:, int(self.variant.model.joint(joint).dofadr[0])]
            load = np.abs(np.interp(np.arange(velocity.size), chosen, force @ shares))
        self.put(element, "load", load[self.measured.samples])
        self._slide(element, velocity, load)

    @cached_property
    def _loads(self) -> tuple[np.ndarray, np.ndarray]:
        """Every 20th sample, with the actuator and bias forces on all joints, (samples, nv, 2).

        Loads change as slowly as the pose, so they are interpolated at all other samples.
        """
        measured, machine, model = self.measured, self.machine, self.variant.model
        count = measured.velocity[machine.joints[0]].size
        chosen = np.unique(np.append(np.arange(0, count, 20), count - 1))
        # Only cylinder states are set, so that the cached forces are valid for any joint friction.
        plugin = np.tile(self.variant.plugin_state, (chosen.size, 1))
        for cylinder in machine.cylinders:
            start, table = self.variant.elements[cylinder]
            plugin[:, start : start + len(table.parameters)] = self._parameters(cylinder)
            series = self.pressures(machine.driven[cylinder][0])
            for name, known in {**series, "bristle": self.followed[cylinder, "bristle"]}.items():
                plugin[:, self.variant.slot(cylinder, name)] = known[chosen]
        closed = plays(machine, self.variant)
        states = moments.states_at(machine, model, measured, chosen, plugin, without=closed)
        commands = moments.commands_at(machine, measured, chosen)

        def both() -> np.ndarray:
            found = moments.forces_at(model, states, commands)
            return np.stack([found.load, found.bias], axis=2)

        found = measured.hidden_states.get("loads", (states, commands), both, by=self.variant)
        return chosen, found

    def _sliding_friction(
        self, element: str, velocity: np.ndarray, at: np.ndarray | slice = slice(None)
    ) -> np.ndarray:
        """Computes the steady friction g at sliding velocities, by the plugin's law, (samples,)."""
        carried, out = self.followed[element, "carried"], np.empty(velocity.size)
        time = self.measured.start + self.measured.period * np.arange(carried.size)
        plugin, parameters = self.variant.elements[element][1].plugin, self._parameters(element)
        native.sliding_friction(plugin, parameters, velocity, carried[at], time[at], out)
        return out

    def _slide(self, element: str, velocity: np.ndarray, carried: np.ndarray) -> np.ndarray:
        """Computes a bristle along the series and sets it; returns its steady friction, (n,)."""
        self.followed[element, "carried"] = carried

        def slid() -> tuple[np.ndarray, np.ndarray]:
            level, sigma = self._sliding_friction(element, velocity), self.value(element, "sigma_0")
            return level, bristle(velocity, level, sigma, self.measured.period)

        given = self._parameters(element), velocity, carried
        level, deflection = self.measured.hidden_states.get(f"slide of {element}", given, slid)
        self.followed[element, "bristle"] = deflection
        self.put(element, "bristle", deflection[self.measured.samples])
        return level

    def balance(self, rest_time: float) -> None:
        """Sets the bristles of resting joints so that the forces on each joint balance.

        A bristle rests if it moved less than twice its full deflection in the last `rest_time` [s].
        Joints of cylinders without measured pressures, and joints that move followers, are skipped.
        """
        measured, samples = self.measured, self.measured.samples
        back = np.maximum(samples - round(rest_time / measured.period), 0)
        still: dict[str, tuple[list[_Bristle], np.ndarray]] = {}
        for joint in self.machine.joints:
            acting = self._bristles(joint)
            driven = joint in self.machine.on_cylinders
            if (
                joint in self.machine.leading
                or not acting
                or (driven and len(self.pressures(joint)) < len(CHAMBERS))
            ):
                continue
            travel = np.abs(measured.position[joint][samples] - measured.position[joint][back])
            # Contact forces at rest depend on speeds far below noise and are therefore unknown.
            free = ~measured.touched[joint][samples]
            resting = np.stack([free & (travel < 2.0 * one.travel) for one in acting])
            if resting.any():
                still[joint] = acting, resting
                for one, rests in zip(acting, resting, strict=True):
                    self.state[rests, one.slot] = 0.0
        if not still:
            return
        # A bristle acts on one joint, so one evaluation with all bristles at 0 serves all joints.
        rows = np.flatnonzero(np.any([resting.any(axis=0) for _, resting in still.values()], 0))
        left = self._unbalanced(rows, [*still])
        for held, (acting, resting) in zip(left.T, still.values(), strict=True):
            limit = np.stack([np.where(held > 0, *one.limits[:, rows]) for one in acting])
            limit *= resting[:, rows]
            share = held / np.maximum(limit.sum(axis=0), np.abs(held) + 1e-300)
            for one, rests, part in zip(acting, resting[:, rows], limit * share, strict=True):
                self.state[rows[rests], one.slot] = (part / one.slope[rows])[rests]

    def _bristles(self, joint: str) -> "list[_Bristle]":
        """Returns the bristles that act on a joint."""
        found = []
        for element, (_, table) in self.variant.elements.items():
            seal = table.plugin == CYLINDER and joint in self.machine.driven[element]
            if not seal and (table.plugin != FRICTION or self.variant.joint_of[element] != joint):
                continue
            stiffness = self.value(element, "sigma_0")
            if stiffness <= 0.0:
                continue
            samples = self.measured.samples
            lever = self.measured.lever[element][samples] if seal else np.ones(samples.size)
            sides = np.sign(lever) * np.array([[_BREAKAWAY], [-_BREAKAWAY]])
            friction = [self._sliding_friction(element, side, samples) for side in sides]
            limits = np.abs(lever) * np.stack(friction)
            travel = limits.max(axis=0) / (lever**2 * stiffness + 1e-300)
            slot = self.variant.slot(element, "bristle")
            found.append(_Bristle(slot, lever * stiffness, limits, travel))
        return found

    def _unbalanced(self, rows: np.ndarray, joints: list[str]) -> np.ndarray:
        """Computes residual forces on joints at the starts of windows `rows`, (rows, joints)."""
        machine, model, measured = self.machine, self.variant.model, self.measured
        measured = replace(measured, samples=measured.samples[rows])
        k, closed = measured.samples, plays(machine, self.variant)
        states = moments.states_at(machine, model, measured, k, self.state[rows], without=closed)
        slope = moments.accelerations(machine, model, measured, 1)
        found = moments.forces_at(model, states, moments.commands_at(machine, measured, k), slope)
        return -found.lacking[:, moments.dofs(model, joints)]


class _Bristle(NamedTuple):
    """A bristle on a joint at window starts; the last axis of arrays is (windows,)."""

    slot: int  # Index of its deflection in the plugin state.
    slope: np.ndarray  # d(force on the joint)/d(deflection).
    limits: np.ndarray  # Largest friction force in either direction, (2, windows).
    travel: np.ndarray  # Joint travel that causes the full deflection.


def measure(
    cut: Cut, channels: tuple[Channel, ...], change: Change
) -> tuple[Measured, dict[str, np.ndarray]]:
    """Applies a change's sensor and command paths; returns smooth series and corrected columns."""
    machine, series, period = change.machine, cut.series, cut.series.period
    sent = {a: series.columns[f"{a}_command"] for a in machine.actuators}
    command = {a: commanded(change, a, samples, period) for a, samples in sent.items()}
    corrected, position, velocity, pressure = {}, {}, {}, {}
    for channel in channels:
        samples = series.columns[channel.column]
        for function, _ in change.corrections.get(channel.column, ()):
            samples = function(samples, period)
        corrected[channel.column] = samples
        level, slope = cut.filtered(channel, samples)
        if channel.chamber:
            pressure[channel.column] = level
        else:
            position[channel.joint], velocity[channel.joint] = level, slope
    pushed: dict[str, np.ndarray] = {}
    # If a hypothesis puts a body between motor and joint, commands do not move the joint directly.
    if cut.pushes.actuators and cut.pushes.dofs == change.variant.model.nv:
        driven = _driven(cut, channels, command, position, velocity)
        for joint, own in zip(machine.joints, driven, strict=True):
            position[joint], velocity[joint], pushed[joint] = own

    if machine.followers is not None:
        _follow(cut, machine, position, velocity)

    def of_piston(cylinder: str) -> np.ndarray:
        moved = velocity[machine.driven[cylinder][0]]
        name = f"piston of {cylinder}"
        return cut.hidden_states.get(name, (moved,), lambda: cut.levers[cylinder] * moved)

    measured = Measured(
        period=period,
        position=position,
        velocity=velocity,
        piston_velocity={cylinder: of_piston(cylinder) for cylinder in cut.levers},
        lever=cut.levers,
        command=command,
        pressure=pressure,
        samples=cut.firsts,
        start=float(series.time[0]),
        touched=cut.touched,
        pushed=pushed,
        hidden_states=cut.hidden_states,
    )
    if machine.stateful:
        measured = replace(measured, activation=activated(change, measured))
        measured = _with_integrators(change, measured, channels)
    return measured, corrected


def activated(
    change: Change, measured: Measured, begun: Mapping[str, np.ndarray] | None = None
) -> dict[str, np.ndarray]:
    """Computes activations under the commands of a series, each (n,), by stateful actuator.

    Integrators begin at the first values in `begun`, or at 0 if `begun` is None.
    """
    machine, model = change.machine, change.variant.model
    if not machine.stateful:
        return {}
    period, step = measured.period, machine.timestep
    start = np.array([begun[name][0] if begun else 0.0 for name in machine.stateful])
    command = np.stack([measured.command[name] for name in machine.stateful], axis=1)

    def follow() -> np.ndarray:
        return activations(model, command, max(1, round(period / step)), step, start)

    given = command, attributes(model), start
    table = measured.hidden_states.get("activation", given, follow)
    return dict(zip(machine.stateful, table.T, strict=True))


def _with_integrators(
    change: Change, measured: Measured, channels: tuple[Channel, ...]
) -> Measured:
    """Returns the series with activations whose initial values balance the forces.

    Commands determine only the change of an integrator. Its initial value minimises the squared
    residual forces of the faster half of the samples, because at rest dry friction hides the value.
    """
    machine, model = change.machine, change.variant.model
    own = [n for n in machine.stateful if model.actuator(n).dyntype[0] == INTEGRATOR]
    if not own:
        return measured
    speed = sum(np.abs(v) / (v.std() or 1.0) for v in measured.velocity.values())
    chosen = np.arange(1, speed.size - 1)
    chosen = chosen[speed[chosen] >= np.median(speed[chosen])]
    at = replace(measured, samples=chosen)
    instances = _instances(change, at, channels)
    instances.reconstruct()
    joints, rows = sorted({j for n in own for j in machine.driven[n]}), np.arange(chosen.size)

    def left(by: str = "", step: float = 0.0) -> np.ndarray:
        moved = {n: a + step * (n == by) for n, a in at.activation.items()}
        other = replace(instances, measured=replace(at, activation=moved))
        return other._unbalanced(rows, joints).ravel()

    # With activation limits, other samples saturate after the step, so it is repeated once.
    for _ in range(2 if model.actuator_actlimited.any() else 1):
        step, force = 1e-4, left()
        slopes = np.stack([(left(name, step) - force) / step for name in own], axis=1)
        off, *_ = np.linalg.lstsq(slopes, -force, rcond=None)
        begun = {n: at.activation[n] + by for n, by in zip(own, off, strict=True)}
        at = replace(at, activation=activated(change, at, {**at.activation, **begun}))
    return replace(measured, activation=at.activation)


def _follow(
    cut: Cut, machine: Machine, position: dict[str, np.ndarray], velocity: dict[str, np.ndarray]
) -> None:
    """Adds positions and velocities of joints that follow others by equalities, each (n,)."""
    model, followers = machine.base.model, machine.followers
    assert followers is not None
    given = tuple(position[j] for j in machine.joints) + tuple(velocity[j] for j in machine.joints)

    def solved() -> tuple[np.ndarray, np.ndarray]:
        rows = np.tile(model.qpos0, (given[0].size, 1))
        speeds = np.zeros((given[0].size, model.nv))
        for joint in machine.joints:
            rows[:, model.joint(joint).qposadr[0]] = position[joint]
            speeds[:, model.joint(joint).dofadr[0]] = velocity[joint]
        rows = followers.positions(rows)
        return rows, followers.velocities(rows, speeds)

    rows, speeds = cut.hidden_states.get("followers", given, solved)
    for joint in followers.names:
        position[joint] = rows[:, model.joint(joint).qposadr[0]]
        velocity[joint] = speeds[:, model.joint(joint).dofadr[0]]


def closed(change: Change, states: np.ndarray) -> np.ndarray:
    """Returns full physics states, (windows, nstate), whose followers satisfy the equalities."""
    joints, followers = change.machine.all_joints, change.machine.followers
    if followers is None:
        return states
    out, variant = states.copy(), change.variant
    places, speeds = ([place(variant, j, q) for j in joints] for q in ("position", "velocity"))
    out[:, places] = followers.positions(states[:, places], near=True)
    out[:, speeds] = followers.velocities(out[:, places], states[:, speeds])
    return out


def _driven(
    cut: Cut,
    channels: tuple[Channel, ...],
    command: dict[str, np.ndarray],
    position: dict[str, np.ndarray],
    velocity: dict[str, np.ndarray],
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Adds to the smoothed motion the part of the commanded motion that filters have removed.

    Commands are of native actuators. Returns position, velocity and commanded velocity by joint.
    """
    period, filters = cut.series.period, [c.filter for c in channels if not c.chamber]
    given = [command[name] for name in cut.pushes.actuators]

    def followed() -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        rows = zip(filters, *cut.pushes.moved(command, period), strict=True)
        return [(q - smoothed(q, f), v - smoothed(q, f, period), v) for f, q, v in rows]

    def added() -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        beyond = cut.hidden_states.get("pushes", given, followed)
        smooth = zip(beyond, position.values(), velocity.values(), strict=True)
        return [(q + level, v + slope, whole) for (level, slope, whole), q, v in smooth]

    return cut.hidden_states.get("pushed", (*given, *position.values(), *velocity.values()), added)


def commanded(change: Change, actuator: str, samples: np.ndarray, period: float) -> np.ndarray:
    """Applies the command paths of an actuator to samples with a sampling period [s], (n,)."""
    for path in change.commands.get(actuator, ()):
        samples = path(samples, period)
    return samples


def start_states(
    cut: Cut,
    change: Change,
    measured: Measured,
    channels: tuple[Channel, ...],
    rest_time: float,
    pressures: np.ndarray | None = None,
) -> np.ndarray:
    """Computes full physics states at window starts under a change, shape (windows, nstate).

    Windows start at the samples of `measured`. For `rest_time` [s] see `Instances.balance`.
    `pressures` are the values of all `hidden_slots`, (windows, slots), if pressures are not
    measured.
    """
    machine, variant, firsts = change.machine, change.variant, measured.samples
    instances = _instances(change, measured, channels)
    plugin = instances.state
    if pressures is not None:
        plugin[:, hidden_slots(change)] = pressures
    instances.reconstruct()
    for (element, name), function in change.starts.items():
        plugin[:, variant.slot(element, name)] = function(measured, variant, plugin)
    instances.balance(rest_time)
    states = moments.states_at(machine, variant.model, measured, firsts, plugin)
    states[:, 0] = cut.series.time[firsts]
    for joint in (*machine.joints, *machine.follower_names):
        # MuJoCo's velocity is half a step older than its position, so earlier slopes are used.
        v = measured.velocity[joint]
        pushed = measured.pushed.get(joint, np.zeros_like(v))
        calm = v - pushed
        slope = (calm[firsts + 1] - calm[firsts - 1]) / (2.0 * measured.period)
        slope += (pushed[firsts] - pushed[firsts - 1]) / measured.period
        states[:, place(variant, joint, "velocity")] -= 0.5 * machine.timestep * slope
    return states


def _instances(change: Change, measured: Measured, channels: tuple[Channel, ...]) -> Instances:
    """Builds plugin instances at the samples of `measured`, with measured pressures."""
    variant, firsts = change.variant, measured.samples
    plugin = np.tile(variant.plugin_state, (firsts.size, 1))
    for (element, name), value in change.parameters.items():
        plugin[:, variant.slot(element, name)] = value
    for channel in channels:
        if channel.chamber and channel.cylinder:
            slot = variant.slot(channel.cylinder, channel.chamber)
            plugin[:, slot] = measured.pressure[channel.column][firsts]
    return Instances(machine=change.machine, measured=measured, variant=variant, state=plugin)


def place(variant: Variant, element: str, quantity: str) -> int:
    """Returns the index in the full physics state of a joint's motion or of a plugin state."""
    model = variant.model
    if quantity == "position":
        return 1 + int(model.joint(element).qposadr[0])
    if quantity == "velocity":
        return 1 + model.nq + int(model.joint(element).dofadr[0])
    return moments.plugin_offset(model) + variant.slot(element, quantity)


def hidden_slots(change: Change) -> np.ndarray:
    """Returns plugin-state indices of all states that depend on unmeasured pressures.

    These are the chamber pressures and play states of each cylinder, then the supplies' states.
    """
    variant = change.variant
    names = (*CHAMBERS, "play_offset", "piston_velocity", "pin_load", "seated_play")
    cylinders = [(c, name) for c in change.machine.cylinders for name in names]
    supplies = [(s, name) for s in variant.drawn_by for name in ("pressure", "started")]
    return np.array([variant.slot(*place) for place in (*cylinders, *supplies)], dtype=int)


def plays(machine: Machine, variant: Variant) -> list[int]:
    """Returns plugin-state indices of the cylinders' play widths; force balances set them to zero.

    A piston crosses its play within milliseconds, so force balances treat it as fixed to the joint.
    With play, a balance would contain the flank force of the first time step, an artefact.
    """
    return [variant.slot(cylinder, "play") for cylinder in machine.cylinders]
