"""Figures of the judging against closed forms, brute force and scipy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from leglab.diagnosis import judging, naming
from leglab.diagnosis.evidence import beyond_specimens, posterior, within_library
from leglab.diagnosis.judging import (
    accepted,
    earns,
    preferences,
    rarely_but_surely,
    t_value,
)
from leglab.diagnosis.model import Machine
from leglab.diagnosis.thresholds import DEFAULT, Thresholds
from leglab.diagnosis.windows import Channel
from tests.diagnosis_sketch import (
    ASYMMETRIC,
    COULOMB,
    LIBRARY,
    MACHINE,
    OFFSET,
    VISCOUS,
    WINDOWS,
    a_gap,
    a_round,
    a_search,
    a_sketch,
    contender,
    exact_verdict,
    ripple,
    rough_ties,
)
from tests.test_diagnosis_judging import linear


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


def test_windows_that_err_much_weigh_less_in_intervals():
    """A window of mean square c weighs limit / c where that is beyond the limit, else 1."""
    problem, fit, _ = linear(LIBRARY, np.random.default_rng(4))
    fit.at.residual[0] *= 10.0
    plain = judging._sums(problem, fit, fit.at, 1e-3)
    problem.thresholds = replace(problem.thresholds, robust_limit=3.0)
    robust = judging._sums(problem, fit, fit.at, 1e-3)
    weight = 3.0 / np.maximum(np.mean(fit.at.residual**2, axis=1), 3.0)
    assert weight[0] < 0.1
    assert weight[1:].min() == 1.0
    np.testing.assert_allclose(robust[0], weight[:, None, None] * plain[0])
    np.testing.assert_allclose(robust[1], weight[:, None] * plain[1])


# Acceptance and names, on costs that are given.


@pytest.fixture
def sketch(monkeypatch):
    return a_sketch(monkeypatch)


@pytest.mark.parametrize(("level", "least"), [(1.5, 1.0), (31.0, 30.0)])
def test_a_gain_must_matter_beside_what_is_open(sketch, level, least):
    """An effect must save a share of what is open beyond noise, and of a noise variance."""
    needed = DEFAULT.worthwhile * least
    for factor, right in ((1.02, True), (0.98, False)):
        base = np.full(WINDOWS, level)
        found = contender(sketch.library, OFFSET, base - ripple(factor * needed, size=1e-3))
        assert accepted(sketch, a_round([found], base), found) is right


@pytest.mark.parametrize(("few", "right"), [(3, True), (4, False)])
def test_three_windows_held_out_are_too_few_to_speak(sketch, few, right):
    sketch.held = np.arange(WINDOWS) >= WINDOWS - few
    base = np.full(WINDOWS, 10.0)
    saved = np.where(sketch.held, -0.5, 5.0) + ripple(0.0, size=0.01)
    found = contender(sketch.library, OFFSET, base - saved)
    assert accepted(sketch, a_round([found], base), found) is right
    offset = contender(sketch.library, ASYMMETRIC, base - saved)
    simple = contender(sketch.library, VISCOUS, base)
    assert earns(sketch, offset, simple) is right


def test_contributions_and_confidence_of_an_exact_model(sketch):
    both = frozenset([OFFSET, VISCOUS])
    sketch.costs |= {
        frozenset(): 30.0,
        frozenset([OFFSET]): 11.0,
        frozenset([VISCOUS]): 21.0,
        both: 1.5,
    }
    said, effects, _ = exact_verdict(sketch, [OFFSET, VISCOUS])
    assert said == "named"
    # What the machine without it leaves beyond noise, the larger contribution first.
    assert [(e.name, e.contribution) for e in effects] == [
        ("force_offset", pytest.approx((21.0 - 1.5) / (21.0 - 1.0))),
        ("viscous_friction", pytest.approx((11.0 - 1.5) / (11.0 - 1.0))),
    ]
    assert [e.confidence for e in effects] == [1.0, 1.0]
    sketch.costs[both] = 3.5
    said, effects, _ = exact_verdict(sketch, [OFFSET, VISCOUS])
    assert said == "partial"
    wanted = DEFAULT.explained / 3.5 * (30.0 - 3.5) / (30.0 - 1.0)
    assert [e.confidence for e in effects] == [pytest.approx(wanted)] * 2
    # Costs below that of noise are no gap that could be closed.
    sketch.costs |= {both: 1.0, frozenset([OFFSET]): 1.0, frozenset([VISCOUS]): 0.9}
    _, effects, _ = exact_verdict(sketch, [OFFSET, VISCOUS])
    assert [e.contribution for e in effects] == [0.0, 0.0]


def test_one_effect_that_is_not_told_apart_makes_a_confusion_set(sketch):
    sketch.costs |= {
        frozenset(): 30.0,
        frozenset([OFFSET]): 9.0,
        frozenset([VISCOUS]): 9.0,
        frozenset([OFFSET, VISCOUS]): 1.0,
    }
    own = ripple(1.0)
    tried = [contender(sketch.library, k, own) for k in (OFFSET, COULOMB)]
    sure = [contender(sketch.library, VISCOUS, own)]
    found = a_search(sketch, [OFFSET, VISCOUS])
    found = replace(found, checks={OFFSET: tuple(tried), VISCOUS: tuple(sure)})
    said, effects, _ = naming.judge_exact(found, np.random.default_rng(0))
    assert said == "confusion_set"
    ties = {e.name: e.indistinguishable_from for e in effects}
    assert ties == {"force_offset": ("coulomb_friction",), "viscous_friction": ()}
    gap = a_gap(unnamed=10.0)
    level = {frozenset(): 10.0, frozenset([OFFSET]): 6.0, frozenset([VISCOUS]): 6.0}
    rough = naming.judge_rough(found, gap, lambda hypothesis: level[frozenset(hypothesis)])
    assert rough[0] == "confusion_set"


def test_the_round_in_which_an_effect_did_best_says_what_it_is_told_apart_from(sketch):
    """An early round lacked the other effects: both cost much there, and alike."""
    early = [contender(sketch.library, k, ripple(20.0)) for k in (OFFSET, COULOMB)]
    late = [contender(sketch.library, k, c) for k, c in ((OFFSET, 1.0), (COULOMB, 9.0))]
    found = a_search(sketch, [OFFSET])
    found = replace(found, rounds=(a_round(early), a_round(late)))
    assert rough_ties(found, OFFSET)[0] == ()
    assert rough_ties(found, OFFSET)[1] > 0.95


def test_late_commands_and_late_sensors_are_one_where_no_third_signal_is(sketch):
    key = ("sensor_delay", "hinge")
    assert naming.twins(sketch, key) == ("command_delay",)
    found = a_search(sketch, [key])
    assert rough_ties(found, key) == (("command_delay",), 0.5)
    pressure = Channel(column="hinge_pressure_a", joint="hinge", chamber="a")
    sketch.channels = (*sketch.channels, pressure)
    assert naming.twins(sketch, key) == ()


@pytest.mark.parametrize("key", [("backlash", "hinge"), VISCOUS, ASYMMETRIC])
def test_half_widths_allow_for_laws_that_are_not_the_models(sketch, key):
    """By a share of the change of each strength; what is a shape keeps its own."""
    site = sketch.library.sites[key]
    change = np.array([-2.0, 0.7, 3.0, 1.0])[: len(site.parameters)]
    differences = [change[0] - change[1], change[2] - change[3]] if key == ASYMMETRIC else []
    own = np.full(len(change) + len(differences), 0.3)
    half = naming._allowing_for_structure(sketch, key, site.nominal + change, own)
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


def test_no_effect_closes_more_than_all(sketch):
    sketch.costs |= {frozenset(): 30.0, frozenset([OFFSET]): 0.5}
    _, (effect,), _ = exact_verdict(sketch, [OFFSET])
    assert effect.contribution == 1.0


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
