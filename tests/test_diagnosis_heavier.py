"""A weak drive is not told apart from a joint that resists more, where nothing else acts on it."""

import numpy as np
import pytest

from leglab.diagnosis import heavier
from leglab.diagnosis.fitting import refit
from leglab.diagnosis.hypothesis import Hypothesis
from leglab.diagnosis.workflow import DiagnosisSettings, set_up
from tests.rigs.rough import ROTOR, SERVO_LINK, as_made, record_rough

EFFECTS = ("actuator_gain", "armature", "viscous_friction", "coulomb_friction")


def weakened(rig, *, effects=EFFECTS, **factors):
    """A rough problem of a rig whose values are so many times the model's; a weak drive is fitted.

    Returns:
        The problem, the fit, and the keys of effects by name.
    """
    values = as_made(rig)
    for name, factor in factors.items():
        values[name] = values[name] * factor
    (logs,) = record_rough(rig, [values], seed=0, seconds=4.0)
    settings = DiagnosisSettings(effects=effects, threads=1)
    problem = set_up(rig.model, {k: logs[k] for k in ("multisine", "slow")}, (), settings)
    keys = {key[0]: key for key in problem.library.sites}
    gain = keys["actuator_gain"]
    at = problem.linearise(Hypothesis(), problem.fitted, {gain})
    start = Hypothesis({gain: np.array([0.7])})
    fit = refit(problem, at, frozenset({gain}), start=start, iterations=8)
    problem = problem.trusting(problem.discrepancy(fit.hypothesis))
    at = problem.linearise(fit.hypothesis, problem.fitted, {gain})
    fit = refit(problem, at, frozenset({gain}), start=fit.hypothesis, iterations=8)
    return problem, fit, keys


@pytest.fixture(scope="module")
def loaded():
    """A disc on the rotor that drags as well: a drive of 0.6 moves alike."""
    inertia = ROTOR.armature[0] + ROTOR.links[0][2]
    share = 1.0 + (1.0 / 0.6 - 1.0) * inertia / ROTOR.armature[0]
    return weakened(ROTOR, armature=share, damping=1.0 / 0.6, coulomb=1.0 / 0.6)


def test_what_resists_more_is_told_with_a_weak_drive(loaded):
    problem, fit, keys = loaded
    gain = keys["actuator_gain"]
    assert fit.hypothesis[gain][0] == pytest.approx(0.6, rel=0.1)
    names, ratio = heavier.resisted_instead(problem, fit, gain)
    assert names == EFFECTS[1:]
    assert 0.25 < ratio < 1e3


def test_nothing_resists_instead_of_what_is_no_drives_gain_or_beside_a_named_inertia(loaded):
    problem, fit, keys = loaded
    assert heavier.resisted_instead(problem, fit, keys["viscous_friction"]) == ((), 0.0)
    free = fit.free | {keys["armature"]}
    at = problem.linearise(fit.hypothesis, problem.fitted, free)
    both = refit(problem, at, free, start=fit.hypothesis, iterations=1)
    assert heavier.resisted_instead(problem, both, keys["actuator_gain"]) == ((), 0.0)


def test_a_weak_drive_that_carries_weight_is_told_apart():
    problem, fit, keys = weakened(SERVO_LINK, gain=0.6)
    assert fit.hypothesis[keys["actuator_gain"]][0] == pytest.approx(0.6, rel=0.1)
    assert heavier.resisted_instead(problem, fit, keys["actuator_gain"])[1] < 1e-3


def test_nothing_resists_instead_where_the_library_lacks_it():
    problem, fit, keys = weakened(ROTOR, effects=EFFECTS[:3], gain=0.6)
    assert heavier.resisted_instead(problem, fit, keys["actuator_gain"]) == ((), 0.0)
