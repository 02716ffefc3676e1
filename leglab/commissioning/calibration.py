"""Bench calibration of the nominal machine: signs, full speeds and valve maps."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from leglab.base.errors import LeglabError
from leglab.machine.cylinder import Cylinder
from leglab.machine.native import NativeActuator
from leglab.machine.simulation import Simulation

# Speeds at which the valve map is measured, as fractions of full speed; dense around standstill,
# where overlap and friction curve the map.
_SPEEDS = np.array([-0.7, -0.45, -0.25, -0.12, -0.05, -0.02, -0.005])
SPEED_FRACTIONS = np.concatenate([_SPEEDS, [0.0], -_SPEEDS[::-1]])
POSITION_FRACTIONS = np.linspace(0.03, 0.97, 9)  # positions, as fractions of the joint range


@dataclass(frozen=True, kw_only=True)
class ValveMap:
    """Command of a joint's valve or native actuator in steady motion, by position and velocity."""

    position: np.ndarray  #: Joint positions [rad], increasing, shape (p,)
    velocity: np.ndarray  #: Joint velocities [rad/s], increasing, shape (v,)
    command: np.ndarray  #: Commands in [-1, 1], shape (p, v)


def drive_signs(simulation: Simulation) -> np.ndarray:
    """Returns the sign of the joint velocity that a positive command gives, (joints,)."""
    signs = np.sign(simulation.levers())
    for drive in simulation.native.values():
        signs[drive.id] *= np.sign(drive.gain(simulation.data))
    return signs


def holding_forces(simulation: Simulation) -> np.ndarray:
    """Computes actuator forces [N or N m], (actuators,), that hold every driven joint at rest.

    Computed by inverse dynamics without acceleration; positions and velocities are not changed.
    """
    model, data = simulation.model, simulation.data
    data.qacc[:] = 0.0
    mujoco.mj_inverse(model, data)
    return data.qfrc_inverse[simulation.dof_index] / simulation.levers()


def speed_limits(simulation: Simulation) -> np.ndarray:
    """Computes joint speeds [rad/s] without load at full command in the present pose, (joints,).

    A cylinder extends at v = K sqrt((A_A p_s - A_B p_t)/(A_A^3 + A_B^3)) (flow balance of a valve
    without overlap); the retraction speed is v with A and B exchanged. The smaller is returned.
    For a native actuator see `native_speed_limit`.
    """
    limits = []
    for actuator, lever in zip(simulation.actuators, simulation.levers(), strict=True):
        if actuator in simulation.native:
            limits.append(native_speed_limit(simulation, simulation.native[actuator]))
            continue
        values = simulation.cylinder_parameters(actuator)
        a, b = Cylinder(values).native.areas()
        gain = values["rated_flow"] / np.sqrt(values["rated_pressure_drop"] / 2)
        supply, tank = values["supply_pressure"], values["tank_pressure"]
        cubes = a**3 + b**3
        piston = gain * np.sqrt(
            min(max(a * supply - b * tank, 0) / cubes, max(b * supply - a * tank, 0) / cubes)
        )
        limits.append(piston / abs(lever))
    return np.array(limits)


def native_speed_limit(simulation: Simulation, drive: NativeActuator) -> float:
    """Computes the joint speed [rad/s or m/s] that a native actuator reaches in the present pose.

    It is the smaller of two speeds. At F/d the damping d of joint and internal loop balances F, the
    actuator's full force at standstill. The joint with inertia m reaches sqrt(F s/m) within half of
    its range s. Friction and weight are neglected.
    """
    model, data = simulation.model, simulation.data
    lever, dof = drive.lever(data), drive.dof
    low, high = drive.force_range(data)
    force = abs(lever) * min(high, -low) if low < 0 < high else abs(lever) * max(high, -low)
    _, per_velocity = drive.slopes(0.0)
    damping = float(model.dof_damping[dof]) - per_velocity * lever**2
    place = simulation.actuators.index(drive.name)
    least, greatest = simulation.joint_range()[place]
    speed = float(np.sqrt(force * (greatest - least) / free_inertia(simulation, dof)))
    return min(speed, force / damping) if damping > 0 else speed


def free_inertia(simulation: Simulation, dof: int) -> float:
    """Computes a joint's inertia [kg m^2 or kg] with all other joints free, 1/(M^-1)_ii."""
    model, data = simulation.model, simulation.data
    unit, solved = np.zeros((1, model.nv)), np.zeros((1, model.nv))
    unit[0, dof] = 1.0
    mujoco.mj_solveM(model, data, solved, unit)
    return 1.0 / float(solved[0, dof])


def settle(simulation: Simulation) -> None:
    """Sets pressures, spools and controls so that the machine stands still in its present pose.

    A native actuator that is too weak to hold its joint is set to the end of its range.

    Raises:
        LeglabError: A cylinder cannot hold its joint in this pose.
    """
    data = simulation.data
    forces = dict(zip(simulation.actuators, holding_forces(simulation), strict=True))
    for drive in simulation.native.values():
        control = drive.centre + drive.half * drive.command(float(forces[drive.name]), data)
        data.ctrl[drive.id] = control
        if drive.time_constant:
            data.act[simulation.model.actuator_actadr[drive.id]] = control
    if simulation.cylinders:
        _settle_cylinders(simulation, [float(forces[name]) for name in simulation.cylinders])
    mujoco.mj_forward(simulation.model, data)


def _settle_cylinders(simulation: Simulation, forces: Sequence[float]) -> None:
    states = []
    for actuator, force in zip(simulation.cylinders, forces, strict=True):
        try:
            cylinder = Cylinder(simulation.cylinder_parameters(actuator))
            states.append(cylinder.steady_state(0.0, force))
        except LeglabError as error:
            raise error.at(f"actuator {actuator!r} cannot hold its joint") from error
    pressures = np.array([(state.pressure_a, state.pressure_b) for state in states])
    simulation.set_pressures(*pressures.T)
    spools = np.array([state.spool for state in states])
    simulation.data.plugin_state[simulation.slots("spool_position")] = spools
    bias = simulation.data.plugin_state[simulation.slots("null_bias")]
    for name, control in zip(simulation.cylinders, spools - bias, strict=True):
        simulation.data.ctrl[simulation.actuators.index(name)] = control


def valve_maps(simulation: Simulation) -> tuple[ValveMap, ...]:
    """Measures the steady map from motion to command of every joint, as on a test bench.

    One joint at a time runs at constant speed through its range, while the other joints rest in the
    present pose. The load consists of gravity, springs and dampers, and of the actuator's friction
    and leakage. Contacts are disabled, as for a leg that hangs free on a stand.
    """
    limits, ranges = speed_limits(simulation), simulation.joint_range()
    maps = []
    for joint, (low, high) in enumerate(ranges):
        velocity = SPEED_FRACTIONS * limits[joint]
        position = low + POSITION_FRACTIONS * (high - low)
        command = steady_commands(simulation, joint, position, velocity)
        maps.append(ValveMap(position=position, velocity=velocity, command=command))
    return tuple(maps)


def steady_commands(
    simulation: Simulation, joint: int, position: np.ndarray, velocity: np.ndarray
) -> np.ndarray:
    """Computes commands of a joint's steady motion, (p, v); +-1 if its actuator is too weak.

    Args:
        simulation: The machine; other joints rest in its present pose, which is restored.
        joint: Index of the joint.
        position: Positions of the joint [rad], (p,).
        velocity: Velocities of the joint [rad/s], (v,).
    """
    model, data = simulation.model, simulation.data
    steady = _steady_command(simulation, joint)
    pose, flags = data.qpos.copy(), model.opt.disableflags
    command = np.empty((len(position), len(velocity)))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    try:
        for i, q in enumerate(position):
            for j, speed in enumerate(velocity):
                data.qpos[:], data.qvel[:] = pose, 0.0
                data.qpos[simulation.qpos_index[joint]] = q
                data.qvel[simulation.dof_index[joint]] = speed
                mujoco.mj_fwdPosition(model, data)
                mujoco.mj_fwdVelocity(model, data)
                command[i, j] = steady(speed, float(holding_forces(simulation)[joint]))
    finally:
        model.opt.disableflags = flags
        data.qpos[:], data.qvel[:] = pose, 0.0
        mujoco.mj_forward(model, data)
    return command


def _steady_command(simulation: Simulation, joint: int) -> Callable[[float, float], float]:
    """Returns a function of joint speed [rad/s] and actuator force [N] to the steady command.

    It is exact for a native actuator, whose force is a function of command, length and velocity.
    """
    name = simulation.actuators[joint]
    if name in simulation.native:
        drive = simulation.native[name]
        return lambda speed, force: drive.command(force, simulation.data)
    cylinder = Cylinder(simulation.cylinder_parameters(name))

    def command(speed: float, force: float) -> float:
        piston = float(simulation.levers()[joint]) * speed
        try:
            return cylinder.steady_state(piston, force).spool
        except LeglabError:
            return float(np.sign(piston))  # the valve cannot supply this flow

    return command
