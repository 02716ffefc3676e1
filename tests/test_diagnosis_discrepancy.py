"""The judging is judged: each fault that was once put into it turns one of these tests red.

Here: the discrepancy of a model, the search under it, and the specimen at hand.
docs/diagnosis.md, "How the judging is tested", lists the faults beside the tests.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from leglab.diagnosis import rough
from leglab.diagnosis.discrepancy import Discrepancy, directions_of, from_errors
from leglab.diagnosis.hypothesis import Hypothesis, Library
from leglab.diagnosis.judging import (
    noticeable,
)
from leglab.diagnosis.model import Machine
from leglab.diagnosis.nuisances import all_strengths, rough_nuisances, within_tolerance
from leglab.diagnosis.residual import NoiseModel
from leglab.diagnosis.rough import settled_baseline
from leglab.diagnosis.thresholds import DEFAULT
from leglab.diagnosis.windows import Channel
from leglab.machine.cylinder import Cylinder
from tests.diagnosis_sketch import (
    COULOMB,
    HELD,
    LIBRARY,
    MACHINE,
    OFFSET,
    VISCOUS,
    WINDOWS,
    a_discrepancy,
    a_fit,
    a_round,
    a_sketch,
    contender,
    memory,
    ripple,
)


@pytest.fixture
def sketch(monkeypatch):
    return a_sketch(monkeypatch)


@pytest.fixture(scope="module")
def library():
    return LIBRARY


@pytest.fixture(scope="module")
def machine():
    return MACHINE


# The discrepancy of the model.


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
    found = from_errors(errors, recording, np.ones((2, 2)), np.eye(2))
    np.testing.assert_allclose(found.pattern, truth.pattern, atol=0.15)
    assert found.pattern[0, 5, 6] > 0.3 > abs(found.pattern[1, 5, 6])
    np.testing.assert_allclose(np.trace(found.pattern, axis1=1, axis2=2), bins)
    # The middle of windows lies below their mean, most where a window is few numbers.
    assert (found.variance < 1.05 * variance).all()
    assert (found.variance > 0.6 * variance).all()
    # A wild window does not change what is usual.
    errors[7] *= 1e3
    wild = from_errors(errors, recording, np.ones((2, 2)), np.eye(2))
    np.testing.assert_allclose(wild.variance, found.variance, rtol=0.05)
    np.testing.assert_allclose(wild.pattern, found.pattern, atol=0.05)


def test_a_cylinder_errs_little_in_force_where_its_chambers_err_alike():
    machine = Machine("knee_bench")
    position, *chambers = (Channel(column=c, joint="knee") for c in "qab")
    chambers = [replace(c, cylinder="knee_valve", chamber=f"pressure_{c.column}") for c in chambers]
    directions = directions_of(machine, (position, *chambers))
    np.testing.assert_allclose(directions @ directions.T, np.eye(3), atol=1e-12)
    # Pressures that balance each other over the cylinder's areas make no force.
    cylinder = Cylinder({n: machine.parameter("knee_valve", n) for n in ("bore", "rod", "stroke")})
    balanced = np.array([0.0, cylinder.area_b, cylinder.area_a])
    np.testing.assert_allclose(directions[1] @ balanced, 0.0, atol=1e-12)
    assert directions[2] @ balanced == pytest.approx(np.linalg.norm(balanced))
    np.testing.assert_array_equal(directions_of(machine, (position, chambers[0])), np.eye(2))

    rng = np.random.default_rng(5)
    truth = np.array([2.0, 0.5, 8.0])  # of position, force and what makes none
    drawn = rng.normal(size=(4000, 3, 4)) * np.sqrt(truth)[:, None]
    errors = np.einsum("kc,wkb->wcb", directions, drawn)
    recording = np.zeros(4000, dtype=int)
    found = from_errors(errors, recording, np.ones((1, 3)), directions)
    np.testing.assert_allclose(found.variance[0] / truth, found.variance[0, 0] / 2.0, rtol=0.1)
    # The whole covariance is that of the errors, but for what the middle of windows is too low.
    whole = found.covariance(np.zeros(1, dtype=int))[0] * (2.0 / found.variance[0, 0])
    np.testing.assert_allclose(whole, np.cov(errors.reshape(4000, 12).T), atol=0.8)


def test_errors_that_sensors_explain_show_no_discrepancy():
    errors = np.random.default_rng(3).normal(size=(50, 2, 12))
    found = from_errors(errors, np.zeros(50, dtype=int), np.zeros((1, 2)), np.eye(2))
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
    found = a_discrepancy().at_least(floor)
    np.testing.assert_array_equal(found.variance, [[2.0, 4.0], [9.0, 2.0]])
    kept = a_discrepancy().at_least(None)
    np.testing.assert_array_equal(kept.variance, a_discrepancy().variance)


def test_a_baseline_and_its_discrepancy_are_fitted_in_turn(monkeypatch):
    """Each fit leaves a quarter of the error, down to 1; the discrepancy follows it."""
    level, trusted, shares = [64.0], [], []

    def estimated(hypothesis):
        return Discrepancy(
            directions=np.eye(1), pattern=np.eye(2)[None], variance=np.array([[level[0]]])
        )

    problem = SimpleNamespace(
        thresholds=DEFAULT,
        discrepancy=estimated,
        linearise=lambda hypothesis, chosen, share: shares.append(share),
        noise_levels=lambda hypothesis: np.array([level[0]]),
    )

    def trusting(discrepancy):
        trusted.append(float(discrepancy.variance[0, 0]))
        return problem

    def fitted(problem, at, free, iterations, fine):
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
    level[0] = 4096.0  # further rounds, until it stays, with fine differences
    shares.clear()
    settled_baseline(problem, np.ones(3, dtype=bool), sharpenings=4)
    assert shares == [0.5] * 4 + [DEFAULT.fine_differences] * 3


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
        return Discrepancy(
            directions=np.eye(1), pattern=np.eye(2)[None], variance=np.array([[level(hypothesis)]])
        )

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


@pytest.mark.parametrize("calibrated", [True, False])
@pytest.mark.parametrize(("threshold", "expected"), [(100.0, [OFFSET]), (1e6, [])])
def test_a_rough_search_names_only_what_is_accepted(
    sketch, monkeypatch, threshold, expected, calibrated
):
    """And screens where no strength has been pulled along by what is missing, of an unknown machine
    also where all that follows has followed."""
    base = ripple(10.0)
    tried = a_round([contender(sketch.library, OFFSET, base - 5.0)], base, threshold)
    fitted = []

    def settled(problem, chosen, floor):
        fitted.append(chosen)
        return problem, a_fit(sketch.library, VISCOUS)

    def searched(problem, start, best, *_, beside=None):
        assert best.free == {VISCOUS}
        assert start == ({} if calibrated else best.hypothesis)
        assert beside == (None if calibrated else {})
        return problem, tried

    monkeypatch.setattr(rough, "settled_baseline", settled)
    monkeypatch.setattr(rough, "search_round", searched)
    monkeypatch.setattr(rough, "annealed", lambda problem, *_: (problem, tried))
    monkeypatch.setattr(rough, "paired", lambda *_: None)
    width = sketch.library.sites[VISCOUS].parameters[0].tolerance

    def following(nuisances, worth=None):
        """Of an unknown machine errors are fewer numbers beside the priors, and these are wide."""
        assert worth == (DEFAULT.calibrated_numbers if calibrated else DEFAULT.rough_numbers)
        (viscous,) = [n for n in nuisances if n.key == VISCOUS]
        share = DEFAULT.drift_share if calibrated else DEFAULT.rough_tolerance
        assert viscous.tolerance == pytest.approx(share * width)
        return sketch

    sketch.with_nuisances = following
    sketch.discrepancy = lambda hypothesis: a_discrepancy()
    rng = np.random.default_rng(0)
    *_, named, rounds = rough.rough_search(sketch, 1, rng, lambda _: None, calibrated=calibrated)
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
        rough_nuisances(about, 0.3, 0.7, 1.0),
        all_strengths(about, 1.0, 3.0),
    ):
        priors = {n.key: n.nominal for n in nuisances}
        assert priors[VISCOUS] == 0.1
    assert priors[OFFSET] == 0.3
