"""What effects on joints share: sizes to try, and plugin instances to insert."""

import math
from collections.abc import Mapping
from functools import lru_cache

import mujoco
import numpy as np

from leglab.diagnosis.model import CYLINDER, Change, Machine
from leglab.machine.simulation import actuator_moments

SPRING = "leglab.spring_damper"
_POSES = 12
_BRISTLE_HZ = 100.0


def unit(machine: Machine, joint: str) -> str:
    """Unit of a joint's position."""
    hinge = machine.base.model.joint(joint).type[0] == int(mujoco.mjtJoint.mjJNT_HINGE)
    return "rad" if hinge else "m"


def force_unit(machine: Machine, joint: str) -> str:
    """Unit of a joint's generalised force."""
    return "N m" if unit(machine, joint) == "rad" else "N"


def dof(machine: Machine, joint: str) -> int:
    """Degree of freedom of a joint."""
    return int(machine.base.model.joint(joint).dofadr[0])


def inertia(machine: Machine, joint: str) -> float:
    """Effective inertia of a joint at qpos0 [kg m^2 or kg]: 1/(M^-1)_ii."""
    return 1.0 / float(machine.base.model.dof_invweight0[dof(machine, joint)])


def force_scale(machine: Machine, joint: str) -> float:
    """Force that matters at a joint [N m or N]: gravity at its worst, and 10 /s^2 of inertia."""
    return gravity(machine, joint) + 10.0 * inertia(machine, joint)


@lru_cache(maxsize=256)
def gravity(machine: Machine, joint: str) -> float:
    """Largest force of gravity on a joint over its positions [N m or N]."""
    model = machine.base.model
    data = mujoco.MjData(model)
    index = dof(machine, joint)
    address = int(model.joint(joint).qposadr[0])
    worst = 0.0
    reach = 2.0 * math.pi if unit(machine, joint) == "rad" else 1.0
    for share in np.arange(_POSES) / _POSES:
        data.qpos[:] = model.qpos0
        data.qpos[address] += share * reach
        mujoco.mj_forward(model, data)
        worst = max(worst, abs(float(data.qfrc_bias[index])))
    return worst


@lru_cache(maxsize=256)
def drive_damping(machine: Machine, joint: str) -> float:
    """Viscous friction that acts on a joint [N m s/rad or N s/m]: its own and its cylinders'."""
    model = machine.base.model
    index = dof(machine, joint)
    total = float(model.dof_damping[index])
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0 + 0.1
    mujoco.mj_forward(model, data)
    moment = actuator_moments(model, data)
    for cylinder in machine.instances(CYLINDER):
        lever = float(moment[model.actuator(cylinder).id, index])
        total += machine.parameter(cylinder, "viscous") * lever**2
    return total


def plain_joints(machine: Machine) -> tuple[str, ...]:
    """Joints without a cylinder, whose friction is that of the cylinder."""
    driven = {j for cylinder in machine.instances(CYLINDER) for j in machine.driven[cylinder]}
    return tuple(joint for joint in machine.joints if joint not in driven)


def insert(
    spec: mujoco.MjSpec, plugin: str, name: str, config: Mapping[str, float | str]
) -> mujoco.MjsPlugin:
    """Adds a plugin instance to a specification."""
    spec.activate_plugin(plugin)
    instance = spec.add_plugin(name=name, plugin_name=plugin)
    instance.config = {key: _text(value) for key, value in config.items()}
    return instance


def insert_on_joint(
    change: Change, plugin: str, name: str, joint: str, config: Mapping[str, float] | None = None
) -> None:
    """Lets a change insert a neutral plugin instance on a joint, compiled once for all values."""
    full: dict[str, float | str] = {"joint": joint, **(config or {})}
    key = ("insert", plugin, name, *sorted(full.items(), key=str))

    def edit(spec: mujoco.MjSpec) -> None:
        insert(spec, plugin, name, full)

    change.edit(key, edit)


def bristle(machine: Machine, joint: str) -> dict[str, float]:
    """LuGre bristle that is stiff for the joint and stable at 1 ms: 100 Hz, half damped."""
    mass = inertia(machine, joint)
    frequency = 2.0 * math.pi * _BRISTLE_HZ
    return {"sigma_0": mass * frequency**2, "sigma_1": mass * frequency}


def _text(value: float | str) -> str:
    return value if isinstance(value, str) else repr(float(value))
