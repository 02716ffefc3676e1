"""Effects that recordings of some channels cannot distinguish, whatever the motion.

A late command and a late position sensor shift the same motion against the same command. Only a
third signal distinguishes these "twins": a pressure, or the motion of a coupled joint. If a command
is constant in all recordings, its delay changes nothing and has no twin.

A common factor on all forces does not change the motion either: a heavier weight is equivalent to
less inertia, friction and stiffness. Only a drive with a known gain, hence force, resolves this.
"""

from collections.abc import Iterator

import mujoco
import numpy as np

from leglab.diagnosis.effects.hypothesis import Key
from leglab.diagnosis.effects.mechanics import moved_body
from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.plant.model import ROUNDING, Machine
from leglab.diagnosis.replay.residual import Problem
from leglab.diagnosis.thresholds import CERTAIN, NO_FAULT

_DELAYS = ("command_delay", "sensor_delay")


def twins(problem: Problem, key: Key) -> tuple[Key, ...]:
    """Returns the searched effects that no recording can distinguish from the effect `key`."""
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
    """Returns joints that inertia couples to another joint, by mass matrices at three poses."""
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


def scale_twins(
    problem: Problem, u: Unknowns, own: np.ndarray, members: tuple[int, ...], x: np.ndarray
) -> Iterator[tuple[tuple[int, ...], dict[int, float]]]:
    """Yields sets with the motion of a fitted set and all forces scaled, not larger than that set.

    Each parameter of the fitted set gives one factor, by which it returns to the specimen's value.
    Unknowns whose departure is then within tolerance or unnoticeable are left out.

    Args:
        problem: Recordings and machine.
        u: Unknowns.
        own: Values of the specimen, see `own_forces`, (single,).
        members: Unknowns of the fitted set.
        x: Departures of all unknowns in the fitted set, (unknowns,).

    Yields:
        Unknowns of the new set, and the moves of all unknowns from `x` to this set.
    """
    now = x[: u.single]
    scaling = np.array([_is_force(u, i) for i in range(u.single)]) | (own != 0.0)
    for q in members:
        if q >= u.single or own[q] == 0.0 or own[q] + now[q] <= 0.0:
            continue
        factor = own[q] / (own[q] + now[q])
        there = np.where(scaling, factor * now + (factor - 1.0) * own, now)
        if (there < u.lower[: u.single]).any() or (there > u.upper[: u.single]).any():
            continue
        least = np.maximum(NO_FAULT, CERTAIN * u.tolerance[: u.single])
        new = np.flatnonzero((np.abs(there) >= least) & u.nameable[: u.single]).tolist()
        if 0 < len(new) <= len(members):
            moved = {i: float(there[i] - now[i]) for i in np.flatnonzero(there != now).tolist()}
            yield tuple(new), moved | _at_centres(problem, u, new, x)


def own_forces(problem: Problem, u: Unknowns) -> np.ndarray:
    """Returns the specimen's values that scale with all forces, in smallest trials; others are 0.

    They are inertia, friction, stiffness, masses and gains, (single,). Each counts under one effect
    only: effects that contain another effect as a special case have 0. All values are 0 if a force
    is known: that of a cylinder, or of an acting drive whose gain is no unknown.
    """
    machine, library, own = problem.machine, problem.library, np.zeros(u.single)
    acting = {a for a in machine.actuators if _acts(problem, a)}
    if machine.cylinders or any(("actuator_gain", a) not in library.sites for a in acting):
        return own
    for i in range(u.single):
        ((key, n),) = u.places[i]
        site = library.sites[key]
        if key[0] == "payload" and site.parameters[n].unit == "kg":
            own[i] = float(moved_body(machine, key[1]).mass[0]) / u.scale[i]
        elif (_is_force(u, i) and not site.effect.contains and not site.effect.by_direction) or (
            key[0] == "actuator_gain" and key[1] in acting
        ):
            own[i] = float(site.nominal[n]) / u.scale[i]
    return own


def _is_force(u: Unknowns, i: int) -> bool:
    """Tests whether an unknown of one element is a force, stiffness, damping or mass, no limit."""
    (key, n) = u.places[i][0]
    p = u.library.sites[key].parameters[n]
    return p.unit.startswith(("N", "kg")) and p.role == "strength" and not p.inverse


def _acts(problem: Problem, actuator: str) -> bool:
    """Tests whether an actuator exerts force on its joints, by a command or by its bias."""
    biased = bool(problem.machine.base.model.actuator(actuator).biasprm.any())
    return biased or any(s.columns[f"{actuator}_command"].any() for s in problem.series)


def _at_centres(
    problem: Problem, u: Unknowns, members: list[int], x: np.ndarray
) -> dict[int, float]:
    """Returns moves, in trials, that put payloads of the set at their bodies' centres of mass."""
    bodies = {u.keys[q] for q in members if u.keys[q][0] == "payload"}
    found = {}
    for i in range(u.single):
        if u.keys[i] in bodies and u.shape[i]:
            reach = float(np.linalg.norm(moved_body(problem.machine, u.keys[i][1]).ipos))
            (key, n) = u.places[i][0]
            nominal = float(u.library.sites[key].nominal[n])
            found[i] = (reach - nominal) / u.scale[i] - float(x[i])
    return found
