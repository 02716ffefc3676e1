"""Effects that no recording of some channels tells apart, whatever the motion.

A late command and a late position sensor shift the same motion against the same command. Only a
third signal says which: a pressure, or another joint that feels this one. A command that is
constant in all recordings is never late, and its delay no twin of anything.
"""

import mujoco
import numpy as np

from leglab.diagnosis.effects.hypothesis import Key
from leglab.diagnosis.plant.model import ROUNDING, Machine
from leglab.diagnosis.replay.residual import Problem

_DELAYS = ("command_delay", "sensor_delay")


def twins(problem: Problem, key: Key) -> tuple[Key, ...]:
    """Exact twins of an effect on an element of this machine, as far as they are looked for."""
    machine = problem.machine
    if key[0] not in _DELAYS or any(c.chamber for c in problem.channels):
        return ()
    joints = machine.driven.get(key[1], (key[1],))
    if set(joints) & set(coupled_joints(machine)):
        return ()
    return tuple(
        other
        for other in sorted(problem.library.searched)
        if other[0] in _DELAYS
        and other[0] != key[0]
        and set(machine.driven.get(other[1], (other[1],))) == set(joints)
        and _changes(problem, dict((key, other))["command_delay"])
    )


def _changes(problem: Problem, actuator: str) -> bool:
    """Tests whether an actuator's command changes during a recording."""
    return any(np.ptp(series.columns[f"{actuator}_command"]) > 0.0 for series in problem.series)


def coupled_joints(machine: Machine) -> tuple[str, ...]:
    """Joints whose acceleration acts on another joint, by the mass matrix at some poses."""
    model = machine.base.model
    data = mujoco.MjData(model)
    found: set[int] = set()
    for shift in (0.0, 0.4, -0.7):
        data.qpos[:] = model.qpos0 + shift
        mujoco.mj_forward(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        own = np.sqrt(np.diag(mass))
        share = np.abs(mass) / np.outer(own, own) - np.eye(model.nv)
        found |= set(np.flatnonzero((share > ROUNDING).any(axis=1)).tolist())
    names = (machine.all_joints[int(model.dof_jntid[k])] for k in sorted(found))
    return tuple(name for name in names if name in machine.joints)
