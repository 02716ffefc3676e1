"""A machine that differs from its model everywhere a little: a whole diagnosis with real replays.

What was put into the judging to see these turn red is in docs/diagnosis.md, "How the judging is
tested".
"""

from dataclasses import replace

import numpy as np
import pytest

from leglab.diagnosis import improve
from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.former.judging import intervals
from leglab.diagnosis.former.naming import rms
from leglab.diagnosis.former.nuisances import all_strengths
from leglab.diagnosis.search.pipeline import DiagnosisSettings, search, set_up
from leglab.diagnosis.thresholds import DEFAULT
from leglab.diagnosis.verdict.measure import Measure
from leglab.diagnosis.verdict.verdict import assemble, diagnose
from tests.rigs import PENDULUM, Truth, record

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
    truth = Truth(**ROUGH, **fault)
    return {
        kind: record(ROUGH_RIG, kind, truth, seed=seed + i, seconds=4.0)
        for i, kind in enumerate(kinds)
    }


@pytest.fixture(scope="module")
def healthy():
    return recordings(("multisine", "stairs"), 10)


@pytest.fixture(scope="module")
def ill(healthy):
    """A specimen that pulls to one side since it was healthy."""
    later = recordings((HELD_OUT, "fast", "stairs"), 0, offset=0.4)
    return diagnose(PENDULUM.model, later, held_out=(HELD_OUT,), healthy=healthy, settings=SETTINGS)


@pytest.fixture(scope="module")
def well(ill, healthy):
    """The same specimen on another day, nothing changed."""
    specimen = ill[1].specimen
    problem = set_up(
        PENDULUM.model,
        recordings((HELD_OUT, "fast", "stairs"), 0),
        (HELD_OUT,),
        SETTINGS,
        specimen=specimen.values,
        beside=healthy,
    )
    found = search(problem, SETTINGS, specimen=specimen)
    return assemble(found, SETTINGS, seconds=0.0), found


def test_what_changed_since_a_rough_machine_was_healthy_is_named(ill):
    result, found = ill
    assert result.rough
    assert result.verdict == "named"
    assert [e.name for e in result.effects] == ["force_offset"]
    assert result.effects[0].confidence > 0.8
    (force,) = result.effects[0].parameters
    # The effect departs from what the specimen was, and says so.
    assert force.nominal == found.specimen.values[OFFSET][0]
    assert force.value - force.nominal == pytest.approx(0.4, rel=0.1)
    # The interval allows for everything else that may be off a little.
    limits, library = found.problem.thresholds, found.problem.library
    beside = all_strengths(library, limits.rough_share, 1.0)
    half = intervals(found.problem, found.fit, beside)[OFFSET][0]
    structure = 1.96 * limits.rough_size * (force.value - force.nominal)
    wide = np.hypot(half, structure)
    assert force.interval == pytest.approx((force.value - wide, force.value + wide))
    assert half >= intervals(found.problem, found.fit)[OFFSET][0]


def test_a_rough_machine_that_is_as_healthy_as_before_gets_no_name(well):
    result, _ = well
    assert result.verdict == "nothing_missing"
    assert result.effects == ()
    assert result.smaller == ()


def test_the_gap_is_that_of_the_held_out_recordings(ill):
    result, found = ill
    problem, final = found.problem, found.fit.hypothesis

    def level(hypothesis, windows):
        return np.sqrt(problem.noise_levels(hypothesis)[windows].mean())

    held = np.array([problem.series[i].name == HELD_OUT for i in problem.replay.recording])
    assert result.gap.held_out == (HELD_OUT,)
    told = {
        "before": Hypothesis(),
        "baseline": found.baseline.hypothesis,
        "after": final,
        "unnamed": final.without(*found.named),
    }
    for name, hypothesis in told.items():
        assert getattr(result.gap, name) == pytest.approx(level(hypothesis, held)), name
        assert getattr(result.gap, name) != pytest.approx(level(hypothesis, ~held), rel=2e-3), name
    by_name = dict(zip(("multisine", "stairs"), found.specimen.after, strict=True))
    assert result.gap.healthy == pytest.approx(by_name["multisine"])
    assert result.gap.healthy > 5.0  # far from noise alone, and what it is no part of what is open
    assert result.gap.explained > 0.9
    # What confidence is taken from is over all recordings.
    measure = Measure.of(problem, found.specimen)
    every = np.ones_like(held)
    for told, windows in ((result.gap.compared, held), (result.gap.everywhere, every)):
        errors = [measure.squares(h)[windows] for h in (final.without(*found.named), final)]
        assert told == pytest.approx((*(rms(e) for e in errors), measure.floor(windows)))
    assert result.gap.everywhere != pytest.approx(result.gap.compared, rel=2e-3)


def test_no_fit_sees_the_held_out_recordings(ill, well):
    for _, found in (ill, well):
        problem = found.problem
        held = np.array([problem.series[i].name == HELD_OUT for i in problem.replay.recording])
        np.testing.assert_array_equal(problem.held, held)
        np.testing.assert_array_equal(problem.fitted, ~held)
        fits = [found.baseline, found.fit]
        fits += [c.fit for one in found.rounds for c in one.contenders]
        for fit in fits:
            assert fit.at.chosen.any()
            assert not (fit.at.chosen & held).any()


def test_a_round_knows_what_chance_gives(ill):
    # 99 % of a chi-square with one degree of freedom; of the best of several, more.
    assert ill[1].rounds[0].threshold > 6.6


def test_the_discrepancy_is_that_of_the_best_explanation(ill):
    """Annealed: an estimate about the model without the effect would be hundreds of times that."""
    found = ill[1]
    problem, floor = found.problem, found.specimen.discrepancy_of(found.problem.series)
    now = problem.noise.discrepancy.variance
    left = problem.discrepancy(found.fit.hypothesis).at_least(floor).variance
    without = problem.discrepancy(found.fit.hypothesis.without(OFFSET)).variance
    assert (now < 4.0 * left).all()
    assert (now < 0.1 * without).all()
    cost = found.problem.window_cost(found.fit.hypothesis)
    assert 0.3 < np.median(cost) < 1.5
    # Under it the contenders of the round were judged: neither all right nor all wrong.
    costs = {c.key[0]: c.cost.mean() for c in found.rounds[0].contenders}
    assert 0.3 < costs.pop("force_offset") < 1.5
    assert min(costs.values(), default=9.0) > 3.0


def test_the_discrepancy_is_at_least_that_of_the_healthy_recordings(ill, well):
    for _, found in (ill, well):
        floor = found.specimen.discrepancy_of(found.problem.series)
        assert (floor.variance > 0.0).all()
        assert (found.problem.noise.discrepancy.variance >= floor.variance).all()


def test_a_discrepancy_gives_errors_their_usual_cost(well):
    """Each kind of evidence in the middle of its windows: the middle of a sum is another one."""
    problem, hypothesis = well[1].problem, well[1].fit.hypothesis
    found = problem.discrepancy(hypothesis)
    trusting = problem.trusting(found)
    replays = len(problem.channels) * problem.replay.bins
    white = trusting.residual(hypothesis)
    kinds = [white[:, :replays], white[:, replays:]]
    # Kinds count alike in the sum, however many numbers they are.
    sizes = [np.sqrt(0.5 * white.shape[1] / kind.shape[1]) for kind in kinds]
    assert kinds[1].shape[1] == DEFAULT.force_blocks
    for kind, size in zip(kinds, sizes, strict=True):
        usual = np.median(np.mean((kind / size) ** 2, axis=1))
        assert usual == pytest.approx(DEFAULT.usual_cost, rel=0.03)


def test_the_nearest_healthy_recording_is_that_of_the_same_motion(ill):
    specimen, series = ill[1].specimen, ill[1].problem.series
    assert [s.name for s in specimen.problem.series] == ["multisine", "stairs"]
    nearest = dict(zip([s.name for s in series], specimen.nearest(series), strict=True))
    assert nearest["multisine"] == 0
    assert nearest["stairs"] == 1
    shared = specimen.discrepancy_of(series)
    known = specimen.discrepancy.variance
    np.testing.assert_array_equal(shared.variance, known[specimen.nearest(series)])


# What improved.xml carries.


@pytest.fixture
def unlearned(monkeypatch):
    """No remainder: what the effects alone are worth."""
    monkeypatch.setattr(improve, "learn_remainder", lambda *args, **kwargs: None)


def test_the_improved_model_carries_what_is_named(ill, unlearned):
    result, found = ill
    model = improve.improved_model(found, result)
    whole = model.problem.library.whole(model.hypothesis)
    np.testing.assert_array_equal(whole[OFFSET], found.fit.hypothesis[OFFSET])


def test_nothing_is_learned_where_nothing_is_missing(well, monkeypatch):
    """The specimen errs as it did: a force learned on top would contradict the verdict."""

    def learned(*args, **kwargs):
        raise AssertionError("learned")

    monkeypatch.setattr(improve, "learn_remainder", learned)
    result, found = well
    model = improve.improved_model(found, result)
    assert model is not None  # the calibration of the specimen
    with pytest.raises(AssertionError, match="learned"):
        improve.improved_model(found, replace(result, verdict="unexplained"))


@pytest.mark.parametrize("said", ["unexplained", "named"])
def test_the_improved_model_carries_no_effect_without_a_name(ill, unlearned, said):
    """Nor one that the search has found and the verdict does not name."""
    result, found = ill
    result = replace(result, verdict=said, effects=() if said == "named" else result.effects)
    model = improve.improved_model(found, result)
    if model is not None:  # recalibration alone may pay
        offset = model.problem.library.whole(model.hypothesis)[OFFSET]
        assert abs(offset - found.specimen.values[OFFSET]) < 0.1
        assert not model.hypothesis.only(found.named)


def test_no_model_is_written_that_errs_more_where_held_out(ill, unlearned):
    result, found = ill
    worse = found.fit.hypothesis.with_values(OFFSET, np.array([-0.4]))
    found = replace(found, fit=found.fit.with_hypothesis(worse))
    assert improve.improved_model(found, result) is None


def test_no_model_is_written_where_only_fitted_recordings_gain(ill, unlearned, monkeypatch):
    result, found = ill
    problem, levels = found.problem, type(found.problem).noise_levels

    def only_fitted(self, hypothesis):
        """The held-out recordings err as they did before, whatever is said."""
        found, before = levels(self, hypothesis), levels(self, problem.library.neutral())
        return np.where(problem.held, before, found)

    monkeypatch.setattr(type(problem), "noise_levels", only_fitted)
    assert improve.improved_model(found, result) is None
