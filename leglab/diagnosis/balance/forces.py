"""Forces that the measured motion leaves over: what a model's own forces do not account for."""

import numpy as np
from scipy.signal import savgol_filter

from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.plant.model import ForceLeft
from leglab.diagnosis.plant.moments import commands_at, forces_at, states_at
from leglab.diagnosis.replay.lacking import balanced_joints
from leglab.diagnosis.replay.residual import Problem
from leglab.diagnosis.replay.starts import Instances

_EVERY = 0.015  # s, between the moments that are looked at
_ACCELERATION = 0.031  # s, filter of the velocity's slope


def forces_left(problem: Problem, hypothesis: Hypothesis) -> dict[str, ForceLeft]:
    """Forces left over in the fitted windows, by joint: M a + bias less all modelled forces.

    Joints of cylinders whose pressures are not measured are left out: nobody knows their force.
    """
    replay, machine = problem.replay, problem.machine
    change = problem.library.change(hypothesis, replay.machine)
    variant, model = change.variant, change.variant.model
    known = balanced_joints(machine, problem.channels)
    dofs = [int(model.joint(joint).dofadr[0]) for joint in machine.joints]
    tables = []
    for measured in replay.moments(change, problem.fitted, _EVERY):
        length = 2 * round(0.5 * _ACCELERATION / measured.period) + 1
        slope = {
            joint: savgol_filter(v, max(length, 5), 2, deriv=1, delta=measured.period)
            for joint, v in measured.velocity.items()
        }
        at = measured.samples
        state = np.tile(variant.plugin_state, (at.size, 1))
        for (element, name), value in change.parameters.items():
            state[:, variant.slot(element, name)] = value
        for channel in problem.channels:
            if channel.chamber and channel.cylinder:
                slot = variant.slot(channel.cylinder, channel.chamber)
                state[:, slot] = measured.pressure[channel.column][at]
        instances = Instances(machine=machine, measured=measured, variant=variant, state=state)
        instances.reconstruct()
        for (element, name), function in change.starts.items():
            state[:, variant.slot(element, name)] = function(measured, variant, state)
        motion = (measured.position, measured.velocity, slope)
        q, v, a = (np.stack([x[j][at] for j in machine.joints], axis=1) for x in motion)
        acceleration = np.full((at.size, model.nv), np.nan)
        acceleration[:, dofs] = a
        states = states_at(machine, model, measured, at, state)
        found = forces_at(model, states, commands_at(machine, measured, at), acceleration)
        tables.append((q, v, a, found.lacking[:, dofs]))
    joined = [np.concatenate(parts) for parts in zip(*tables, strict=True)]
    return {
        joint: ForceLeft(*(x[:, i] for x in joined))
        for i, joint in enumerate(machine.joints)
        if joint in known
    }
