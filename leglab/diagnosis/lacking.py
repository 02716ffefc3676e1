"""Forces along the measured motion that a model does not account for.

No valve and no integration comes between: what the mechanism lacks shows beside the sensors' noise
alone, where a replay of the same motion shows it behind all that the valve does.
"""

from collections.abc import Sequence

import numpy as np

from leglab.diagnosis.model import CHAMBERS, CYLINDER, Change, Machine, Measured
from leglab.diagnosis.moments import MomentForces, forces_at, plugin_offset
from leglab.diagnosis.starts import plays
from leglab.diagnosis.windows import Channel


def balanced_joints(machine: Machine, channels: Sequence[Channel]) -> tuple[str, ...]:
    """Joints whose drives' forces can be known: not those of cylinders without pressures."""
    known = {channel.column for channel in channels}
    blind = {
        joint
        for cylinder in machine.instances(CYLINDER)
        for joint in machine.driven[cylinder]
        if not {f"{machine.driven[cylinder][0]}_{c}" for c in CHAMBERS} <= known
    }
    return tuple(joint for joint in machine.joints if joint not in blind)


def lacking_forces(
    change: Change, measured: Measured, states: np.ndarray, half: int
) -> MomentForces:
    """Forces that the measured motion needs beyond the modelled ones.

    Args:
        change: Changes under the hypothesis.
        measured: Smoothed series; its samples are looked at.
        states: Full physics states at the samples, (samples, nstate).
        half: Accelerations are the mean over so many samples to both sides.
    """
    machine, model = change.machine, change.variant.model
    k, period = measured.samples, measured.period
    acceleration = np.zeros((k.size, model.nv))
    states = states.copy()
    velocity = states[:, 1 + model.nq : 1 + model.nq + model.nv]
    velocity[:] = 0.0
    for joint in machine.joints:
        v, dof = measured.velocity[joint], int(model.joint(joint).dofadr[0])
        acceleration[:, dof] = (v[k + half] - v[k - half]) / (2 * half * period)
        velocity[:, dof] = v[k]
    # Held commands change at samples: about one, the mean of both sides acts.
    native = machine.native_actuators()
    command = np.stack(
        [
            0.5 * (u[k] + u[k - 1]) if a in native else u[k]
            for a, u in ((a, measured.command[a]) for a in machine.actuators)
        ],
        axis=1,
    )
    start = plugin_offset(model)
    states[:, [start + place for place in plays(machine, change.variant)]] = 0.0
    return forces_at(model, states, command, acceleration)
