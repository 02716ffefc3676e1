"""Machines with motors that differ from their models, by simulators of another kind."""

from dataclasses import replace

import numpy as np
import pytest

from leglab.diagnosis import directions, rough
from leglab.diagnosis.rough import rough_search, suspected
from leglab.diagnosis.search import search_round
from leglab.diagnosis.verdict import diagnose
from leglab.diagnosis.workflow import DiagnosisSettings, set_up
from tests.diagnosis_sketch import LIBRARY, OFFSET, a_fit, a_round, a_sketch, contender
from tests.rigs import PENDULUM, Truth, record
from tests.rigs.agreement import open_loop_error
from tests.rigs.rough import RIGS, SERVO_LINK, as_made, faults_of, hide, machine, record_rough

ARMATURE, VISCOUS = ("armature", "hinge"), ("viscous_friction", "hinge")
SPRING, COULOMB = ("spring_stiffness", "hinge"), ("coulomb_friction", "hinge")


@pytest.mark.parametrize("name", RIGS)
def test_the_independent_simulator_agrees_with_the_nominal_models(name):
    """Free of leglab altogether: the recorded commands drive the bare model along the recording."""
    rig = RIGS[name]
    quiet = record_rough(rig, [as_made(rig)], seed=0, seconds=1.0)[0]["fast"]
    assert open_loop_error(rig.model, quiet, rig.joints, rig.drives) < 1e-3  # rad, of 0.5 to 1.8


@pytest.mark.parametrize("name", RIGS)
def test_every_fault_moves_the_machine_and_no_two_machines_are_alike(name):
    rig = RIGS[name]
    healthy = machine(rig, np.random.default_rng(1))
    other = machine(rig, np.random.default_rng(2))
    ill = []
    for fault in faults_of(rig):
        values = {key: value.copy() for key, value in healthy.items()}
        hide(rig, values, fault, len(rig.joints) - 1, np.random.default_rng(3))
        ill.append(values)
    first, *others = record_rough(rig, [healthy, other, *ill], seed=0, seconds=1.0)
    joint = f"{rig.joints[-1]}_position"
    drive = f"{rig.drives[-1]}_command"
    for one in others:
        moved = np.abs(one["fast"][joint] - first["fast"][joint]).max()
        driven = np.abs(one["fast"][drive] - first["fast"][drive]).max()
        assert moved > 3e-4 or driven > 3e-3 * rig.torque[-1]


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"motor": 0.05, "viscous": 0.3}, [ARMATURE, VISCOUS]),
        ({"viscous": 0.3}, [VISCOUS]),
    ],
)
def test_two_effects_are_tried_at_once_and_one_where_that_is_all(changed, expected):
    """Neither of two alone explains the machine; of one, no pair explains more than it costs."""
    rig = replace(PENDULUM, **changed)
    kinds = ("multisine", "fast")
    logs = {k: record(rig, k, Truth(), seed=i, seconds=3.0) for i, k in enumerate(kinds)}
    tried = ("armature", "viscous_friction", "quadratic_damping")
    settings = DiagnosisSettings(effects=tried, threads=1)
    problem = set_up(PENDULUM.model, logs, (), settings)
    rng = np.random.default_rng(0)
    *_, fit, named, rounds = rough_search(problem, 1, rng, lambda _: None)
    assert sorted(named) == expected
    assert fit.free == frozenset(expected)
    if len(expected) == 2:
        assert rounds[-1].at_once
        assert not rounds[0].at_once
        pair = rounds[-1].contenders
        assert {c.key for c in pair[:2]} == set(expected)
        # Rivals of each, beside the other, challenge them afterwards.
        rivals = {c.key[0]: c.fit.free for c in pair[2:]}
        assert rivals["quadratic_damping"] & frozenset(expected)


def test_what_a_fault_opens_is_not_taken_for_an_error_of_the_model(monkeypatch):
    """The first effects are screened as if one left little, but no less than healthy errors."""
    rig = replace(PENDULUM, viscous=0.3)
    truth = Truth(offset=0.5)
    logs = {k: record(rig, k, truth, seed=1, seconds=3.0) for k in ("multisine", "fast")}
    settings = DiagnosisSettings(effects=("viscous_friction", "force_offset"), threads=1)
    problem = set_up(PENDULUM.model, logs, (), settings)
    seen = []

    def spy(problem, start, best, *rest, **others):
        seen.append((problem.noise.discrepancy, problem.discrepancy(best.hypothesis)))
        return search_round(problem, start, best, *rest, **others)

    monkeypatch.setattr(rough, "search_round", spy)
    monkeypatch.setattr(rough, "paired", lambda *_: ())
    limits = problem.thresholds
    _, base = rough.settled_baseline(problem, problem.fitted)
    healthy = problem.discrepancy(base.hypothesis).scaled(limits.calibrated_left, forces=True)
    healthy = replace(healthy, variance=healthy.variance * [[0.5], [2.0]])
    for floor, share in ((None, limits.rough_left), (healthy, limits.calibrated_left)):
        seen.clear()
        known, rng = floor is not None, np.random.default_rng(0)
        rough_search(problem, 2, rng, lambda _: None, floor=floor, calibrated=known)
        (used, own), *later = seen
        hoped = own.scaled(share, forces=True).at_least(floor)
        np.testing.assert_array_equal(used.variance, hoped.variance)
        np.testing.assert_array_equal(used.forces.variance, hoped.forces.variance)
        for used, own in later:
            np.testing.assert_array_equal(used.variance, own.at_least(floor).variance)
        assert later
    assert hoped.variance[1] > 1.5 * share * seen[0][1].variance[1]


def test_what_comes_nearest_is_fitted_where_nothing_was_named():
    """Here as if the round had ended without a name, and where no single one could be a cause."""
    rig = replace(PENDULUM, viscous=0.3)
    logs = {k: record(rig, k, Truth(), seed=1, seconds=3.0) for k in ("multisine", "fast")}
    tried = ("armature", "viscous_friction", "quadratic_damping", "command_delay")
    settings = DiagnosisSettings(effects=tried, threads=1)
    problem = set_up(PENDULUM.model, logs, (), settings)
    rng = np.random.default_rng(0)
    problem, base, fit, named, rounds = rough_search(problem, 1, rng, lambda _: None)
    assert named == [VISCOUS]
    nothing = replace(rounds[0], contenders=())

    def nearest(fit, named, tried):
        return suspected(problem, fit, named, tried, lambda _: None, calibrated=False)

    told, first = nearest(base, [], nothing)
    assert first is told.contenders[0]
    assert first.key == VISCOUS
    assert first.cost.mean() < 0.5 * told.base.mean()
    np.testing.assert_allclose(first.fit.hypothesis[VISCOUS], fit.hypothesis[VISCOUS], rtol=0.1)
    with pytest.MonkeyPatch.context() as patch:  # nor is what its directions speak against
        patch.setattr(directions, "differs", lambda problem, one: one.key != VISCOUS)
        assert VISCOUS not in {c.key for c in nearest(base, [], nothing)[0].contenders}
    # What is found already is a cause: nothing else is suspected.
    assert nearest(fit, named, nothing) == (nothing, None)
    # Less of it than in the model, or nothing that gains: none.
    worse = replace(nothing, candidates=tuple(replace(c, gain=-1.0) for c in nothing.candidates))
    assert nearest(base, [], worse)[1] is None


@pytest.mark.parametrize(("trials", "expected"), [(0.8, None), (4.0, OFFSET)])
def test_what_a_good_machine_may_have_is_not_suspected(trials, expected):
    """A force of which a smallest trial is barely noticeable."""
    settings = DiagnosisSettings(effects=("force_offset",), threads=1)
    force = trials * LIBRARY.sites[OFFSET].parameters[0].scale
    logs = {"fast": record(PENDULUM, "fast", Truth(offset=force), seed=1, seconds=4.0)}
    problem = set_up(PENDULUM.model, logs, (), settings)
    rng = np.random.default_rng(0)
    problem, base, _, _, rounds = rough_search(problem, 1, rng, lambda _: None)
    nothing = replace(rounds[0], contenders=())
    told, first = suspected(problem, base, [], nothing, lambda _: None, calibrated=False)
    assert (first and first.key) == expected
    for fitted in told.contenders:
        np.testing.assert_allclose(fitted.fit.hypothesis[OFFSET], force, rtol=0.1)


def test_a_rough_search_that_may_use_no_effect_names_none():
    logs = {"fast": record(PENDULUM, "fast", Truth(offset=0.5), seed=0, seconds=3.0)}
    settings = DiagnosisSettings(effects=(), threads=1)
    problem = set_up(PENDULUM.model, logs, (), settings)
    *_, named, _ = rough_search(problem, 2, np.random.default_rng(0), lambda _: None)
    assert named == []


def test_the_dead_band_of_a_servo_is_one_of_its_error():
    """Found from recordings of the independent simulator, and no command of zero is special."""
    made = as_made(SERVO_LINK)
    made["dead"][0] = 0.02  # rad
    made["noise"][0] = 3e-5
    (logs,) = record_rough(SERVO_LINK, [made], seed=1, seconds=3.0)
    result, _ = diagnose(SERVO_LINK.model, logs, settings=DiagnosisSettings(threads=1))
    (effect,) = result.effects
    assert result.verdict == "named"
    assert (effect.name, effect.element) == ("command_deadband", "servo")
    assert effect.confidence > 0.95
    assert effect.parameters[0].value == pytest.approx(0.02, rel=0.02)


@pytest.mark.parametrize(
    ("cause", "another", "taken", "ends"),
    [
        (4.0, 0.3, True, True),  # beside a cause only how the machine is made
        (4.0, 4.0, True, False),  # a second cause is near
        (4.0, 4.0, False, True),  # that is none by the round
        (0.3, 0.3, True, True),  # no cause at all
        (0.3, 4.0, False, False),  # one that explains too little so far
    ],
)
def test_a_search_ends_where_a_round_adds_only_how_the_machine_is_made(
    monkeypatch, cause, another, taken, ends
):
    problem = a_sketch(monkeypatch)
    slight = contender(LIBRARY, VISCOUS, 1.0)
    small = a_fit(LIBRARY, VISCOUS, trials=0.3)
    slight = replace(slight, fit=small)
    rival = replace(slight, key=SPRING, fit=a_fit(LIBRARY, SPRING, trials=another))
    tried = a_round([slight, rival])
    monkeypatch.setattr(rough, "accepted", lambda p, t, c: c is slight or taken)
    both = a_fit(LIBRARY, OFFSET, COULOMB, trials=cause).hypothesis
    both = both.with_values(VISCOUS, small.hypothesis[VISCOUS])
    fit = small.with_hypothesis(both)
    named = [OFFSET, VISCOUS]
    assert rough._only_made_so(problem, tried, named, fit, calibrated=False) is ends
    # After three effects none of which is a cause, it ends whatever is near.
    named = [OFFSET, VISCOUS, COULOMB]
    ends = ends or cause < 1.0
    assert rough._only_made_so(problem, tried, named, fit, calibrated=False) is ends


@pytest.mark.parametrize("ends", [True, False])
def test_rounds_end_there(monkeypatch, ends):
    rig = replace(PENDULUM, motor=0.05, viscous=0.3)
    kinds = ("multisine", "fast")
    logs = {k: record(rig, k, Truth(), seed=i, seconds=3.0) for i, k in enumerate(kinds)}
    tried = ("armature", "viscous_friction", "quadratic_damping")
    problem = set_up(PENDULUM.model, logs, (), DiagnosisSettings(effects=tried, threads=1))
    monkeypatch.setattr(rough, "paired", lambda *_: ())
    monkeypatch.setattr(rough, "_only_made_so", lambda *_, calibrated: ends)
    rng = np.random.default_rng(0)
    *_, named, rounds = rough_search(problem, 3, rng, lambda _: None)
    assert (len(rounds) == 1) is ends
    assert (len(named) == 1) is ends
