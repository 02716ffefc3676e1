"""What a bench calibration of the nominal machine tells a controller: signs, speeds, valve maps."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leglab.base.errors import LeglabError
from leglab.machine.cylinder import Cylinder
from leglab.machine.simulation import Simulation

# Fractions of the greatest speed and of the joint range at which the valve map is measured:
# dense around standstill, where overlap and friction bend it.
_SPEEDS = np.array([-0.7, -0.45, -0.25, -0.12, -0.05, -0.02, -0.005])
SPEED_FRACTIONS = np.concatenate([_SPEEDS, [0.0], -_SPEEDS[::-1]])
POSITION_FRACTIONS = np.linspace(0.03, 0.97, 9)


@dataclass(frozen=True, kw_only=True)
class ValveMap:
    """Steady valve command against position and velocity of one joint.

    Attributes:
        position: Joint positions [rad], increasing, shape (p,).
        velocity: Joint velocities [rad/s], increasing, shape (v,).
        command: Valve commands in [-1, 1], shape (p, v).
    """

    position: np.ndarray
    velocity: np.ndarray
    command: np.ndarray


def directions(simulation: Simulation) -> np.ndarray:
    """Sign of the joint velocity that a positive command gives, (joints,)."""
    return np.sign(simulation.levers())


def holding_forces(simulation: Simulation) -> np.ndarray:
    """Cylinder forces [N], (actuators,), that keep every driven joint at rest where it is.

    Inverse dynamics without acceleration; `data` keeps its positions and velocities.
    """
    model, data = simulation.model, simulation.data
    data.qacc[:] = 0.0
    mujoco.mj_inverse(model, data)
    return data.qfrc_inverse[simulation.dof_index] / simulation.levers()


def speed_limits(simulation: Simulation) -> np.ndarray:
    """Joint speed [rad/s], (joints,), of each cylinder without load at full opening.

    v = K sqrt((A_A p_s - A_B p_t)/(A_A^3 + A_B^3)) extending, with A and B exchanged retracting
    (flow balance of a critically lapped valve); the slower of the two, at the present pose.
    """
    limits = []
    for actuator, lever in zip(simulation.actuators, simulation.levers(), strict=True):
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


def settle(simulation: Simulation) -> None:
    """Sets pressures, spools and commands so that the machine stands still in its present pose.

    Raises:
        LeglabError: If a cylinder cannot hold its joint there.
    """
    forces = holding_forces(simulation)
    states = []
    for actuator, force in zip(simulation.actuators, forces, strict=True):
        try:
            cylinder = Cylinder(simulation.cylinder_parameters(actuator))
            states.append(cylinder.steady_state(0.0, float(force)))
        except LeglabError as error:
            raise LeglabError(f"actuator {actuator!r} cannot hold its joint: {error}") from error
    spools = np.array([state.spool for state in states])
    simulation.set_pressures(
        np.array([state.pressure_a for state in states]),
        np.array([state.pressure_b for state in states]),
    )
    simulation.data.plugin_state[simulation.slots("spool_position")] = spools
    bias = simulation.data.plugin_state[simulation.slots("null_bias")]
    simulation.data.ctrl[:] = spools - bias
    mujoco.mj_forward(simulation.model, simulation.data)


def valve_maps(simulation: Simulation) -> tuple[ValveMap, ...]:
    """Calibrates the steady valve map of every joint on the machine as it is now.

    One joint at a time runs at constant speed through its range, the others stand in the present
    pose; loads are gravity, springs and dampers, friction and leakage those of the cylinder. The
    leg hangs free, as on a stand: contact with the ground is off.
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
    """Valve commands at which a joint runs steadily, (p, v); +-1 beyond what the valve can give.

    Args:
        simulation: The machine, in the pose of the other joints; it is left in it.
        joint: Index of the joint.
        position: Of the joint [rad], (p,).
        velocity: Of the joint [rad/s], (v,).
    """
    model, data = simulation.model, simulation.data
    cylinder = Cylinder(simulation.cylinder_parameters(simulation.actuators[joint]))
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
                lever = simulation.levers()[joint]
                force = float(holding_forces(simulation)[joint])
                try:
                    command[i, j] = cylinder.steady_state(lever * speed, force).spool
                except LeglabError:
                    command[i, j] = np.sign(lever * speed)  # beyond what the valve can give
    finally:
        model.opt.disableflags = flags
        data.qpos[:], data.qvel[:] = pose, 0.0
        mujoco.mj_forward(model, data)
    return command
