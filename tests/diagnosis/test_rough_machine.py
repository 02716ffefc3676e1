"""A machine that differs from its model everywhere a little: diagnoses with real replays."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from leglab.diagnosis import improve
from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.likelihood.unknowns import EVERY
from leglab.diagnosis.search.pipeline import DiagnosisSettings
from leglab.diagnosis.verdict.outcome import Outcome
from leglab.diagnosis.verdict.verdict import diagnose
from leglab.report.diagnosis.words import headline
from rigs import PENDULUM, Truth
from rigs.rough_bench import exact_specimen, references
from rigs.rough_bench import record as record_bench
from tests.helpers.unpleasant import of_kinds

# Of this regime `test_diagnosis_verdicts.py` has smaller ones.
pytestmark = pytest.mark.slow("whole diagnoses of a rough rig")

OFFSET = ("force_offset", "hinge")

# Heavier, with a soft gear that loses power, a toothed pull and a thicker grease.
ROUGH_RIG = replace(PENDULUM, load=0.104, pull=1.02 * PENDULUM.pull)
ROUGH = {
    "ripple": (0.05, 0.5, 0.3),
    "gear_loss": 0.03,
    "soft": (400.0, 0.4),
    "viscous_factor": 1.3,
}
SETTINGS = DiagnosisSettings(
    effects=("force_offset", "viscous_friction", "coulomb_friction"), threads=1
)
HELD_OUT = "multisine"


def recordings(kinds, seed, **fault):
    return of_kinds(ROUGH_RIG, Truth(**ROUGH, **fault), kinds, seconds=4.0, first=seed)


@pytest.fixture(scope="module")
def healthy():
    return recordings(("multisine", "stairs"), 10)


@pytest.fixture(scope="module")
def ill(healthy):
    """A specimen that pulls to one side since it was healthy."""
    later = recordings((HELD_OUT, "fast", "stairs"), 0, offset=0.4)
    return diagnose(PENDULUM.model, later, held_out=(HELD_OUT,), healthy=healthy, settings=SETTINGS)


@pytest.fixture(scope="module")
def well(healthy):
    """The same specimen on another day, nothing changed."""
    later = recordings((HELD_OUT, "fast", "stairs"), 0)
    return diagnose(PENDULUM.model, later, held_out=(HELD_OUT,), healthy=healthy, settings=SETTINGS)


def test_what_changed_since_a_rough_machine_was_healthy_is_named(ill):
    result, found = ill
    assert result.verdict == "named"
    assert [e.name for e in result.effects] == ["force_offset"]
    assert result.effects[0].confidence > 0.8
    (force,) = result.effects[0].parameters
    # The effect departs from what the specimen was, and says so.
    assert force.nominal == found.specimen.values[OFFSET][0]
    assert force.value - force.nominal == pytest.approx(0.4, rel=0.1)
    low, high = force.interval
    assert low - force.nominal < 0.4 < high - force.nominal


def test_a_rough_machine_that_is_as_healthy_as_before_gets_no_name(well):
    result, _ = well
    assert result.verdict == "nothing_missing"
    assert result.effects == ()
    assert result.smaller == ()


def test_an_unchanged_machine_is_told_so_whatever_explains_its_errors(healthy):
    """On another day, with thinner grease, by all effects: some set always lessens the errors."""
    day = Truth(**{**ROUGH, "viscous_factor": 1.2})
    later = of_kinds(ROUGH_RIG, day, (HELD_OUT, "fast", "stairs"), seconds=4.0)
    asked = {"held_out": (HELD_OUT,), "settings": DiagnosisSettings(threads=1)}
    result, _ = diagnose(PENDULUM.model, later, healthy=healthy, **asked)
    assert headline(result).startswith("Nothing has changed")
    assert result.effects == result.smaller == ()


def test_the_gap_is_that_of_the_held_out_recordings(ill):
    result, found = ill
    problem, final = found.about, found.final

    def level(hypothesis, windows):
        return np.sqrt(problem.noise_levels(hypothesis)[windows].mean())

    held = np.array([problem.series[i].name == HELD_OUT for i in problem.replay.recording])
    assert result.gap.held_out == (HELD_OUT,)
    unnamed = final.without(*found.named)
    told = {
        "before": Hypothesis(),
        "baseline": found.baseline,
        "after": final,
        "unnamed": unnamed,
    }
    for name, hypothesis in told.items():
        assert getattr(result.gap, name) == pytest.approx(level(hypothesis, held)), name
        assert getattr(result.gap, name) != pytest.approx(level(hypothesis, ~held), rel=5e-4), name
    specimen = found.specimen
    by_name = dict(zip(("multisine", "stairs"), specimen.levels, strict=True))
    assert result.gap.healthy == pytest.approx(by_name["multisine"][1])
    assert result.gap.healthy > 2.0  # twice the noise, which the gap leaves out
    assert result.gap.explained > 0.9
    # Names are judged by errors as the healthy machine has them.
    own = found.sets.fitter.fixed.replays[problem.replay.recording[held]]
    inverse = np.linalg.inv(problem.noise.covariance(held) + own)
    for told_as, hypothesis in zip(result.gap.compared, (unnamed, final), strict=False):
        errors = problem.raw_errors(hypothesis)[held].reshape(len(inverse), -1)
        squares = np.einsum("wi,wij,wj->w", errors, inverse, errors) / errors.shape[1]
        assert told_as == pytest.approx(np.sqrt(squares.mean()), rel=1e-3)


def test_no_fit_sees_the_held_out_recordings(ill, well):
    for _, found in (ill, well):
        problem = found.problem
        held = np.array([problem.series[i].name == HELD_OUT for i in problem.replay.recording])
        np.testing.assert_array_equal(problem.held, held)
        chosen = found.found.fitter.at.chosen
        assert chosen.any()
        assert not (chosen & held).any()


def test_the_nearest_healthy_recording_is_that_of_the_same_motion(ill):
    specimen, problem = ill[1].specimen, ill[1].problem
    assert [s.name for s in specimen.problem.series] == ["multisine", "stairs"]
    nearest = dict(zip([s.name for s in problem.series], specimen.nearest(problem), strict=True))
    assert nearest["multisine"] == 0
    assert nearest["stairs"] == 1


# What improved.xml carries.


@pytest.fixture
def unlearned(monkeypatch):
    """No remainder: what the effects alone are worth."""
    monkeypatch.setattr(improve, "learn_remainder", lambda *args, **kwargs: None)


def told(found, **changes):
    """The same outcome with another verdict."""
    other = copy(found)
    object.__setattr__(other, "result", replace(found.result, **changes))
    return other


def test_the_improved_model_carries_what_is_named(ill, unlearned):
    found = ill[1]
    model = improve.improved_model(found)
    whole = model.problem.library.whole(model.hypothesis)
    np.testing.assert_array_equal(whole[OFFSET], found.final[OFFSET])


def test_nothing_is_learned_where_nothing_is_missing(well, monkeypatch):
    """The specimen errs as it did: a force learned on top would contradict the verdict."""

    learned = []
    learn = improve.learn_remainder

    def noted(problem, *args, **settings):
        learned.append(problem)
        return learn(problem, *args, **settings)

    monkeypatch.setattr(improve, "learn_remainder", noted)
    found = well[1]
    assert improve.improved_model(found) is not None  # the calibration of the specimen
    assert not learned
    much = replace(found.result.gap, after=10.0)
    improve.improved_model(told(found, verdict="unexplained", gap=much))
    assert learned


@pytest.mark.parametrize("said", ["unexplained", "named"])
def test_the_improved_model_carries_no_effect_without_a_name(ill, unlearned, said):
    """Nor one that the search has found and the verdict does not name."""
    result, found = ill
    found = told(found, verdict=said, effects=() if said == "named" else result.effects)
    model = improve.improved_model(found)
    if model is not None:  # recalibration alone may pay
        offset = model.problem.library.whole(model.hypothesis)[OFFSET]
        assert abs(offset - found.specimen.values[OFFSET]) < 0.1
        assert not model.hypothesis.only(found.named)


def test_an_effect_of_all_joints_and_of_one_of_them_is_named_once(ill):
    found = ill[1]
    judged = replace(found.judged, named=(OFFSET, (OFFSET[0], EVERY)))
    assert Outcome(found.sets, found.table, judged, found.specimen).named == (OFFSET,)


def test_no_model_is_written_that_errs_more_where_held_out(ill, unlearned):
    worse = told(ill[1])
    object.__setattr__(worse, "written", worse.written.with_values(OFFSET, np.array([-0.4])))
    assert improve.improved_model(worse) is None


def test_no_model_is_written_where_only_fitted_recordings_gain(ill, unlearned, monkeypatch):
    found = ill[1]
    problem, levels = found.problem, type(found.problem).noise_levels

    def only_fitted(self, hypothesis):
        """The held-out recordings err as they did before, whatever is said."""
        found, before = levels(self, hypothesis), levels(self, problem.library.neutral())
        return np.where(problem.held, before, found)

    monkeypatch.setattr(type(problem), "noise_levels", only_fitted)
    assert improve.improved_model(found) is None


def of_exact_bench(**laws):
    """Verdict on the bench of an exact specimen with other laws."""
    bench = replace(exact_specimen(3).changed(**laws), position_noise=6e-5, pressure_noise=5e4)
    rng = np.random.default_rng(22)
    recorded = record_bench(bench, None, references(rng, 6.0), rng)
    settings = DiagnosisSettings(threads=1)
    return diagnose("knee_bench", recorded, held_out=(HELD_OUT,), settings=settings)[0]


def test_seals_of_another_law_are_no_friction_by_direction():
    """They creep where the model's bristles hold: a friction of the joint had stood in for that."""
    (thick,) = of_exact_bench(friction_law=1.0, tanh_speed=0.001, viscous=1400.0).effects
    assert thick.name == "viscous_friction"
    # Cold oil does nearly the same.
    assert set(thick.indistinguishable_from) <= {"oil_viscosity"}


def test_edges_ground_apart_and_a_return_line_under_pressure_are_no_fault_of_sensors():
    """They set the level of both pressures, of which offsets of their sensors had been made."""
    laps = {"lap_pa": 0.018, "lap_at": 0.022, "lap_pb": 0.0185, "lap_bt": 0.0215}
    result = of_exact_bench(**laps, tank_pressure=1.5e5)
    assert (result.verdict, result.effects) == ("nothing_missing", ())
