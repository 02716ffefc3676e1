"""The discrepancy of a model, and the library about the specimen at hand."""

from dataclasses import replace

import numpy as np
import pytest

from leglab.diagnosis.effects.hypothesis import Library
from leglab.diagnosis.former.discrepancy import Discrepancy, directions_of, from_errors
from leglab.diagnosis.former.nuisances import all_strengths, rough_nuisances, within_tolerance
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.replay.residual import NoiseModel
from leglab.diagnosis.replay.windows import Channel
from leglab.machine.cylinder import Cylinder
from tests.rigs import PENDULUM

OFFSET, VISCOUS = ("force_offset", "hinge"), ("viscous_friction", "hinge")
COULOMB = ("coulomb_friction", "hinge")


@pytest.fixture(scope="module")
def machine():
    return Machine(PENDULUM.model)


@pytest.fixture(scope="module")
def library(machine):
    return Library(machine)


def memory(bins, reach):
    """Covariance that fades with the distance."""
    return np.exp(-np.abs(np.subtract.outer(np.arange(bins), np.arange(bins))) / reach)


def a_discrepancy(bins=12, reach=4.0):
    pattern = np.stack([memory(bins, reach), np.eye(bins)])
    variance = np.array([[1.0, 4.0], [9.0, 0.0]])
    return Discrepancy(directions=np.eye(2), pattern=pattern, variance=variance)


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
