"""Residual (unmodelled) forces along the measured motion, computed by inverse dynamics."""

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
    """Returns the joints whose drive forces are known; a cylinder's needs measured pressures.

    Joints that lead others by equality constraints are excluded, as constraint forces are unknown.
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
    """Computes the forces that the measured motion needs beyond the forces of the changed model.

    `states` are the full physics states at the samples of `measured`, (samples, nstate).
    Accelerations are means over `half` samples before and after each sample.
    """
    machine, model, k = change.machine, change.variant.model, measured.samples
    start = plugin_offset(model)
    plugin = states[:, start : start + model.npluginstate]
    closed = plays(machine, change.variant)
    moments = states_at(machine, model, measured, k, plugin, without=closed)
    moments[:, 0] = states[:, 0]
    # Commands are held between samples, so the acceleration around a sample is due to the mean of
    # its command and the previous command. With `actearly`, it is due to the previous command.
    now, before = (commands_at(machine, measured, samples) for samples in (k, k - 1))
    native = np.isin(machine.actuators, machine.native_actuators())
    command = np.where(native, 0.5 * (now + before), now)
    command = np.where(model.actuator_actearly, before, command)
    return forces_at(model, moments, command, accelerations(machine, model, measured, half))


def comparable_forces(
    change: Change, measured: Measured, found: MomentForces, joints: Sequence[str]
) -> np.ndarray:
    """Refers residual forces to the unmodified machine's inertia, (samples, joints) [N m or N].

    A hypothesis that halves all inertias, frictions and drive forces has half the residual forces,
    although its motion is equally wrong. So a residual force f is converted to the acceleration it
    causes, in units of the sensor, and then to the force that causes this acceleration on the
    unmodified machine: M_0 M^-1 f with joint-space inertias M_0 (unmodified) and M (hypothesis).
    `found` has the hypothesis's residual forces; `joints` is the result of `balanced_joints`.
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
