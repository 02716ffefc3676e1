"""Where errors are largest, of errors made up by hand."""

import numpy as np

from leglab.diagnosis.balance.isolation import isolate
from leglab.diagnosis.balance.regions import EVERYWHERE, worst_region
from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.search.pipeline import DiagnosisSettings, set_up
from leglab.diagnosis.verdict.verdict import traces
from rigs import MOTOR_ARM, Hidden
from tests.helpers.unpleasant import of_kinds

RNG = np.random.default_rng(3)
POSITION = RNG.uniform(-1.0, 1.0, 4000)
VELOCITY = RNG.normal(0.0, 1.0, 4000)
NOISE = 0.1 * RNG.normal(size=4000)
STATES = {"position": (POSITION, "rad"), "velocity": (VELOCITY, "rad/s")}


def test_noise_is_everywhere_alike():
    assert worst_region(NOISE, STATES) == EVERYWHERE
    assert worst_region(np.zeros(4000), STATES) == EVERYWHERE


def test_a_peak_at_zero_velocity_is_near_zero_velocity():
    told = worst_region(NOISE + np.exp(-((VELOCITY / 0.15) ** 2)), STATES)
    assert told.startswith("near zero velocity (-0.")
    assert told.endswith(" rad/s)")


def test_an_error_at_one_end_is_told_by_its_ends():
    told = worst_region(NOISE + np.where(POSITION > 0.6, 1.0, 0.0), STATES)
    low, high = (float(x) for x in told.removeprefix("at a position of ")[:-4].split(" to "))
    assert abs(low - 0.6) < 0.05
    assert abs(high - 0.99) < 0.03


def test_what_repeats_is_told_with_its_period():
    told = worst_region(NOISE + np.sin(2.0 * np.pi * POSITION / 0.45), STATES)
    assert told.startswith("repeating every 0.4")
    assert abs(float(told.split()[2]) - 0.45) < 0.02


def test_a_smooth_slope_does_not_repeat():
    assert "repeating" not in worst_region(NOISE + POSITION**3 - POSITION, STATES)


def problem_of(hidden):
    recordings = of_kinds(MOTOR_ARM, hidden, ("multisine", "fast"), seconds=3.0)
    return set_up(MOTOR_ARM.model, recordings, ("multisine",), DiagnosisSettings())


def test_joints_of_a_right_model_are_off_by_noise():
    """Whatever the others do: their start states are uncertain together."""
    where = isolate(problem_of(Hidden()))
    assert len(where) == 2
    assert all(0.5 < w.level < 1.5 for w in where)


def test_a_machine_without_pressures_has_a_place_joint_by_joint():
    problem = problem_of(Hidden(quadratic=(0.0, 0.4)))
    where = isolate(problem)
    assert [w.residual for w in where] == ["motion", "motion"]
    assert where[0].element == "elbow"
    assert where[0].level > 2.0 * where[1].level
    assert all(w.region != EVERYWHERE for w in where)
    # In the noise levels of the gap; a joint alone is no further off than all of them together.
    gap = np.sqrt(problem.noise_levels(Hypothesis()).mean())
    assert all(20.0 < w.level <= np.sqrt(len(where)) * gap for w in where)
    # Measured less the error is what was simulated: it starts where the measured window does.
    for trace in traces(problem, Hypothesis()):
        shown = trace.measured.reshape(-1, trace.bins)
        assert np.allclose(shown.ravel(), trace.position, atol=0.05)
        assert shown.size == trace.before.size
