"""Inverse dynamics: forces of a compiled model at single instants ("moments") of a motion."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import mujoco
import numpy as np

import leglab._native.forces
from leglab.diagnosis.plant.model import Machine, Measured

STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS


@dataclass(frozen=True, kw_only=True, eq=False)
class MomentForces:
    """Forces at some instants of a motion; arrays that were not requested are empty."""

    #: Residual forces: forces that accelerations need beyond the modelled forces, (moments, nv).
    lacking: np.ndarray
    load: np.ndarray  #: Actuator forces on joints, (moments, nv)
    bias: np.ndarray  #: Gravity, Coriolis and centrifugal forces, (moments, nv)
    length: np.ndarray  #: Lengths of actuators, (moments, nu)
    speed: np.ndarray  #: Velocities of actuators, (moments, nu)
    pull: np.ndarray  #: Forces of actuators, (moments, nu)
    inertia: np.ndarray  #: Joint-space inertia, (moments, nv, nv)


def forces_at(
    model: mujoco.MjModel,
    states: np.ndarray,
    commands: np.ndarray,
    accelerations: np.ndarray | None = None,
) -> MomentForces:
    """Computes the forces of a model at independent instants.

    Inputs are full physics states, (moments, nstate), controls, (moments, nu), and accelerations,
    (moments, nv), NaN for joints that move as modelled. Without these, no residual is computed.
    """
    joints, actuators = (model.nv,), (model.nu,)
    shapes = dict.fromkeys(("load", "bias"), joints) | {"inertia": joints + joints}
    shapes |= dict.fromkeys(("length", "speed", "pull"), actuators)
    if accelerations is None:
        accelerations = np.zeros((len(states), model.nv))
    else:
        shapes["lacking"] = joints
    out = {name: np.empty((len(states), *shape)) for name, shape in shapes.items()}
    states, commands = np.ascontiguousarray(states), np.ascontiguousarray(commands)
    accelerations = np.ascontiguousarray(accelerations)
    leglab._native.forces.at_moments(model._address, states, commands, accelerations, out)
    return MomentForces(**{"lacking": np.empty((0, model.nv)), **out})


def states_at(
    machine: Machine,
    model: mujoco.MjModel,
    measured: Measured,
    samples: np.ndarray,
    plugin: np.ndarray,
    *,
    without: Collection[int] = (),
) -> np.ndarray:
    """Returns full physics states of a measured motion at some samples, (samples, nstate).

    `plugin` contains the plugins' parameters and states, (samples, npluginstate) or
    (npluginstate,); its entries at the indices `without` are set to zero.
    """
    states = np.zeros((samples.size, mujoco.mj_stateSize(model, STATE)))
    states[:, 1 : 1 + model.nq] = model.qpos0
    for name in (*machine.joints, *machine.follower_names):
        joint = model.joint(name)
        states[:, 1 + int(joint.qposadr[0])] = measured.position[name][samples]
        states[:, 1 + model.nq + int(joint.dofadr[0])] = measured.velocity[name][samples]
    for name, activation in measured.activation.items():
        place = 1 + model.nq + model.nv + int(model.actuator(name).actadr[0])
        states[:, place] = activation[samples]
    start = plugin_offset(model)
    states[:, start : start + model.npluginstate] = plugin
    states[:, [start + place for place in without]] = 0.0
    return states


def commands_at(machine: Machine, measured: Measured, samples: np.ndarray) -> np.ndarray:
    """Returns measured commands, (..., actuators), at an array of samples of any shape."""
    columns = [measured.command[name][samples] for name in machine.actuators]
    return np.stack(columns, axis=-1) if columns else np.zeros((*samples.shape, 0))


def accelerations(
    machine: Machine, model: mujoco.MjModel, measured: Measured, half: int
) -> np.ndarray:
    """Returns accelerations at the samples, (samples, nv), by differences over +-`half` samples.

    The accelerations of joints that a hypothesis adds are NaN.
    """
    k, out = measured.samples, np.full((measured.samples.size, model.nv), np.nan)
    joints = (*machine.joints, *machine.follower_names)
    for dof, joint in zip(dofs(model, joints), joints, strict=True):
        v = measured.velocity[joint]
        out[:, dof] = (v[k + half] - v[k - half]) / (2 * half * measured.period)
    return out


def dofs(model: mujoco.MjModel, joints: Iterable[str]) -> list[int]:
    """Returns the indices of the degrees of freedom of hinge and slide joints."""
    return [int(model.joint(joint).dofadr[0]) for joint in joints]


def plugin_offset(model: mujoco.MjModel) -> int:
    """Returns the index of plugin states in MuJoCo's full physics state."""
    return mujoco.mj_stateSize(model, int(STATE) & (int(mujoco.mjtState.mjSTATE_PLUGIN) - 1))
