"""The judging is judged: each fault that was once put into it turns one of these tests red.

docs/diagnosis.md, "How the judging is tested", lists the faults beside the tests.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from leglab.diagnosis import naming, rough, verdict, workflow
from leglab.diagnosis.discrepancy import Discrepancy, from_errors
from leglab.diagnosis.effects.base import EffectParameter
from leglab.diagnosis.fitting import Fit
from leglab.diagnosis.hypothesis import Hypothesis, Library
from leglab.diagnosis.judging import (
    accepted,
    beyond_specimens,
    intervals,
    noticeable,
    posterior,
    simplest_first,
)
from leglab.diagnosis.model import Machine
from leglab.diagnosis.nuisances import rough_nuisances, specimen_nuisances, within_tolerance
from leglab.diagnosis.residual import Linearisation, NoiseModel
from leglab.diagnosis.result import Gap
from leglab.diagnosis.rough import at_least, settled_baseline
from leglab.diagnosis.search import Contender, Round
from leglab.diagnosis.thresholds import DEFAULT
from leglab.diagnosis.windows import Channel
from leglab.diagnosis.workflow import Search
from leglab.studies.blind.selftest import Outcome, scores
from tests.rigs import PENDULUM

OFFSET, VISCOUS = ("force_offset", "hinge"), ("viscous_friction", "hinge")
ASYMMETRIC, COULOMB = ("asymmetric_friction", "hinge"), ("coulomb_friction", "hinge")
WINDOWS, SIZE = 40, 30
HELD = np.arange(WINDOWS) >= 25


# A sketch of a problem: costs are given, nothing is replayed.


@pytest.fixture(scope="module")
def machine():
    return Machine(PENDULUM.model)


@pytest.fixture(scope="module")
def library(machine):
    return Library(machine)


@pytest.fixture
def sketch(machine, library, monkeypatch):
    """What a judge asks of a problem; `costs` by the set of effects that are there."""
    costs: dict = {}

    def cost(hypothesis):
        return np.broadcast_to(costs[frozenset(hypothesis)], WINDOWS).astype(float)

    no_width = {OFFSET: np.zeros(1), VISCOUS: np.zeros(1), ASYMMETRIC: np.zeros(4)}
    monkeypatch.setattr(naming, "intervals", lambda problem, fit: no_width)
    problem = SimpleNamespace(
        machine=machine,
        library=library,
        thresholds=DEFAULT,
        channels=(Channel(column="hinge_position", joint="hinge"),),
        series=[],
        size=SIZE,
        held=HELD,
        judged=HELD,
        fitted=~HELD,
        noise=SimpleNamespace(discrepancy=None),
        costs=costs,
        window_cost=cost,
        noise_levels=cost,
    )
    problem.trusting = lambda discrepancy: problem
    return problem


def a_fit(library, *keys, trials=4.0):
    """A fit with effects of so many trials' size."""
    values = {k: library.sites[k].nominal for k in keys}
    for key, value in values.items():
        value += trials * np.array([p.scale for p in library.sites[key].parameters])
    none = np.zeros((WINDOWS, SIZE))
    at = Linearisation(
        base=Hypothesis(values), residual=none, tangents=none, nuisances=(), chosen=~HELD
    )
    return Fit(free=frozenset(keys), cost=0.0, at=at)


def contender(library, key, cost):
    return Contender(key=key, fit=a_fit(library, key), cost=np.broadcast_to(cost, WINDOWS))


def a_round(contenders, base=10.0, threshold=0.0):
    base = np.broadcast_to(base, WINDOWS).astype(float)
    return Round(base=base, candidates=(), contenders=tuple(contenders), threshold=threshold)


def a_search(problem, named, contenders=(), specimen=None):
    return Search(
        problem=problem,
        baseline=a_fit(problem.library),
        fit=a_fit(problem.library, *named),
        named=tuple(named),
        rounds=(a_round(contenders),),
        specimen=specimen,
    )


def a_gap(**levels):
    given = {"before": 10.0, "baseline": 10.0, "after": 1.0, "held_out": ("c",), **levels}
    return Gap(**given)


def exact(problem, named, contenders=()):
    rng = np.random.default_rng(0)
    found = a_search(problem, named, contenders)
    return naming.judge_exact(found, rng)


def rough_ties(found, key):
    def weigh(own, rivals):
        return naming._by_posterior(found.problem, own, rivals)

    return naming._ties(found, key, weigh)


def ripple(mean, size=0.3, seed=0):
    """Costs of windows that scatter."""
    scatter = np.random.default_rng(seed).normal(0.0, size, WINDOWS)
    return mean + scatter - scatter.mean()


# The eight faults of the judging of exact models.


@pytest.mark.parametrize(("left", "expected"), [(1.6, "named"), (3.0, "partial")])
def test_an_effect_that_leaves_more_than_noise_is_no_explanation(sketch, left, expected):
    sketch.costs |= {frozenset(): 30.0, frozenset([OFFSET]): left}
    said, (effect,), _ = exact(sketch, [OFFSET], [contender(sketch.library, OFFSET, left)])
    assert said == expected
    assert effect.confidence == 1.0 if left < 2.0 else effect.confidence < 0.8


@pytest.mark.parametrize(("left", "expected"), [(1.6, "nothing_missing"), (3.0, "unexplained")])
def test_what_is_left_without_any_name_is_told(sketch, left, expected):
    sketch.costs[frozenset()] = left
    assert exact(sketch, [])[0] == expected


def test_a_rival_that_wins_every_fifth_resample_is_not_told_apart(sketch):
    own = ripple(1.0)
    # The difference is 0.9 of its standard error: it turns round in 18 of 100 resamples.
    rival = own + ripple(0.9 * 0.3 / np.sqrt(WINDOWS), seed=1)
    sketch.costs |= {frozenset(): 30.0, frozenset([OFFSET]): own}
    tried = [contender(sketch.library, k, c) for k, c in ((OFFSET, own), (COULOMB, rival))]
    said, (effect,), _ = exact(sketch, [OFFSET], tried)
    assert said == "confusion_set"
    assert effect.indistinguishable_from == ("coulomb_friction",)
    assert 0.6 < effect.confidence < 0.95


def test_a_rival_that_costs_the_same_is_not_told_apart_however_surely(sketch):
    own = np.full(WINDOWS, 1.0)
    sketch.costs |= {frozenset(): 30.0, frozenset([OFFSET]): own}
    tried = [contender(sketch.library, k, c) for k, c in ((OFFSET, own), (COULOMB, own + 0.005))]
    said, (effect,), _ = exact(sketch, [OFFSET], tried)
    assert said == "confusion_set"
    assert effect.confidence <= 0.5


def test_a_gain_that_does_not_hold_where_held_out_is_not_accepted(sketch):
    """The gain on the fitted windows is the same; held out, it comes and goes."""
    base = np.full(WINDOWS, 10.0)
    saves = base - ripple(5.0)
    fails = np.where(HELD, base + ripple(0.0, size=3.0), saves)
    chosen = contender(sketch.library, OFFSET, saves)
    assert accepted(sketch, a_round([chosen], base), chosen)
    overfitted = contender(sketch.library, OFFSET, fails)
    assert not accepted(sketch, a_round([overfitted], base), overfitted)


def test_a_rough_machine_may_hide_a_gain_where_held_out_but_not_lose_by_it(sketch):
    """A slow held-out recording hardly shows the effect."""
    base = np.full(WINDOWS, 10.0)
    hidden = base - np.where(HELD, 0.05 + ripple(0.0, size=1.0), ripple(5.0))
    lost = np.where(HELD, base + 0.5 + ripple(0.0, size=1.0), base - ripple(5.0))
    hidden[HELD] += 9.95 - hidden[HELD].mean()
    chosen, worse = (contender(sketch.library, OFFSET, cost) for cost in (hidden, lost))
    assert not accepted(sketch, a_round([chosen], base), chosen)
    sketch.noise.discrepancy = a_discrepancy()
    assert accepted(sketch, a_round([chosen], base), chosen)
    assert not accepted(sketch, a_round([worse], base), worse)


def test_a_gain_that_chance_gives_is_not_accepted(sketch):
    base = ripple(10.0)
    found = contender(sketch.library, OFFSET, base - 2.0)
    gain = SIZE * 2.0 * (~HELD).sum()
    assert accepted(sketch, a_round([found], base, threshold=0.9 * gain), found)
    assert not accepted(sketch, a_round([found], base, threshold=1.1 * gain), found)


def test_a_gain_that_does_not_matter_is_not_accepted(sketch):
    base = np.full(WINDOWS, 30.0)
    found = contender(sketch.library, OFFSET, base - 0.05)
    assert not accepted(sketch, a_round([found], base), found)
    # Nor is a strength that nobody would notice.
    large = contender(sketch.library, OFFSET, base - ripple(9.0))
    assert accepted(sketch, a_round([large], base), large)
    tiny = Hypothesis({OFFSET: 0.03 * large.fit.hypothesis[OFFSET]})
    weak = replace(large, fit=large.fit.with_hypothesis(tiny))
    assert not accepted(sketch, a_round([weak], base), weak)


def linear(library, rng, shared=0.0):
    """A linear problem with unit noise, fitted: the problem, its fit, and the error of the fit.

    `shared` is the size of what all windows of a recording have in common.
    """
    recording = np.repeat(np.arange(4), WINDOWS // 4)
    slope = rng.normal(size=(WINDOWS, SIZE))
    noise = rng.normal(size=slope.shape) + shared * rng.normal(size=4)[recording, None] * slope
    scale = library.sites[OFFSET].parameters[0].scale

    def residual(hypothesis, chosen=None):
        return noise + slope * hypothesis[OFFSET][0] / scale

    best = -scale * (slope * noise).sum() / (slope**2).sum()
    base = Hypothesis({OFFSET: np.array([best])})
    at = Linearisation(
        base=base,
        residual=residual(base),
        tangents=np.zeros((WINDOWS, SIZE, 0)),
        nuisances=(),
        chosen=np.ones(WINDOWS, dtype=bool),
    )
    problem = SimpleNamespace(
        library=library,
        thresholds=replace(DEFAULT, robust_limit=1e9),
        replay=SimpleNamespace(recording=recording),
        residual=residual,
    )
    return problem, Fit(free=frozenset([OFFSET]), cost=0.0, at=at), best


@pytest.mark.parametrize(("shared", "cases"), [(0.0, 0.92), (0.2, 0.85)])
def test_intervals_hold_the_truth_in_nineteen_of_twenty_cases(library, shared, cases):
    rng = np.random.default_rng(5)
    held, widths = [], []
    for _ in range(150):
        problem, fit, error = linear(library, rng, shared)
        half = float(intervals(problem, fit)[OFFSET][0])
        held.append(abs(error) <= half)
        widths.append(half)
    assert np.mean(held) > cases  # of four recordings only where they share errors
    if not shared:
        sure = 1.96 * library.sites[OFFSET].parameters[0].scale / np.sqrt(WINDOWS * SIZE)
        assert np.median(widths) < 2.5 * sure


def outcome(kind, hidden, named, confidence, said="named"):
    return Outcome(
        kind=kind,
        number=0,
        hidden=hidden,
        severities=(),
        verdict=said,
        named=named,
        alternatives=((),) * len(named),
        confidence=confidence,
        covered=(),
        onsets=(),
        before=2.0,
        after=1.0,
        seconds=1.0,
    )


@pytest.mark.parametrize(
    ("confidence", "said", "honest"),
    [(0.95, "named", False), (0.6, "partial", False), (0.3, "partial", True)],
)
def test_a_wrong_name_given_with_confidence_is_no_doubt(confidence, said, honest):
    one = outcome("removed", ("a",), ("b",), (confidence,), said)
    assert one.honest == honest
    rows = {row[0]: row[1] for row in scores([one])}
    assert rows["effect unknown to the library: doubt"] == ("1 (100%)" if honest else "0 (0%)")
    sure = "1 (100%)" if confidence > 0.9 else "0 (0%)"
    assert rows["... and a wrong name given for sure"] == sure


def test_a_wrong_name_of_a_single_fault_counts_as_wrong():
    rows = {r[0]: r[1] for r in scores([outcome("single", ("a",), ("b",), (0.2,), "partial")])}
    assert rows["single effect named first"] == "0 (0%)"
    assert rows["single effect named or in a set of 3"] == "0 (0%)"
    rows = {r[0]: r[1] for r in scores([outcome("null", (), ("b",), (0.2,), "partial")])}
    assert rows["false alarms where nothing is hidden"] == "1 (100%)"


# Ties with a special case.


@pytest.mark.parametrize(
    ("saved_fitted", "saved_held", "first"),
    [(0.002, 0.002, VISCOUS), (0.5, 0.0, VISCOUS), (0.5, 0.5, ASYMMETRIC)],
    ids=["chance", "not where held out", "earned"],
)
def test_a_special_case_comes_before_an_effect_that_earns_no_more(
    sketch, saved_fitted, saved_held, first
):
    saved = np.where(HELD, saved_held, saved_fitted) * (1.0 + ripple(0.0, size=0.1))
    larger = contender(sketch.library, ASYMMETRIC, 1.0)
    special = contender(sketch.library, VISCOUS, 1.0 + saved)
    assert simplest_first(sketch, (larger, special))[0].key == first


def test_a_larger_effect_that_earns_no_more_is_no_rival(sketch):
    own = contender(sketch.library, VISCOUS, 1.0)
    larger = contender(sketch.library, ASYMMETRIC, 0.999)
    found = a_search(sketch, [VISCOUS], [own, larger])
    assert rough_ties(found, VISCOUS) == ((), 1.0)


def test_rivals_that_share_a_name_are_told_by_their_elements(sketch):
    valve = "asymmetric_friction", "valve"
    tried = [SimpleNamespace(key=key) for key in (ASYMMETRIC, OFFSET, valve)]
    wanted = ("asymmetric_friction at hinge", "force_offset", "asymmetric_friction at valve")
    assert verdict._labels(tried) == wanted


# Probability of a name on a rough machine.


def test_posterior_is_a_distribution_that_no_unit_changes():
    rng = np.random.default_rng(0)
    for _ in range(30):
        costs = rng.uniform(0.3, 5.0, rng.integers(1, 6))
        share = posterior(costs, 20.0)
        assert share.sum() == pytest.approx(1.0)
        assert (share >= 0.0).all()
        assert (np.argsort(share) == np.argsort(-costs)).all()
        np.testing.assert_allclose(posterior(7.0 * costs, 20.0), share, rtol=1e-9)
    assert posterior([1.0, 2.0], 8.0)[0] == pytest.approx(1.0 / (1.0 + 2.0**-4.0))
    np.testing.assert_allclose(posterior([0.0, 1.0], 30.0), [1.0, 0.0], atol=1e-9)


def test_posterior_of_the_best_grows_with_its_margin_and_with_the_numbers():
    by_margin = [posterior([1.0, m], 30.0)[0] for m in (1.0, 1.1, 1.5, 3.0)]
    by_numbers = [posterior([1.0, 1.1], n)[0] for n in (0.0, 10.0, 30.0, 100.0)]
    assert by_margin[0] == by_numbers[0] == 0.5
    assert (np.diff(by_margin) > 0.0).all()
    assert (np.diff(by_numbers) > 0.0).all()


def test_confidence_of_a_rough_name_depends_on_its_margin(sketch):
    def confidence(margin):
        tried = [contender(sketch.library, k, c) for k, c in ((OFFSET, 1.0), (COULOMB, margin))]
        return rough_ties(a_search(sketch, [OFFSET], tried), OFFSET)

    tied, narrow = confidence(1.02)
    assert tied == ("coulomb_friction",)
    assert 0.5 < narrow < 0.75
    assert narrow < confidence(1.1)[1] < confidence(1.5)[1]
    assert confidence(3.0)[0] == ()
    assert confidence(3.0)[1] > 0.95


def test_confidence_of_a_rough_name_depends_on_what_it_explains(sketch):
    def confidence(after):
        sketch.costs |= {frozenset(): 10.0**2, frozenset([OFFSET]): after**2}
        _, causes, _ = rough_verdict(sketch, [OFFSET], a_gap(unnamed=10.0, after=after))
        return causes[0].confidence

    assert confidence(1.0) > 0.99
    assert confidence(3.0) > 0.9
    assert confidence(5.5) == pytest.approx(0.5)
    assert confidence(8.5) < 0.1


# What is named on a rough machine.


def rough_verdict(problem, named, gap, specimen=None):
    found = a_search(problem, named, specimen=specimen)

    def level(hypothesis):
        return naming.rms(problem.noise_levels(hypothesis)[problem.held])

    return naming.judge_rough(found, gap, level)


def test_what_closes_a_twentieth_of_the_gap_is_a_smaller_difference(sketch):
    after = 4.0
    both, one, other = frozenset([OFFSET, VISCOUS]), frozenset([OFFSET]), frozenset([VISCOUS])
    # Levels are squares; without the friction 0.3 of the 6 noise levels of the gap open.
    sketch.costs |= {both: after**2, one: 4.3**2, other: 9.9**2}
    gap = a_gap(unnamed=10.0, after=after, healthy=4.0)
    said, causes, smaller = rough_verdict(sketch, [VISCOUS, OFFSET], gap)
    assert said == "named"
    assert [e.name for e in causes] == ["force_offset"]
    assert [e.name for e in smaller] == ["viscous_friction"]
    assert smaller[0].contribution == pytest.approx(0.3 / 6.0)


def test_smaller_differences_alone_name_nothing(sketch):
    sketch.costs |= {frozenset(): 10.0**2, frozenset([OFFSET]): 9.8**2}
    said, causes, smaller = rough_verdict(sketch, [OFFSET], a_gap(unnamed=10.0, after=9.8))
    assert (said, causes, len(smaller)) == ("unexplained", (), 1)


@pytest.mark.parametrize(("after", "expected"), [(2.0, "named"), (7.0, "unexplained")])
def test_a_cause_that_explains_less_than_half_is_no_explanation(sketch, after, expected):
    sketch.costs |= {frozenset(): 10.0**2, frozenset([OFFSET]): after**2}
    said, causes, _ = rough_verdict(sketch, [OFFSET], a_gap(unnamed=10.0, after=after))
    assert (said, len(causes)) == (expected, 1)


@pytest.mark.parametrize(("cost", "expected"), [(1.2, "nothing_missing"), (9.0, "unexplained")])
def test_a_machine_lacks_nothing_only_while_it_errs_as_when_healthy(sketch, cost, expected):
    sketch.costs[frozenset()] = cost
    specimen = SimpleNamespace(discrepancy_of=lambda series: None)
    assert rough_verdict(sketch, [], a_gap(), specimen)[0] == expected
    assert rough_verdict(sketch, [], a_gap())[0] == "unexplained"


def test_explained_is_that_over_all_where_held_out_hardly_shows_it():
    """A slow held-out recording does not show a fault of fast motion."""
    assert a_gap(unnamed=31.8, after=31.9, healthy=30.8).explained == 0.0
    gap = a_gap(unnamed=31.8, after=31.9, healthy=30.8, compared=(180.0, 21.0, 20.0))
    assert gap.explained == pytest.approx(159.0 / 160.0)


def test_explained_is_the_share_of_what_the_healthy_machine_did_not_show():
    assert a_gap(unnamed=10.0, after=4.0, healthy=4.0).explained == 1.0
    assert a_gap(unnamed=10.0, after=7.0, healthy=4.0).explained == pytest.approx(0.5)
    assert a_gap(unnamed=10.0, after=4.0).explained == pytest.approx(6.0 / 9.0)
    assert a_gap(unnamed=10.0, after=3.0, healthy=4.0).explained == 1.0
    assert a_gap(unnamed=10.0, after=11.0, healthy=4.0).explained == 0.0
    assert a_gap(unnamed=4.0, after=4.0, healthy=4.0).explained is None
    assert a_gap(after=4.0).explained is None


@pytest.mark.parametrize(("trials", "expected"), [(0.9, "unexplained"), (3.0, "named")])
def test_what_a_good_machine_may_have_is_no_fault_unless_healthy_recordings_lack_it(
    sketch, trials, expected
):
    sketch.costs |= {frozenset(): 10.0**2, frozenset([OFFSET]): 1.0}
    found = replace(a_search(sketch, [OFFSET]), fit=a_fit(sketch.library, OFFSET, trials=trials))
    gap = a_gap(unnamed=10.0)

    def level(hypothesis):
        return naming.rms(sketch.noise_levels(hypothesis))

    said, causes, smaller = naming.judge_rough(found, gap, level)
    assert (said, len(causes), len(smaller)) == (expected, trials > 1.0, trials < 1.0)
    known = replace(found, specimen=SimpleNamespace(discrepancy_of=lambda series: None))
    said, (cause,), _ = naming.judge_rough(known, gap, level)
    assert said == "named"
    assert cause.confidence > 0.99


def test_a_departure_is_a_fault_the_more_probably_the_larger_it_is():
    shares = [beyond_specimens(d) for d in (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)]
    assert (np.diff(shares) > 0.0).all()
    assert shares[2] < 0.5 < shares[3]
    assert shares[4] > 0.9
    # Bayes' rule with even odds: |d| normal about the model, or anywhere up to five trials.
    own = 2.0 * norm.pdf(1.0, scale=DEFAULT.specimen_spread)
    assert shares[2] == pytest.approx(0.2 / (0.2 + own))


def test_a_tenth_of_the_bandwidth_is_as_severe_as_the_trials_that_it_passes():
    bandwidth = EffectParameter("f", "Hz", nominal=250.0, upper=500.0, trials=(12.5, 30.0, 87.5))
    assert bandwidth.departure(250.0, 250.0) == 0.0
    assert bandwidth.departure(168.75, 250.0) == pytest.approx(0.5)
    assert bandwidth.departure(30.0, 250.0) == pytest.approx(2.0)
    assert bandwidth.departure(12.5, 250.0) == pytest.approx(3.0)
    # A long way in smallest trials counts as such, on a side without trials as well.
    assert bandwidth.departure(500.0, 250.0) == pytest.approx(250.0 / 162.5)


def test_parameters_cost_a_rough_explanation_its_probability():
    few, many = posterior([1.0, 0.9], 30.0, [1, 4])
    assert few > many
    assert posterior([1.0, 0.5], 30.0, [1, 4])[1] > 0.95
    np.testing.assert_allclose(posterior([1.0, 0.9], 30.0, [2, 2]), posterior([1.0, 0.9], 30.0))
    # Schwarz 1978: half the logarithm of the numbers for every parameter.
    assert many / few == pytest.approx(0.9**-15.0 * 30.0**-1.5)


# Exact or rough.


@pytest.fixture
def searches(sketch, monkeypatch):
    """What the searches find: what they leave, in squares of noise levels, by the effects."""
    left = {(): 900.0, (OFFSET,): 400.0, (OFFSET, VISCOUS): 4.0, (OFFSET, VISCOUS, COULOMB): 1.0}
    sketch.costs |= {frozenset(keys): cost for keys, cost in left.items()}
    rough_problem = SimpleNamespace(**{**vars(sketch), "noise": SimpleNamespace(discrepancy=1)})
    found = {"rough": (OFFSET, VISCOUS), "exact": (OFFSET,), "again": (OFFSET, VISCOUS, COULOMB)}

    def exact(problem, settings, progress, begun=None):
        if begun is not None:
            assert begun.named == found["rough"]
        return a_search(problem, found["exact" if begun is None else "again"])

    def rough_one(problem, settings, progress, specimen, floor):
        return a_search(rough_problem, found["rough"])

    monkeypatch.setattr(workflow, "_exact_search", exact)
    monkeypatch.setattr(workflow, "_rough_search", rough_one)
    return found


def test_several_gross_faults_of_an_exact_machine_are_all_found(sketch, searches):
    found = workflow.search(sketch, workflow.DiagnosisSettings())
    assert found.named == searches["again"]
    assert not found.rough


def test_a_search_does_not_go_on_as_exact_where_that_leaves_more_than_noise(sketch, searches):
    sketch.costs[frozenset(searches["again"])] = 3.0
    assert workflow.search(sketch, workflow.DiagnosisSettings()).named == searches["rough"]


def test_a_search_goes_on_as_exact_only_where_little_is_left(sketch, searches):
    sketch.costs[frozenset(searches["rough"])] = 50.0
    found = workflow.search(sketch, workflow.DiagnosisSettings())
    assert found.named == searches["rough"]
    assert found.rough


# The discrepancy of the model.


def memory(bins, reach):
    """Covariance that fades with the distance."""
    return np.exp(-np.abs(np.subtract.outer(np.arange(bins), np.arange(bins))) / reach)


def a_discrepancy(bins=12, reach=4.0):
    pattern = np.stack([memory(bins, reach), np.eye(bins)])
    return Discrepancy(pattern=pattern, variance=np.array([[1.0, 4.0], [9.0, 0.0]]))


def test_the_covariance_of_a_discrepancy_is_one_and_scales():
    found = a_discrepancy().covariance(np.array([1, 0, 1]))
    assert found.shape == (3, 24, 24)
    np.testing.assert_array_equal(found, found.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(found).min() > -1e-9
    np.testing.assert_array_equal(found[0], found[2])
    np.testing.assert_allclose(found[0][:12, :12], 9.0 * memory(12, 4.0))
    np.testing.assert_allclose(found[1][12:, 12:], 4.0 * np.eye(12))
    assert not found[:, :12, 12:].any()  # channels err on their own
    twice = a_discrepancy().scaled(2.0).covariance(np.array([1, 0, 1]))
    np.testing.assert_allclose(twice, 2.0 * found)


def test_errors_show_the_discrepancy_that_they_were_drawn_from():
    rng = np.random.default_rng(2)
    bins, truth = 12, a_discrepancy(reach=1.5)
    variance = np.array([[1.0, 4.0], [9.0, 0.25]])
    recording = np.repeat([0, 1], 300)
    roots = np.linalg.cholesky(truth.pattern)
    errors = np.einsum("kij,wkj->wki", roots, rng.normal(size=(600, 2, bins)))
    errors *= np.sqrt(variance)[recording][:, :, None]
    found = from_errors(errors, recording, np.ones((2, 2)))
    np.testing.assert_allclose(found.pattern, truth.pattern, atol=0.15)
    assert found.pattern[0, 5, 6] > 0.3 > abs(found.pattern[1, 5, 6])
    np.testing.assert_allclose(np.trace(found.pattern, axis1=1, axis2=2), bins)
    # The middle of windows lies below their mean, most where a window is few numbers.
    assert (found.variance < 1.05 * variance).all()
    assert (found.variance > 0.6 * variance).all()
    # A wild window does not change what is usual.
    errors[7] *= 1e3
    wild = from_errors(errors, recording, np.ones((2, 2)))
    np.testing.assert_allclose(wild.variance, found.variance, rtol=0.05)
    np.testing.assert_allclose(wild.pattern, found.pattern, atol=0.05)


def test_errors_that_sensors_explain_show_no_discrepancy():
    errors = np.random.default_rng(3).normal(size=(50, 2, 12))
    found = from_errors(errors, np.zeros(50, dtype=int), np.zeros((1, 2)))
    assert not found.variance.any()
    assert not found.covariance(np.zeros(5, dtype=int)).any()


def test_errors_of_noise_and_discrepancy_are_white():
    rng = np.random.default_rng(4)
    windows, size = 2000, 24
    root = 0.3 * rng.normal(size=(size, size)) + np.eye(size)
    covariance = np.broadcast_to(root @ root.T, (windows, size, size))
    sensors = np.linalg.inv(np.linalg.cholesky(covariance))
    noise = NoiseModel(
        defect=np.zeros(0), whitening=sensors, sensors=sensors, covariance=covariance
    )
    recording = np.arange(windows) % 2
    trusting = noise.trusting(a_discrepancy(), recording)
    whole = np.linalg.cholesky(covariance + a_discrepancy().covariance(recording))
    errors = whole @ rng.normal(size=(windows, size, 1))
    white = (trusting.whitening @ errors)[:, :, 0]
    np.testing.assert_allclose(np.cov(white.T), np.eye(size), atol=0.12)
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.03)
    assert np.mean((noise.whitening @ errors) ** 2) > 1.5
    again = trusting.trusting(None, recording)
    assert again.discrepancy is None
    np.testing.assert_array_equal(again.whitening, sensors)


def test_a_discrepancy_is_floored_channel_by_channel():
    floor = replace(a_discrepancy(), variance=np.array([[2.0, 2.0], [2.0, 2.0]]))
    found = at_least(a_discrepancy(), floor)
    np.testing.assert_array_equal(found.variance, [[2.0, 4.0], [9.0, 2.0]])
    kept = at_least(a_discrepancy(), None)
    np.testing.assert_array_equal(kept.variance, a_discrepancy().variance)


def test_a_baseline_and_its_discrepancy_are_fitted_in_turn(monkeypatch):
    """Each fit leaves a quarter of the error, down to 1; the discrepancy follows it."""
    level, trusted = [64.0], []

    def estimated(hypothesis):
        return Discrepancy(pattern=np.eye(2)[None], variance=np.array([[level[0]]]))

    problem = SimpleNamespace(
        thresholds=DEFAULT,
        discrepancy=estimated,
        linearise=lambda hypothesis, chosen: None,
        noise_levels=lambda hypothesis: np.array([level[0]]),
    )

    def trusting(discrepancy):
        trusted.append(float(discrepancy.variance[0, 0]))
        return problem

    def fitted(problem, at, free, iterations):
        level[0] = max(1.0, 0.25 * level[0])
        return SimpleNamespace(hypothesis=Hypothesis())

    problem.trusting = trusting
    monkeypatch.setattr(rough, "refit", fitted)
    settled_baseline(problem, np.ones(3, dtype=bool))
    assert trusted == [64.0, 16.0, 4.0, 1.0]
    level[0] = 64.0
    trusted.clear()
    settled_baseline(problem, np.ones(3, dtype=bool), estimated(None).scaled(0.1))
    assert trusted == [64.0, 16.0, 6.4, 6.4]


def test_a_round_is_judged_under_the_discrepancy_of_its_best(sketch, monkeypatch):
    """A rival that the last estimate hid takes the lead, and the discrepancy is made anew."""
    levels, trusted = {OFFSET: 25.0, COULOMB: 4.0}, []

    def level(hypothesis):
        return levels[next(iter(hypothesis))]

    def trusting(discrepancy):
        trusted.append(float(discrepancy.variance[0, 0]))
        return sketch

    def under(problem, before, contender):
        cost = np.full(WINDOWS, level(contender.fit.hypothesis) / trusted[-1])
        return replace(contender, cost=cost)

    def estimated(hypothesis):
        return Discrepancy(pattern=np.eye(2)[None], variance=np.array([[level(hypothesis)]]))

    sketch.noise_levels = lambda hypothesis: np.full(WINDOWS, level(hypothesis))
    sketch.trusting, sketch.discrepancy = trusting, estimated
    monkeypatch.setattr(rough, "_under", under)
    monkeypatch.setattr(rough, "total_cost", lambda problem, fit: np.full(WINDOWS, 30.0))
    tried = a_round([contender(sketch.library, k, 1.0) for k in (OFFSET, COULOMB)])
    _, judged = rough.annealed(sketch, a_fit(sketch.library), tried, None)
    assert trusted == [25.0, 4.0]
    assert [c.key for c in judged.contenders] == [COULOMB, OFFSET]
    assert judged.contenders[0].cost.mean() == 1.0
    assert judged.base.mean() == 30.0
    trusted.clear()
    rough.annealed(sketch, a_fit(sketch.library), tried, estimated({COULOMB: 0}).scaled(4.0))
    assert trusted == [25.0, 16.0]


@pytest.mark.parametrize(("threshold", "expected"), [(100.0, [OFFSET]), (1e6, [])])
def test_a_rough_search_names_only_what_is_accepted(sketch, monkeypatch, threshold, expected):
    base = ripple(10.0)
    tried = a_round([contender(sketch.library, OFFSET, base - 5.0)], base, threshold)
    fitted = []

    def settled(problem, chosen, floor):
        fitted.append(chosen)
        return problem, a_fit(sketch.library)

    monkeypatch.setattr(rough, "settled_baseline", settled)
    monkeypatch.setattr(rough, "search_round", lambda problem, *_: (problem, tried))
    monkeypatch.setattr(rough, "annealed", lambda problem, *_: (problem, tried))
    sketch.with_nuisances = lambda nuisances: sketch
    sketch.discrepancy = lambda hypothesis: a_discrepancy()
    rng = np.random.default_rng(0)
    *_, named, rounds = rough.rough_search(sketch, 1, rng, lambda _: None)
    assert named == expected
    assert rounds == [tried]
    assert fitted[0].any()
    assert not (fitted[0] & HELD).any()


# The specimen at hand.


@pytest.fixture(scope="module")
def own():
    return {OFFSET: np.array([0.3]), VISCOUS: np.array([0.1])}


def test_a_library_is_about_the_values_of_its_specimen(machine, library, own):
    for about in (Library(machine, specimen=own), library.of_specimen(own)):
        assert about.sites[OFFSET].nominal == [0.3]
        assert about.sites[OFFSET].model == [0.0]
        assert about.sites[COULOMB].nominal == [0.0]
        assert dict(about.neutral()) == {OFFSET: [0.0], VISCOUS: [0.08]}
        assert about.whole({OFFSET: np.array([0.5])}) == {OFFSET: [0.5], VISCOUS: [0.1]}
        assert about.whole({}) == own
        same = about.change({}, machine).edits, library.change(own, machine).edits
        assert len(same[0]) == len(same[1]) > 0
    assert library.sites[OFFSET].nominal == [0.0]  # the first one stays as it was
    assert not library.neutral()
    unused = Library(machine, names=["payload"], specimen=own)
    assert unused.names == ("payload",)
    assert OFFSET in unused.sites


def test_effects_depart_from_the_specimen_and_not_from_the_model(machine, own):
    about = Library(machine, specimen=own)
    problem = SimpleNamespace(library=about, thresholds=DEFAULT)
    assert not noticeable(problem, OFFSET, {OFFSET: np.array([0.3])})
    assert noticeable(problem, OFFSET, {OFFSET: np.array([0.0])})
    trials = [float(t[0]) for t in about.sites[OFFSET].trials()]
    offs = [-0.4143, -0.08286, 0.08286, 0.4143]
    assert trials == pytest.approx([0.3 + off for off in offs])
    for nuisances in (
        within_tolerance(about),
        rough_nuisances(about, 0.3),
        specimen_nuisances(about, 3.0),
    ):
        priors = {n.key: n.nominal for n in nuisances}
        assert priors[VISCOUS] == 0.1
    assert priors[OFFSET] == 0.3
