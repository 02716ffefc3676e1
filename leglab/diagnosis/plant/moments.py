"""Forces of a compiled model at moments of a motion: what inverse dynamics ask of MuJoCo."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import mujoco
import numpy as np

import leglab._native.forces
from leglab.diagnosis.plant.model import Machine, Measured

STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS


@dataclass(frozen=True, kw_only=True, eq=False)
class MomentForces:
    """Forces at moments; what was not asked for is empty."""

    #: Forces that the accelerations need beyond the modelled ones, (moments, nv).
    lacking: np.ndarray
    load: np.ndarray  #: Of actuators on joints, (moments, nv)
    bias: np.ndarray  #: Gravity, Coriolis and centrifugal forces, (moments, nv)
    length: np.ndarray  #: Of actuators, (moments, nu)
    speed: np.ndarray  #: Of actuators, (moments, nu)
    pull: np.ndarray  #: Of actuators, (moments, nu)
    inertia: np.ndarray  #: Joint-space inertia, (moments, nv, nv)


def forces_at(
    model: mujoco.MjModel,
    states: np.ndarray,
    commands: np.ndarray,
    accelerations: np.ndarray | None = None,
) -> MomentForces:
    """Forces of a model at some moments, each for itself.

    By full physics states, (moments, nstate), controls, (moments, nu), and accelerations, (moments,
    nv), NaN where a joint moves as the model has it; None where no lacking forces are asked for.
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
    """Full physics states of a measured motion at some samples, (samples, nstate).

    `plugin` holds the plugins' parameters and states, (samples, npluginstate) or (npluginstate,);
    those in the places `without` are set to zero.
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
    """Measured commands, (..., actuators) at samples of any shape."""
    columns = [measured.command[name][samples] for name in machine.actuators]
    return np.stack(columns, axis=-1) if columns else np.zeros((*samples.shape, 0))


def accelerations(
    machine: Machine, model: mujoco.MjModel, measured: Measured, half: int
) -> np.ndarray:
    """Measured accelerations at the samples, (samples, nv), over so many samples to both sides.

    NaN of a joint that a hypothesis adds.
    """
    k, out = measured.samples, np.full((measured.samples.size, model.nv), np.nan)
    joints = (*machine.joints, *machine.follower_names)
    for dof, joint in zip(dofs(model, joints), joints, strict=True):
        v = measured.velocity[joint]
        out[:, dof] = (v[k + half] - v[k - half]) / (2 * half * measured.period)
    return out


def dofs(model: mujoco.MjModel, joints: Iterable[str]) -> list[int]:
    """Degrees of freedom of joints, one of each."""
    return [int(model.joint(joint).dofadr[0]) for joint in joints]


def plugin_offset(model: mujoco.MjModel) -> int:
    """Place of the plugins in the full physics state: parts follow in the order of their bits."""
    return mujoco.mj_stateSize(model, int(STATE) & (int(mujoco.mjtState.mjSTATE_PLUGIN) - 1))
