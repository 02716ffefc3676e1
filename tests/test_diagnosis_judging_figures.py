"""Figures of the judging against closed forms, brute force and scipy.

No verdict is told here: tests/test_diagnosis_verdicts.py does that from recordings. Costs of
windows are given where it matters by how much they differ.
"""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize, stats

from leglab.diagnosis.effects.base import EffectParameter
from leglab.diagnosis.effects.hypothesis import Hypothesis, Library
from leglab.diagnosis.former import judging, naming
from leglab.diagnosis.former.evidence import beyond_specimens, posterior, within_library
from leglab.diagnosis.former.fitting import Fit, Sums, free_tangents
from leglab.diagnosis.former.judging import (
    accepted,
    earns,
    fault_probability,
    nothing_more,
    noticeable,
    preferences,
    probabilities,
    rarely_but_surely,
    simplest_first,
    specimens_spread,
    t_value,
)
from leglab.diagnosis.former.screening import Candidate
from leglab.diagnosis.former.search import Contender, Round, total_cost
from leglab.diagnosis.search.pipeline import DiagnosisSettings, set_up
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.replay.residual import Linearisation
from leglab.diagnosis.result import Gap
from leglab.diagnosis.thresholds import DEFAULT, Thresholds
from leglab.diagnosis.verdict.verdict import assemble, diagnose
from leglab.studies.blind.selftest import Outcome, scores
from tests.rigs import PENDULUM, Truth, record

OFFSET, VISCOUS = ("force_offset", "hinge"), ("viscous_friction", "hinge")
ASYMMETRIC, COULOMB = ("asymmetric_friction", "hinge"), ("coulomb_friction", "hinge")
MACHINE = Machine(PENDULUM.model)
LIBRARY = Library(MACHINE)


def a_gap(**levels):
    given = {"before": 10.0, "baseline": 10.0, "after": 1.0, "held_out": ("c",), **levels}
    return Gap(**given)


@pytest.mark.parametrize("count", [2, 3, 40])
def test_the_t_value_is_that_of_paired_differences(count):
    difference = np.random.default_rng(count).normal(0.4, 1.0, count)
    assert t_value(difference) == pytest.approx(stats.ttest_1samp(difference, 0.0).statistic)


def test_one_difference_and_such_as_do_not_scatter_say_nothing():
    with np.errstate(all="raise"):
        assert t_value(np.array([3.0])) == 0.0
        assert t_value(np.full(8, 3.0)) == 0.0


def test_preferences_are_shares_of_resampled_sets_and_ties_count_half():
    random = np.random.default_rng(0)
    costs = random.uniform(1.0, 3.0, (3, 12))
    costs[2] = costs[1]
    found = preferences(costs, np.random.default_rng(5), 4000)
    drawn = np.random.default_rng(5).multinomial(12, np.full(12, 1 / 12), size=4000)
    for i, j in ((0, 1), (1, 0)):
        less = [float(w @ costs[i]) < float(w @ costs[j]) for w in drawn]
        assert found[i, j] == pytest.approx(np.mean(less), abs=1e-12)
    assert found[1, 2] == found[2, 1] == 0.5
    np.testing.assert_array_equal(np.diag(found), 0.5)
    # Three windows, one of which decides: it is missing in (2/3)^3 of all sets.
    decided = preferences(
        [np.zeros(3), np.array([1.0, 0.0, 0.0])], np.random.default_rng(1), 100_000
    )
    missing = (2 / 3) ** 3
    assert decided[0, 1] == pytest.approx(1 - missing + missing / 2, abs=0.005)


@pytest.mark.parametrize("numbers", [0.5, 1.0, 10.0])
def test_the_posterior_is_the_concentrated_likelihood_with_schwarzs_price(numbers):
    costs, counts = np.array([2.0, 3.0, 2.5]), np.array([3, 1, 2])
    weights = costs ** (-numbers / 2) * max(numbers, 1.0) ** (-counts / 2)
    np.testing.assert_allclose(posterior(costs, numbers, counts), weights / weights.sum())
    free = costs ** (-numbers / 2)
    np.testing.assert_allclose(posterior(costs, numbers), free / free.sum())


@pytest.mark.parametrize("departure", [0.0, 0.7, 2.0, 5.0])
def test_a_departure_is_a_fault_by_bayes_rule(departure):
    own = stats.norm(0.0, 0.8).pdf(departure) + stats.norm(0.0, 0.8).pdf(-departure)
    fault = 1.0 / 6.0  # of a departure of any size up to six
    found = beyond_specimens(departure, spread=0.8, reach=6.0)
    assert found == pytest.approx(fault / (fault + own))


@pytest.mark.parametrize(("share", "ratio"), [(0.5, 1.0), (0.75, 9.0), (0.9, 81.0)])
def test_the_cause_is_in_the_library_by_the_square_of_explained_to_unexplained(share, ratio):
    assert within_library(share, 2.0) == pytest.approx(2.0 * ratio / (1.0 + 2.0 * ratio))


def test_explained_shares_beyond_all_and_none_are_all_and_none():
    assert within_library(1.2, 3.0) == 1.0
    assert within_library(-0.3, 3.0) == 0.0


@pytest.mark.parametrize(
    ("changed", "worse", "sure"), [(3, 0, True), (2, 0, False), (9, 1, True), (8, 2, False)]
)
def test_few_windows_that_gain_much_are_sure_where_hardly_any_loses(changed, worse, sure):
    limits = Thresholds(changed_cost=5.0, changed_windows=3, changed_for_better=0.9)
    saved = np.zeros(30)
    saved[:changed], saved[changed : changed + worse] = 6.0, -6.0
    saved[-2:] = 4.9, -4.9  # not enough to count
    assert rarely_but_surely(saved, limits) is sure


@pytest.fixture
def weighed():
    """Matrices and gradients of 14 windows of three recordings, five unknowns, two with a prior."""
    random = np.random.default_rng(3)
    jacobian = random.normal(size=(14, 30, 5))
    residual = random.normal(size=(14, 30))
    matrices = np.einsum("wni,wnj->wij", jacobian, jacobian)
    gradients = np.einsum("wni,wn->wi", jacobian, residual)
    return matrices, gradients, np.diag([0.0, 0.0, 0.0, 1.0, 1.0])


def test_half_widths_are_those_of_the_sandwich_or_of_the_fit_itself(weighed):
    matrices, gradients, prior = weighed
    inverse = np.linalg.inv(sum(matrices) + prior)
    middle = np.zeros((5, 5))
    for gradient in gradients - sum(gradients) / 14:
        middle += np.outer(gradient, gradient)
    # Each unknown, and the first less the third.
    told = np.concatenate([np.eye(5), [[1.0, 0.0, -1.0, 0.0, 0.0]]])
    bread, own = (np.diag(told @ c @ told.T) for c in (inverse @ middle @ inverse, inverse))
    # Windows less the parameters that are fitted freely.
    wanted = stats.t.ppf(0.975, 14 - 3) * np.sqrt(np.maximum(bread, own))
    found = judging._sandwich(matrices, gradients, prior, told)
    np.testing.assert_allclose(found, wanted, rtol=1e-6)
    # What is told of the first unknowns alone is told alike.
    first = judging._sandwich(matrices, gradients, prior, told[[0, 2, 5], :3])
    np.testing.assert_allclose(first, wanted[[0, 2, 5]], rtol=1e-6)
    # Errors that repeat in windows count as they scatter; such as do not, as the noise.
    scattered = judging._sandwich(matrices, 9.0 * gradients, prior, told)
    wanted = stats.t.ppf(0.975, 11) * np.sqrt(np.maximum(81.0 * bread, own))
    np.testing.assert_allclose(scattered, wanted, rtol=1e-6)


@pytest.mark.parametrize("recordings", [1, 2, 3])
def test_the_jackknife_leaves_out_each_recording_once(weighed, recordings):
    matrices, gradients, prior = weighed
    of = np.arange(14) % recordings
    told = np.concatenate([np.eye(5), [[1.0, 0.0, -1.0, 0.0, 0.0]]])
    found = judging._jackknife(matrices, gradients, prior, told, of)
    if recordings == 1:
        np.testing.assert_array_equal(found, 0.0)
        return
    mean = gradients.mean(axis=0)
    shifts = []
    for left_out in range(recordings):
        keep = [w for w in range(14) if of[w] != left_out]
        centred = sum(mean - gradients[w] for w in keep)
        shifts.append(told @ np.linalg.solve(sum(matrices[w] for w in keep) + prior, centred))
    spread = np.array(shifts) - np.mean(shifts, axis=0)
    variance = (recordings - 1) / recordings * (spread**2).sum(axis=0)
    wanted = stats.t.ppf(0.975, recordings - 1) * np.sqrt(variance)
    np.testing.assert_allclose(found, wanted, rtol=1e-9)


def test_what_may_be_off_beside_an_effect_widens_its_interval_by_as_much():
    """Closed form: a twin of prior standard deviation s adds s^2 to the variance 1/(g'g)."""
    g2, s, windows = 400.0, 0.3, 50
    matrix = np.array([[g2, g2 * s], [g2 * s, g2 * s**2]])
    matrices = np.broadcast_to(matrix / windows, (windows, 2, 2))
    quiet = np.zeros((windows, 2))
    first = np.eye(1)
    half = judging._sandwich(matrices, quiet, np.diag([0.0, 1.0]), first)[0]
    quantile = stats.t.ppf(0.975, windows - 1)
    assert half == pytest.approx(quantile * np.sqrt(1.0 / g2 + s**2), rel=1e-6)
    alone = judging._sandwich(matrices[:, :1, :1], quiet[:, :1], np.zeros((1, 1)), first)[0]
    assert alone == pytest.approx(quantile / np.sqrt(g2), rel=1e-6)


def test_explained_is_the_share_of_what_the_healthy_machine_did_not_show():
    assert a_gap(unnamed=10.0, after=4.0, healthy=4.0).explained == 1.0
    assert a_gap(unnamed=10.0, after=7.0, healthy=4.0).explained == pytest.approx(0.5)
    assert a_gap(unnamed=10.0, after=4.0).explained == pytest.approx(6.0 / 9.0)
    assert a_gap(unnamed=10.0, after=3.0, healthy=4.0).explained == 1.0
    assert a_gap(unnamed=10.0, after=11.0, healthy=4.0).explained == 0.0
    assert a_gap(unnamed=4.0, after=4.0, healthy=4.0).explained is None
    assert a_gap(after=4.0).explained is None


def test_a_tenth_of_the_bandwidth_is_as_severe_as_the_trials_that_it_passes():
    bandwidth = EffectParameter("f", "Hz", nominal=250.0, upper=500.0, trials=(12.5, 30.0, 87.5))
    assert bandwidth.departure(250.0, 250.0) == 0.0
    assert bandwidth.departure(168.75, 250.0) == pytest.approx(0.5)
    assert bandwidth.departure(30.0, 250.0) == pytest.approx(2.0)
    assert bandwidth.departure(12.5, 250.0) == pytest.approx(3.0)
    # A long way in smallest trials counts as such, on a side without trials as well.
    assert bandwidth.departure(500.0, 250.0) == pytest.approx(250.0 / 162.5)


def test_a_strength_that_is_as_in_the_model_costs_nothing():
    """Friction in one direction alone needs no number for the other; a shape always counts."""
    site = LIBRARY.sites[ASYMMETRIC]
    values = site.nominal
    assert site.used(values, 0.15) == 1
    values[:2] += 2.0 * site.parameters[0].scale
    assert site.used(values, 0.15) == 2
    values[2] += 0.1 * site.parameters[2].scale
    assert site.used(values, 0.15) == 2
    assert site.used(values, 0.05) == 3
    payload = next(s for key, s in LIBRARY.sites.items() if key[0] == "payload")
    assert [p.role for p in payload.parameters] == ["strength", "shape"]
    assert payload.used(payload.nominal + 1.0, 0.15) == 2


# On windows of recordings, with costs that are given.


@pytest.fixture(scope="module")
def exact():
    """A pendulum that is as its model, with one recording of two held out."""
    kinds = ("fast", "multisine")
    logs = {k: record(PENDULUM, k, Truth(), seed=i, seconds=6.0) for i, k in enumerate(kinds)}
    return set_up(PENDULUM.model, logs, ("multisine",), DiagnosisSettings(threads=1))


@pytest.fixture(scope="module")
def rough(exact):
    """The same machine with an error of the model counted in."""
    none = exact.discrepancy(Hypothesis())
    return exact.trusting(replace(none, variance=np.ones_like(none.variance)))


def a_fit(problem, *keys, trials=4.0):
    """A fit with effects of so many trials' size."""
    values = {
        key: problem.library.sites[key].nominal
        + trials * np.array([p.scale for p in problem.library.sites[key].parameters])
        for key in keys
    }
    none = np.zeros((problem.replay.windows, problem.size))
    at = Linearisation(
        base=Hypothesis(values), residual=none, tangents=none, nuisances=(), chosen=problem.fitted
    )
    return Fit(free=frozenset(keys), cost=0.0, at=at)


def contender(problem, key, cost, trials=4.0):
    windows = problem.replay.windows
    return Contender(
        key=key, fit=a_fit(problem, key, trials=trials), cost=np.broadcast_to(cost, windows)
    )


def a_round(contenders, base=10.0, threshold=0.0, tried=1):
    """A round of contenders out of so many effects that were tried."""
    none = np.zeros(0)
    one = Candidate(key=OFFSET, values=none, gain=0.0, direction=none, step=none, detectable=9.0)
    base = np.broadcast_to(base, contenders[0].cost.shape).astype(float)
    return Round(
        base=base, candidates=(one,) * tried, contenders=tuple(contenders), threshold=threshold
    )


def saved(problem, fitted, held, scatter=0.01, scatter_held=0.01):
    """What an effect saves in each window: these means, with a scatter; (windows,)."""
    noise = np.random.default_rng(0).normal(size=problem.replay.windows)
    for part in (problem.fitted, problem.held):
        noise[part] = (noise[part] - noise[part].mean()) / noise[part].std()
    means = np.where(problem.held, held, fitted)
    return means + np.where(problem.held, scatter_held, scatter) * noise


def taken(problem, base, saving, key=OFFSET, trials=4.0, **others):
    """Whether an effect that saves so much in each window is accepted."""
    one = contender(problem, key, base - saving, trials)
    return accepted(problem, a_round([one], base, **others), one)


LEAST = DEFAULT.worthwhile


@pytest.mark.parametrize(
    ("base", "means", "scatter", "right", "right_if_rough"),
    [
        (10.0, (5.0, 5.0), (0.3, 0.3), True, True),
        # Held out, it comes and goes; a rough machine may hide it there, but not lose by it.
        (10.0, (5.0, 0.1), (0.3, 0.9), False, True),
        (10.0, (5.0, -0.2), (0.3, 0.2), False, False),
        # It must save a share of what is open beyond noise, and of a noise variance.
        (1.5, (1.02 * LEAST, 1.02 * LEAST), (1e-3, 1e-3), True, False),  # too improbable
        (1.5, (0.98 * LEAST, 0.98 * LEAST), (1e-3, 1e-3), False, False),
        (31.0, (30.6 * LEAST, 30.6 * LEAST), (1e-3, 1e-3), True, True),
        (31.0, (29.4 * LEAST, 29.4 * LEAST), (1e-3, 1e-3), False, False),
    ],
)
def test_a_gain_must_matter_and_hold_where_held_out(
    exact, rough, base, means, scatter, right, right_if_rough
):
    saving = saved(exact, *means, *scatter)
    assert taken(exact, base, saving) is right
    assert taken(rough, base, saving) is right_if_rough


@pytest.mark.parametrize("factor", [0.98, 1.02])
@pytest.mark.parametrize("tried", [1, 70])
def test_the_best_of_many_effects_must_say_more_than_a_single_one(rough, factor, tried):
    """Bonferroni: of 70 effects chance reaches t = 3.6 in 1 of 100 cases."""
    limit = factor * max(stats.norm.isf(0.01 / tried), DEFAULT.significant)

    def miss(scatter):
        return t_value(saved(rough, 8.0, 0.01, scatter, 0.2)) - limit

    saving = saved(rough, 8.0, 0.01, optimize.brentq(miss, 1.0, 1e3), 0.2)
    assert taken(rough, 20.0, saving, tried=tried) is (factor > 1.0)


@pytest.mark.parametrize(("share", "right"), [(0.9, True), (1.0, True), (1.1, False)])
def test_a_gain_that_chance_gives_is_not_accepted(exact, share, right):
    gain = exact.size * 2.0 * exact.fitted.sum()
    assert taken(exact, 10.0, saved(exact, 2.0, 2.0, 0.0), threshold=share * gain) is right


@pytest.mark.parametrize(("trials", "right"), [(0.14, False), (0.16, True)])
def test_a_strength_that_nobody_would_notice_is_not_accepted(exact, trials, right):
    assert taken(exact, 10.0, saved(exact, 5.0, 5.0), trials=trials) is right
    # Of several strengths that which departs the most counts, and no shape.
    assert noticeable(exact, ASYMMETRIC, departed(ASYMMETRIC, 0.0, trials, 0.0, 0.0)) is right
    payload = next(key for key in LIBRARY.sites if key[0] == "payload")
    assert noticeable(exact, payload, departed(payload, trials, 0.0)) is right
    assert not noticeable(exact, payload, departed(payload, 0.0, trials))


@pytest.mark.parametrize(("few", "right"), [(3, True), (4, False)])
def test_three_windows_held_out_are_too_few_to_speak(exact, few, right):
    problem = copy(exact)
    problem.held = np.arange(exact.replay.windows) >= exact.replay.windows - few
    saving = saved(problem, 5.0, -0.5)
    assert taken(problem, 10.0, saving) is right
    larger = contender(problem, ASYMMETRIC, 10.0 - saving)
    assert earns(problem, larger, contender(problem, VISCOUS, 10.0)) is right


@pytest.mark.parametrize("numbers", ["counted", "known"])
def test_one_more_effect_is_as_probable_as_none_whatever_its_name(rough, numbers):
    """Of seventy effects each is a seventieth of that; rivals speak together for one more."""
    problem, count = rough, rough.numbers
    if numbers == "known":  # of a specimen with healthy recordings
        problem = rough.with_nuisances((), worth=50.0)
        count = problem.worth
    price = count**0.5  # of a parameter
    for parts, many in ((1, 1), (2, 2)):
        times = 140.0
        gain = 10.0 * (1.0 - times ** (-2.0 / count))
        tried = [contender(problem, key, 10.0 - gain) for key in (OFFSET, COULOMB)[:parts]]
        none = nothing_more(problem, a_round(tried, tried=70))
        assert none == pytest.approx(70.0 * price / (70.0 * price + many * times))
    alone = nothing_more(problem, a_round(tried[:1]))
    assert alone == pytest.approx(price / (price + times))
    wide = contender(problem, ASYMMETRIC, 10.0 - gain)  # four numbers cost four
    none = nothing_more(problem, a_round([wide], tried=70))
    assert none == pytest.approx(70.0 * price**4 / (70.0 * price**4 + times))


@pytest.mark.parametrize(
    ("gain", "effects", "tried", "right"),
    [
        (0.15, [OFFSET], 70, False),
        (0.3, [OFFSET], 70, True),
        (0.2, [OFFSET], 1, True),
        (0.2, [ASYMMETRIC], 1, False),  # four numbers
        (0.18, [OFFSET], 70, False),
        (0.18, [OFFSET, COULOMB], 70, True),  # each speaks for one more
    ],
)
def test_an_effect_of_a_rough_machine_must_pay_for_its_parameters(
    exact, rough, gain, effects, tried, right
):
    """Every window gains, far beyond chance, and few numbers do not say so."""
    cost = 1.0 - saved(exact, gain, gain, 1e-3, 1e-3)
    one, *_ = several = [contender(exact, key, cost) for key in effects]
    told = a_round(several, 1.0, tried=tried)
    assert accepted(exact, told, one)
    assert accepted(rough, told, one) is right


@pytest.mark.parametrize(("factor", "right"), [(0.98, False), (1.02, True)])
@pytest.mark.parametrize("left", [0.5, 1.0, 4.0])
def test_a_larger_effect_must_save_more_than_its_further_parameters_do_by_chance(
    exact, factor, right, left
):
    """Wilks: a chi-square of as many degrees of freedom, times the dispersion that is left."""
    chance = max(left, 1.0) * stats.chi2.ppf(0.99, 3) / (exact.size * exact.fitted.sum())
    saving = saved(exact, factor * chance, chance, 1e-3 * chance, 1e-3 * chance)
    larger, special = (
        contender(exact, key, cost) for key, cost in ((ASYMMETRIC, left), (VISCOUS, left + saving))
    )
    assert earns(exact, larger, special) is right
    order = simplest_first(exact, (larger, special))
    assert [c.key for c in order] == [ASYMMETRIC, VISCOUS][:: 1 if right else -1]


@pytest.mark.parametrize(
    ("means", "right", "right_if_rough"),
    [
        ((1.5, 1.5), True, True),
        ((0.3, 0.3), True, False),  # Of few numbers chance may be what chi-square calls sure.
        ((2.0, 0.0), False, True),  # Held-out motion may hardly show it, but must not lose by it.
        ((2.0, -0.2), False, False),
    ],
)
def test_what_a_larger_effect_saves_must_hold_where_held_out_and_pay(
    exact, rough, means, right, right_if_rough
):
    saving = saved(exact, *means)
    larger = contender(exact, ASYMMETRIC, 3.0 - saving)
    simple = contender(exact, VISCOUS, 3.0)
    assert earns(exact, larger, simple) is right
    assert earns(rough, larger, simple) is right_if_rough
    share = posterior([3.0 - saving.mean(), 3.0], rough.numbers, [4, 1])
    np.testing.assert_allclose(probabilities(rough, (larger, simple)), share, rtol=1e-6)


def test_windows_that_err_much_weigh_less_in_intervals(exact):
    """A window of mean square c weighs limit / c where that is beyond the limit, else 1."""
    at = exact.linearise(Hypothesis({OFFSET: np.array([0.01])}), exact.fitted, {OFFSET})
    fit = Fit(free=frozenset({OFFSET}), cost=0.0, at=at)
    squares = np.mean(at.residual**2, axis=1)
    assert squares.min() < 3.0 < squares.max()
    matrices, gradients, prior = judging._sums(exact, fit, at, 1e-2)
    weight = np.minimum(1.0, 3.0 / squares)
    own = free_tangents(exact, at, fit.free, 1e-2)
    plain = Sums.of(at.residual, np.concatenate([own.columns, at.tangents], axis=2))
    np.testing.assert_allclose(matrices, weight[:, None, None] * plain.matrices)
    np.testing.assert_allclose(gradients, weight[:, None] * plain.gradients)
    np.testing.assert_array_equal(prior, np.diag([0.0] + [1.0] * at.tangents.shape[2]))


# What is a fault.


def departed(key, *trials):
    site = LIBRARY.sites[key]
    return {key: site.nominal + np.array(trials) * [p.scale for p in site.parameters]}


@pytest.mark.parametrize(
    ("calibrated", "spread"), [(True, "day_spread"), (False, "specimen_spread")]
)
@pytest.mark.parametrize("trials", [0.1, 0.9, 3.0])
def test_a_strength_is_a_fault_by_how_good_machines_scatter(exact, calibrated, spread, trials):
    """About their models, and from one day to the next."""
    wanted = beyond_specimens(trials, getattr(DEFAULT, spread), DEFAULT.fault_range)
    for way in (1.0, -1.0):
        values = departed(OFFSET, way * trials)
        found = fault_probability(exact, OFFSET, values, calibrated=calibrated)
        assert found == pytest.approx(wanted)


def test_what_takes_back_a_part_of_the_calibration_is_no_fault_beside_a_larger_one(exact):
    """The calibration had moved the offset by three trials from the model's."""
    scale = LIBRARY.sites[OFFSET].parameters[0].scale
    problem = copy(exact)
    problem.library = LIBRARY.of_specimen({OFFSET: np.array([3.0 * scale])})
    for now, beside, alone in ((1.0, 0.0, 2.0), (2.9, 0.0, 0.1), (5.0, 2.0, 2.0), (-2.0, 2.0, 5.0)):
        values = {OFFSET: np.array([now * scale])}
        for far, known in ((beside, True), (alone, False)):
            found = fault_probability(problem, OFFSET, values, calibrated=True, beside=known)
            wanted = beyond_specimens(far, DEFAULT.day_spread, DEFAULT.fault_range)
            assert found == pytest.approx(wanted)


@pytest.fixture(scope="module")
def bench():
    """What is asked of a problem about the faults of a hydraulic bench: its library."""
    log = record(PENDULUM, "fast", Truth(), seed=0, seconds=1.0)
    problem = set_up(PENDULUM.model, {"fast": log}, (), DiagnosisSettings(threads=1))
    problem.library = Library(Machine("knee_bench"))
    return problem


def test_a_better_part_than_the_models_is_no_fault(bench):
    """Seals do not get tighter as they wear; since healthy recordings it is a change."""
    key = ("internal_leakage", "knee_valve")
    nominal = bench.library.sites[key].nominal
    for factor, worn in ((0.1, False), (10.0, True)):
        values = {key: factor * nominal}
        assert (fault_probability(bench, key, values, calibrated=False) > 0.0) is worn
        assert fault_probability(bench, key, values, calibrated=True) > 0.0


def test_strengths_with_a_tolerance_scatter_by_it_others_by_what_is_noticeable(bench):
    for name in ("valve_gain", "valve_deadband", "internal_leakage", "payload"):
        key = next(k for k in bench.library.sites if k[0] == name)
        wanted = max(
            min(DEFAULT.specimen_spread, DEFAULT.rough_tolerance * p.tolerance / p.scale)
            if p.tolerance
            else DEFAULT.specimen_spread
            for p in bench.library.sites[key].parameters
            if p.role == "strength"
        )
        assert specimens_spread(bench, key) == pytest.approx(wanted)
    assert specimens_spread(bench, ("valve_gain", "knee_valve")) < 0.5
    assert specimens_spread(bench, ("valve_deadband", "knee_valve")) == DEFAULT.specimen_spread


# Names.


@pytest.mark.parametrize("key", [("backlash", "hinge"), VISCOUS, ASYMMETRIC])
def test_half_widths_allow_for_laws_that_are_not_the_models(exact, key):
    """By a share of the change of each strength; what is a shape keeps its own."""
    site = LIBRARY.sites[key]
    change = np.array([-2.0, 0.7, 3.0, 1.0])[: len(site.parameters)]
    differences = [change[0] - change[1], change[2] - change[3]] if key == ASYMMETRIC else []
    own = np.full(len(change) + len(differences), 0.3)
    half = naming._allowing_for_structure(exact, key, site.nominal + change, own)
    rows = zip(change, site.parameters, strict=True)
    strengths = [by if p.role == "strength" else 0.0 for by, p in rows]
    for width, by in zip(half, [*strengths, *differences], strict=True):
        assert width == pytest.approx(np.hypot(0.3, 1.96 * DEFAULT.rough_size * abs(by)))


def test_by_how_much_directions_differ_has_an_interval_of_its_own():
    """In units: unknowns are in scales, and what both directions share takes no part."""
    site = LIBRARY.sites[ASYMMETRIC]
    scales = [p.scale for p in site.parameters]
    told = judging._told(site)
    np.testing.assert_allclose(told[:4], np.diag(scales))
    np.testing.assert_allclose(told[4], [scales[0], -scales[1], 0.0, 0.0])
    np.testing.assert_allclose(told[5], [0.0, 0.0, scales[2], -scales[3]])
    values = np.array([0.5, 0.2, 0.3, 0.4])
    first, second = naming._differences(site, values, np.array([0.1, 0.04]))
    assert (first.name, second.name) == (
        "viscous_forward_less_backward",
        "coulomb_forward_less_backward",
    )
    assert (first.value, first.nominal, first.unit) == (pytest.approx(0.3), 0.0, "N m s/rad")
    assert first.interval == pytest.approx((0.2, 0.4))
    assert (second.value, second.interval) == (pytest.approx(-0.1), pytest.approx((-0.14, -0.06)))


@pytest.mark.parametrize(("held_out", "toothed"), [(0.4, 0.0), (0.5, 0.03)])
def test_shares_and_confidence_of_a_part_of_the_cause(held_out, toothed):
    """By robust mean squares; the held-out recording may have another force."""
    forces = {"multisine": held_out, "fast": 0.5, "slow": 0.5}
    logs = {
        kind: record(
            PENDULUM, kind, Truth(offset=force, ripple=(toothed, 0.9, 0.7)), seed=i, seconds=3.0
        )
        for i, (kind, force) in enumerate(forces.items())
    }
    settings = DiagnosisSettings(effects=("force_offset", "viscous_friction"), threads=1)
    result, found = diagnose(PENDULUM.model, logs, held_out=("multisine",), settings=settings)
    assert not result.rough
    (effect,) = result.effects
    fit = found.fit.hypothesis
    hypotheses = found.baseline.hypothesis, fit, fit.without(OFFSET)
    start, end, lost = (float(found.problem.window_cost(h).mean()) for h in hypotheses)
    assert end > DEFAULT.explained
    assert effect.contribution == pytest.approx((lost - end) / (lost - 1.0))
    share = (start - end) / (start - 1.0)
    assert effect.confidence == pytest.approx(DEFAULT.explained / end * share)
    assert result.verdict == "unexplained"


@pytest.mark.parametrize("force", [0.1, 0.4])
def test_confidence_of_a_change_of_a_machine_that_is_off_everywhere(force):
    """That the cause is in the library, and that a good machine has not as much of it."""
    rig = replace(PENDULUM, load=0.104)
    truth = Truth(offset=force, ripple=(0.05, 0.5, 0.3), gear_loss=0.03)
    logs = {k: record(rig, k, truth, seed=i, seconds=3.0) for i, k in enumerate(("fast", "slow"))}
    settings = DiagnosisSettings(effects=("force_offset",), threads=1)
    result, found = diagnose(PENDULUM.model, logs, held_out=("slow",), settings=settings)
    assert result.rough
    (effect,) = (*result.effects, *result.smaller)
    before, after = (
        float(total_cost(found.problem, fit).mean()) for fit in (found.baseline, found.fit)
    )
    trials = effect.parameters[0].value / LIBRARY.sites[OFFSET].parameters[0].scale
    fault = beyond_specimens(trials, DEFAULT.specimen_spread, DEFAULT.fault_range)
    library = within_library(1.0 - after / before, DEFAULT.uncalibrated_odds)
    assert effect.confidence == pytest.approx(fault * library)
    assert bool(result.effects) is (fault > 0.5)
    gap = result.gap
    share = (gap.unnamed - gap.after) / (gap.unnamed - 1.0)
    assert effect.contribution == pytest.approx(share)
    # Where too little speaks for it to be named, it may also be that nothing is there at all.
    doubted = assemble(replace(found, suspect=OFFSET), settings, seconds=0.0)
    assert doubted.verdict == "unexplained"
    nothing = nothing_more(found.problem, found.rounds[-1])
    assert [e.confidence for e in doubted.effects] == (
        [pytest.approx(fault * library * (1.0 - nothing))] if fault > 0.5 else []
    )
    # No rival is on record where no round is.
    alone = assemble(replace(found, rounds=()), settings, seconds=0.0)
    (same,) = (*alone.effects, *alone.smaller)
    assert same.confidence == pytest.approx(fault * library)


FOLDED = """
<mujoco><worldbody><body name="upper"><joint name="shoulder" axis="0 1 0"/>
<geom type="sphere" size=".05" pos="1 0 0" mass="3"/>
<body name="lower" pos="1 0 0"><joint name="elbow" axis="0 1 0"/>
<geom type="sphere" size=".01" pos="-1 0 0" mass="1"/></body></body>
<body name="other" pos="0 2 0"><joint name="lonely" axis="0 1 0"/>
<geom type="sphere" size=".05" pos="1 0 0" mass="3"/></body></worldbody>
<actuator><motor name="a" joint="shoulder"/><motor name="b" joint="elbow"/>
<motor name="c" joint="lonely"/></actuator></mujoco>
"""


def test_joints_that_feel_each_other_at_some_pose_only_are_coupled(tmp_path):
    path = tmp_path / "folded.xml"
    path.write_text(FOLDED)
    machine = Machine(str(path))
    assert naming.coupled_joints(machine) == ("shoulder", "elbow")
    assert naming.coupled_joints(MACHINE) == ()


# The self-test's own figures.


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
