"""Forces that the measured motion leaves over: what a model's own forces do not account for."""

import numpy as np

from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.plant.model import ForceLeft
from leglab.diagnosis.replay.lacking import accelerations, lacking_forces
from leglab.diagnosis.replay.residual import Problem


def forces_left(problem: Problem, hypothesis: Hypothesis) -> dict[str, ForceLeft]:
    """Forces left over in the fitted windows, by joint: M a + bias less all modelled forces.

    Joints of cylinders whose pressures are not measured are left out: nobody knows their force.
    """
    replay, joints = problem.replay, problem.balanced
    if not joints:
        return {}
    change = problem.library.change(hypothesis, replay.machine)
    dofs = [int(change.variant.model.joint(joint).dofadr[0]) for joint in joints]
    tables = []
    for _, at, states in replay.along(change, problem.fitted):
        q = np.stack([at.position[joint][at.samples] for joint in joints], axis=1)
        v = np.stack([at.velocity[joint][at.samples] for joint in joints], axis=1)
        found = lacking_forces(change, at, states, replay.half).lacking[:, dofs]
        tables.append((q, v, accelerations(change, at, replay.half)[:, dofs], found))
    joined = [np.concatenate(parts) for parts in zip(*tables, strict=True)]
    return {joint: ForceLeft(*(x[:, i] for x in joined)) for i, joint in enumerate(joints)}
