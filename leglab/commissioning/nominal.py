"""The nominal machine as data for model-based controllers: cylinders, levers, rigid bodies."""

import copy
from dataclasses import fields

import mujoco
import numpy as np

from leglab.base.errors import ModelError
from leglab.control.backstepping.data import NominalCylinders
from leglab.machine.cylinder import Cylinder
from leglab.machine.simulation import Simulation

# Number of positions over each joint's range at which levers are tabulated. For a range of 2 rad
# and a lever r with r'' = r, linear interpolation then has an error below a thousandth.
_LEVER_POSITIONS = 33


def nominal_cylinders(simulation: Simulation) -> NominalCylinders:
    """Reads the cylinders' data sheets and measures their levers over the joint ranges.

    Args:
        simulation: The nominal machine in its rest pose; its positions are restored.

    Raises:
        LeglabError: An actuator is not a cylinder.
    """
    for name in simulation.native:
        text = f"the controller needs the data sheets of cylinders, and actuator {name!r} is none"
        raise ModelError(text, given=name, allowed="a cylinder")
    sheets = [simulation.cylinder_parameters(name) for name in simulation.actuators]

    def row(name: str) -> np.ndarray:
        return np.array([sheet[name] for sheet in sheets])

    own = [field.name for field in fields(NominalCylinders) if field.name in sheets[0]]
    mass = _effective_masses(simulation)
    position, lever, length = simulation.lever_tables(_LEVER_POSITIONS)
    return NominalCylinders(
        area=np.array([Cylinder(sheet).native.areas() for sheet in sheets]).T,
        dead_volume=np.stack([row("dead_volume_a"), row("dead_volume_b")]),
        orifice_gain=row("rated_flow") / np.sqrt(row("rated_pressure_drop") / 2),
        valve_frequency=2 * np.pi * row("bandwidth_hz"),
        valve_damping=row("damping_ratio"),
        mass=mass,
        position=position,
        lever=lever,
        piston=length + (row("stroke") / 2 - row("mid_length"))[:, None],
        **{name: row(name) for name in own},
    )


def _effective_masses(simulation: Simulation) -> np.ndarray:
    """Computes the mass [kg] that each cylinder moves with all other joints free, (joints,)."""
    inverse = np.diag(np.linalg.inv(inertia_matrix(simulation)))[simulation.dof_index]
    return 1.0 / (inverse * simulation.levers() ** 2)


def inertia_matrix(simulation: Simulation) -> np.ndarray:
    """Computes the joint-space inertia matrix in the present pose [kg m^2, kg m, kg], (nv, nv)."""
    inertia = np.zeros((simulation.model.nv, simulation.model.nv))
    mujoco.mj_fullM(simulation.model, simulation.data, inertia)
    return inertia


class NominalDynamics:
    """Inverse dynamics of the nominal machine: torques by bodies, gravity, springs and dampers.

    It uses a copy of the model, separate from the running simulation. On a robot, any rigid-body
    library could compute these torques from masses and lengths. There is no ground contact; joints
    without an actuator stand still.

    Args:
        simulation: The nominal machine in its rest pose.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._model = copy.copy(simulation.model)
        self._model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self._model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_SENSOR
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:] = simulation.data.qpos
        self._qpos, self._dof = simulation.qpos_index, simulation.dof_index

    def __call__(
        self, position: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray
    ) -> np.ndarray:
        """Computes torques [N m], (joints,), for a motion [rad, rad/s, rad/s^2], (joints,) each."""
        data = self._data
        data.qpos[self._qpos] = position
        data.qvel[self._dof] = velocity
        data.qacc[self._dof] = acceleration
        mujoco.mj_inverse(self._model, data)
        return data.qfrc_inverse[self._dof]
