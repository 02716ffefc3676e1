"""Whether a joint that resists more does as well as a drive that is weaker."""

import numpy as np

from leglab.diagnosis.effects.hypothesis import Key
from leglab.diagnosis.former.challenge import with_rival
from leglab.diagnosis.former.evidence import posterior
from leglab.diagnosis.former.fitting import Fit
from leglab.diagnosis.former.judging import noticeable
from leglab.diagnosis.former.search import total_cost
from leglab.diagnosis.replay.residual import Problem

_GAIN = "actuator_gain"
# All that resists a joint without springs and weight; the inertia first.
_RESISTING = ("armature", "viscous_friction", "coulomb_friction")


def resisted_instead(problem: Problem, fit: Fit, key: Key) -> tuple[tuple[str, ...], float]:
    """Whether more inertia and friction of a joint do as well as a weaker drive.

    A force f = g u moves a joint by f = J a + b v + c sign(v). Where nothing else acts on it and no
    force is measured, motions only say what g/J, b/J and c/J are.

    Args:
        problem: Of a rough machine.
        fit: With the effect.
        key: The effect.

    Returns:
        Names of what is there instead, and how many times as probable it is as the effect by its
        error alone. None and 0 for an effect that is no drive's gain, where the joint's inertia is
        named beside it, and where the library lacks one of these.
    """
    sites = problem.library.sites
    joint = problem.machine.driven.get(key[1], (key[1],))[0]
    instead = [(name, joint) for name in _RESISTING]
    if key[0] != _GAIN or instead[0] in fit.free or not all(k in sites for k in instead):
        return (), 0.0
    more = float(sites[key].nominal[0] / fit.hypothesis[key][0])
    start = fit.hypothesis.without(key)
    model = problem.machine.base.model
    inertia = model.dof_M0[model.joint(joint).dofadr]
    for one in instead:
        now = start.get(one, sites[one].nominal)
        # Armature is a part of the inertia, and makes up for all of it.
        values = now + (more - 1.0) * (inertia if one == instead[0] else now)
        start = start.with_values(one, np.clip(values, sites[one].lower, sites[one].upper))
    other = with_rival(problem, fit, fit.free - {key} | set(instead), start)
    costs = [float(total_cost(problem, one).mean()) for one in (fit, other)]
    own, heavier = posterior(costs, problem.numbers).tolist()
    names = tuple(
        one[0]
        for one in instead
        if noticeable(problem, one, other.hypothesis) and one[0] in problem.library.names
    )
    return names, heavier / max(own, 1e-300)
