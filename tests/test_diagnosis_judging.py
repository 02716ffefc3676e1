"""The judging is judged: each fault that was once put into it turns one of these tests red.

Here: acceptance, intervals, and names on exact models.
docs/diagnosis.md, "How the judging is tested", lists the faults beside the tests.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import t as student

from leglab.diagnosis import verdict
from leglab.diagnosis.fitting import Fit
from leglab.diagnosis.hypothesis import Hypothesis
from leglab.diagnosis.judging import (
    _sandwich,
    accepted,
    intervals,
    simplest_first,
    t_value,
)
from leglab.diagnosis.residual import Linearisation
from leglab.diagnosis.thresholds import DEFAULT
from leglab.studies.blind.selftest import Outcome, scores
from tests.diagnosis_sketch import (
    ASYMMETRIC,
    COULOMB,
    HELD,
    LIBRARY,
    OFFSET,
    SIZE,
    VISCOUS,
    WINDOWS,
    a_discrepancy,
    a_round,
    a_search,
    a_sketch,
    contender,
    exact_verdict,
    ripple,
    rough_ties,
)


@pytest.fixture
def sketch(monkeypatch):
    return a_sketch(monkeypatch)


@pytest.fixture(scope="module")
def library():
    return LIBRARY


# The eight faults of the judging of exact models.


@pytest.mark.parametrize(
    ("left", "expected"), [(1.6, "named"), (3.0, "partial"), (6.0, "unexplained")]
)
def test_an_effect_that_leaves_more_than_noise_is_no_explanation(sketch, left, expected):
    sketch.costs |= {frozenset(): 30.0, frozenset([OFFSET]): left}
    said, (effect,), _ = exact_verdict(sketch, [OFFSET], [contender(sketch.library, OFFSET, left)])
    assert said == expected
    assert effect.confidence == 1.0 if left < 2.0 else effect.confidence < 0.8


@pytest.mark.parametrize(("left", "expected"), [(1.6, "nothing_missing"), (3.0, "unexplained")])
def test_what_is_left_without_any_name_is_told(sketch, left, expected):
    sketch.costs[frozenset()] = left
    assert exact_verdict(sketch, [])[0] == expected


def test_a_rival_that_wins_every_fifth_resample_is_not_told_apart(sketch):
    own = ripple(1.0)
    # The difference is 0.9 of its standard error: it turns round in 18 of 100 resamples.
    rival = own + ripple(0.9 * 0.3 / np.sqrt(WINDOWS), seed=1)
    sketch.costs |= {frozenset(): 30.0, frozenset([OFFSET]): own}
    tried = [contender(sketch.library, k, c) for k, c in ((OFFSET, own), (COULOMB, rival))]
    said, (effect,), _ = exact_verdict(sketch, [OFFSET], tried)
    assert said == "confusion_set"
    assert effect.indistinguishable_from == ("coulomb_friction",)
    assert 0.6 < effect.confidence < 0.95


def test_a_rival_that_costs_the_same_is_not_told_apart_however_surely(sketch):
    own = np.full(WINDOWS, 1.0)
    sketch.costs |= {frozenset(): 30.0, frozenset([OFFSET]): own}
    tried = [contender(sketch.library, k, c) for k, c in ((OFFSET, own), (COULOMB, own + 0.005))]
    said, (effect,), _ = exact_verdict(sketch, [OFFSET], tried)
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


@pytest.mark.parametrize(("t", "right"), [(3.3, False), (4.2, True)])
def test_the_best_of_many_effects_must_say_more_than_a_single_one(sketch, t, right):
    """Bonferroni: of 70 effects chance reaches t = 3.6 in 1 of 100 cases, a single one 2.3."""
    sketch.noise.discrepancy = a_discrepancy()
    base = np.full(WINDOWS, 10.0)
    shape = np.where(HELD, 0.2 * ripple(0.0), 8.0 + ripple(0.0, size=1.0))
    shape[HELD] += 0.01 - shape[HELD].mean()
    low, high = 0.0, 100.0
    for _ in range(60):  # the scatter that gives this t
        size = 0.5 * (low + high)
        saved = shape + size * np.where(HELD, 0.0, ripple(0.0, seed=1))
        low, high = (size, high) if t_value(saved) > t else (low, size)
    assert t_value(saved) == pytest.approx(t, rel=1e-3)
    found = contender(sketch.library, OFFSET, base - saved)
    assert accepted(sketch, a_round([found], base), found)
    assert accepted(sketch, a_round([found], base, tried=70), found) == right


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


def test_what_may_be_off_beside_an_effect_widens_its_interval_by_as_much():
    """Closed form: a twin of prior standard deviation s adds s^2 to the variance 1/(g'g)."""
    g2, s, windows = 400.0, 0.3, 50
    matrix = np.array([[g2, g2 * s], [g2 * s, g2 * s**2]])
    matrices = np.broadcast_to(matrix / windows, (windows, 2, 2))
    quiet = np.zeros((windows, 2))
    first = np.eye(1)
    half = _sandwich(matrices, quiet, np.diag([0.0, 1.0]), first)[0]
    quantile = student.ppf(0.975, windows - 1)
    assert half == pytest.approx(quantile * np.sqrt(1.0 / g2 + s**2), rel=1e-6)
    alone = _sandwich(matrices[:, :1, :1], quiet[:, :1], np.zeros((1, 1)), first)[0]
    assert alone == pytest.approx(quantile / np.sqrt(g2), rel=1e-6)
