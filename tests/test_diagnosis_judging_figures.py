"""Figures of the judging against closed forms, brute force and scipy."""

import numpy as np
import pytest
from scipy import stats

from leglab.diagnosis import judging
from leglab.diagnosis.judging import (
    beyond_specimens,
    posterior,
    preferences,
    rarely_but_surely,
    t_value,
    within_library,
)
from leglab.diagnosis.thresholds import Thresholds


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


@pytest.mark.parametrize(("share", "odds"), [(0.5, 1.0), (0.75, 9.0), (0.9, 81.0)])
def test_the_cause_is_in_the_library_by_the_square_of_explained_to_unexplained(share, odds):
    assert within_library(share) == pytest.approx(odds / (1 + odds))


def test_explained_shares_beyond_all_and_none_are_all_and_none():
    assert within_library(1.2) == 1.0
    assert within_library(-0.3) == 0.0


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
    variance = np.maximum(np.diag(inverse @ middle @ inverse), np.diag(inverse))
    # Windows less the parameters that are fitted freely.
    wanted = stats.t.ppf(0.975, 14 - 3) * np.sqrt(variance)
    np.testing.assert_allclose(judging._sandwich(matrices, gradients, prior), wanted, rtol=1e-6)
    # Errors that repeat in windows count as they scatter; such as do not, as the noise.
    scattered = judging._sandwich(matrices, 9.0 * gradients, prior)
    np.testing.assert_allclose(
        scattered,
        stats.t.ppf(0.975, 11)
        * np.sqrt(np.maximum(81.0 * np.diag(inverse @ middle @ inverse), np.diag(inverse))),
        rtol=1e-6,
    )


@pytest.mark.parametrize("recordings", [1, 2, 3])
def test_the_jackknife_leaves_out_each_recording_once(weighed, recordings):
    matrices, gradients, prior = weighed
    of = np.arange(14) % recordings
    found = judging._jackknife(matrices, gradients, prior, of)
    if recordings == 1:
        np.testing.assert_array_equal(found, 0.0)
        return
    mean = gradients.mean(axis=0)
    shifts = []
    for left_out in range(recordings):
        keep = [w for w in range(14) if of[w] != left_out]
        centred = sum(mean - gradients[w] for w in keep)
        shifts.append(np.linalg.solve(sum(matrices[w] for w in keep) + prior, centred))
    spread = np.array(shifts) - np.mean(shifts, axis=0)
    variance = (recordings - 1) / recordings * (spread**2).sum(axis=0)
    wanted = stats.t.ppf(0.975, recordings - 1) * np.sqrt(variance)
    np.testing.assert_allclose(found, wanted, rtol=1e-9)
