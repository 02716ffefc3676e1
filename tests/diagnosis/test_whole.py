"""Whole recordings simulated in closed loop: what the loop must add is what the model lacks."""

import numpy as np
import pytest

from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.replay.following import _gains, follow
from leglab.diagnosis.search.pipeline import DiagnosisSettings, set_up
from leglab.diagnosis.verdict.verdict import diagnose
from leglab.diagnosis.verdict.whole import whole_recording
from rigs import PENDULUM, SERVO_JOINT, SLIDE_AXIS, Hidden, Truth
from tests.helpers.unpleasant import of_kinds, thinned

OFFSET = ("force_offset", "axis")
ENCODER = ("encoder_offset", "axis")


def problem_of(rig, truth, *, lost=None, **settings):
    recordings = of_kinds(rig, truth, ("multisine", "slow"), seconds=6.0)
    if lost is not None:
        one = recordings["multisine"]
        recordings["multisine"] = thinned(one, (one.time < lost[0]) | (one.time > lost[1]))
    return set_up(rig.model, recordings, ("multisine",), DiagnosisSettings(**settings))


@pytest.fixture(scope="module")
def pushed():
    """An axis that something pushes by 2 N."""
    return problem_of(SLIDE_AXIS, Truth(offset=2.0))


def test_the_correction_of_an_axis_is_the_force_that_its_model_lacks(pushed):
    """Closed form: the loop adds what keeps the axis on its path, which is the hidden force."""
    number = next(i for i, s in enumerate(pushed.series) if s.name == "multisine")
    followed = follow(pushed, Hypothesis(), number)
    added = followed.correction["drive"][followed.time.size // 3 :].mean()
    assert added == pytest.approx(2.0, rel=0.05)
    right = Hypothesis().with_values(OFFSET, np.array([2.0]))
    known = follow(pushed, right, number)
    assert abs(known.correction["drive"].mean()) < 0.05
    assert known.deviation("axis") < 0.1 * followed.deviation("axis")


def test_without_a_loop_the_same_error_grows(pushed):
    held, free = (follow(pushed, Hypothesis(), 0, loop=loop) for loop in (1.0, 0.0))
    assert not any(added.any() for added in free.correction.values())
    assert free.deviation("axis") > 3.0 * held.deviation("axis")


def test_the_recording_that_is_missed_most_is_shown_before_and_after(pushed):
    right = Hypothesis().with_values(OFFSET, np.array([2.0]))
    whole = whole_recording(pushed, right)
    assert (whole.recording, whole.joint, whole.unit) == ("multisine", "axis", "m")
    told = whole.to_json()
    assert told["after"] < 0.1 * told["before"]
    assert told["correction_after"] < 0.1 * told["correction_before"]


def test_an_encoder_that_is_off_is_shown_as_it_measures(pushed):
    """The simulated position is the true one; what is drawn is what the faulty sensor shows."""
    shifted = Hypothesis().with_values(ENCODER, np.array([0.05]))
    whole = whole_recording(pushed, shifted)
    plain = whole_recording(pushed, Hypothesis())
    assert np.array_equal(whole.measured, plain.measured)
    # A slide is alike everywhere: the offset changes nothing but the axis of positions.
    assert np.abs(whole.after - plain.after).max() < 1e-6


def test_a_gap_ends_the_simulation():
    problem = problem_of(SLIDE_AXIS, Truth(), lost=(3.0, 3.4))
    followed = follow(problem, Hypothesis(), 0)
    assert 2.9 < followed.time[-1] < 3.1


def test_it_begins_after_an_onset(pushed):
    late = Hypothesis().with_values(OFFSET, np.array([2.0])).with_onset(OFFSET, np.full(2, 3.0))
    assert whole_recording(pushed, late).time[0] >= 3.0
    never = late.with_onset(OFFSET, np.full(2, 100.0))
    assert whole_recording(pushed, never) is None


@pytest.mark.parametrize(
    ("rig", "lead"), [(SLIDE_AXIS, "damped"), (PENDULUM, "damped"), (SERVO_JOINT, "none")]
)
def test_the_loop_leads_where_commands_set_forces_and_not_where_they_set_positions(rig, lead):
    if rig is SERVO_JOINT:
        recordings = of_kinds(rig, Hidden(), ("fast",), seconds=6.0)
        problem = set_up(rig.model, recordings, (), DiagnosisSettings())
    else:
        problem = problem_of(rig, Truth())
    change = problem.library.change(Hypothesis(), problem.machine)
    course = problem.replay.course(change, 0, -np.inf)
    proportional, rate = _gains(problem, course, 1.0)[:, 0, 0]
    assert proportional > 0.0
    if lead == "none":
        assert rate == 0.0
    else:
        window = problem.replay.window
        assert 0.3 * window < rate / proportional <= 2 * window


def test_one_effect_alone_may_be_asked_for():
    truth, kinds = Truth(forward=8.0, offset=2.0), ("multisine", "fast", "slow")
    recordings = of_kinds(SLIDE_AXIS, truth, kinds, seconds=4.0)
    settings = DiagnosisSettings(effects=("force_offset",))
    result, _ = diagnose(SLIDE_AXIS.model, recordings, held_out=("multisine",), settings=settings)
    assert {e.name for e in (*result.effects, *result.smaller)} <= {"force_offset"}
