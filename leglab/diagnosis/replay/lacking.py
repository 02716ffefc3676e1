"""Forces along the measured motion that a model does not account for, without any integration."""

from collections.abc import Sequence

import mujoco
import numpy as np

from leglab.diagnosis.plant.model import CHAMBERS, Change, Machine, Measured
from leglab.diagnosis.plant.moments import (
    MomentForces,
    accelerations,
    commands_at,
    dofs,
    forces_at,
    plugin_offset,
    states_at,
)
from leglab.diagnosis.replay.starts import plays
from leglab.diagnosis.replay.windows import Channel


def balanced_joints(machine: Machine, channels: Sequence[Channel]) -> tuple[str, ...]:
    """Joints whose drives' forces can be known: not those of cylinders without pressures.

    Nor those that lead others, as the forces of equalities between exact positions are unknown.
    """
    known = {channel.column for channel in channels}
    blind = {
        joint
        for cylinder in machine.cylinders
        for joint in machine.driven[cylinder]
        if not {f"{machine.driven[cylinder][0]}_{c}" for c in CHAMBERS} <= known
    }
    return tuple(joint for joint in machine.joints if joint not in blind | machine.leading)


def lacking_forces(
    change: Change, measured: Measured, states: np.ndarray, half: int
) -> MomentForces:
    """Forces that the measured motion needs beyond the modelled ones under a change.

    At the samples of `measured`, with full physics states `states` there, (samples, nstate).
    Accelerations are the mean over `half` samples to both sides.
    """
    machine, model, k = change.machine, change.variant.model, measured.samples
    start = plugin_offset(model)
    plugin = states[:, start : start + model.npluginstate]
    closed = plays(machine, change.variant)
    moments = states_at(machine, model, measured, k, plugin, without=closed)
    moments[:, 0] = states[:, 0]
    # Held commands change at samples: about one, the mean of both sides acts. What steps its
    # activation first has that of one step before.
    now, before = (commands_at(machine, measured, samples) for samples in (k, k - 1))
    native = np.isin(machine.actuators, machine.native_actuators())
    command = np.where(native, 0.5 * (now + before), now)
    command = np.where(model.actuator_actearly, before, command)
    return forces_at(model, moments, command, accelerations(machine, model, measured, half))


def comparable_forces(
    change: Change, measured: Measured, found: MomentForces, joints: Sequence[str]
) -> np.ndarray:
    """Forces left over as hypotheses can be compared by them, (samples, joints) [N m or N].

    A hypothesis that halves all inertia, friction and drive also halves what it leaves over, while
    it errs as much in every motion. So what is left over counts by the acceleration that it makes,
    as the sensor tells it, and that by the force it takes on the unmodified machine: M_0 M^-1 f for
    a force f and joint-space inertias M_0 and M. `found` is what the hypothesis leaves over,
    `joints` those that can be known.
    """
    machine, base, k = change.machine, change.machine.base, measured.samples

    def nominal() -> np.ndarray:
        states = states_at(machine, base.model, measured, k, base.plugin_state)
        return forces_at(base.model, states, commands_at(machine, measured, k)).inertia

    def block(inertia: np.ndarray, model: mujoco.MjModel) -> np.ndarray:
        own = dofs(model, joints)
        return inertia[:, own][:, :, own]

    model, given = change.variant.model, (k, *measured.position.values())
    unmodified = block(measured.hidden_states.get("inertia", given, nominal, by=base), base.model)
    left = found.lacking[:, dofs(model, joints)]
    gained = np.linalg.solve(block(found.inertia, model), left[:, :, None])
    undone = (change.corrections.get(f"{joint}_position", ()) for joint in joints)
    gains = np.array([np.prod([gain for _, gain in one]) for one in undone])
    return (unmodified @ gained)[:, :, 0] / gains
