"""The B-spline bases, as the core evaluates them."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from leglab.identification import Basis, Rls, Spline, SplineNarx, SplineNarxSettings

ASINH = Basis.asinh(-1.0, 2.0, 9, centre=0.3, width=0.05)
UNIFORM = Basis.uniform(-1.0, 2.0, 9)


def evaluate(basis, u):
    """All splines at each u by the C++ core, (len(u), count): y = theta_i N_i(u)."""
    settings = SplineNarxSettings(features=(Spline(signal="u", lag=0, basis=basis),), rls=Rls())
    model = SplineNarx(settings)
    columns = []
    for unit in np.eye(basis.count):
        model.parameters = unit
        columns.append(model.free_run(u))
    return np.array(columns).T


@pytest.mark.parametrize("basis", [UNIFORM, ASINH], ids=["uniform", "asinh"])
def test_full_basis_is_scipys_and_sums_to_one(basis):
    u = np.linspace(-1.0, 2.0, 1501)
    have = evaluate(basis, u)
    want = BSpline.design_matrix(u, basis.extended_knots, 2).toarray()
    np.testing.assert_allclose(have, want, atol=1e-13)
    np.testing.assert_allclose(have.sum(axis=1), 1.0, atol=1e-14)
    assert np.all(np.count_nonzero(have, axis=1) <= 3)
    np.testing.assert_allclose(have @ basis.identity_weights(), u, atol=1e-14)


def test_asinh_knots_are_dense_around_the_centre():
    gaps, middles = np.diff(ASINH.knots), np.convolve(ASINH.knots, [0.5, 0.5], "valid")
    assert (ASINH.knots[0], ASINH.knots[-1]) == (-1.0, 2.0)
    assert np.argmin(gaps) == np.argmin(np.abs(middles - 0.3))
    assert gaps.max() > 10 * gaps.min()


def test_paper_basis_is_dead_at_the_ends():
    basis = Basis.uniform(0.0, 0.8, 8, kind="paper")
    assert len(basis.knots) == 11
    u = np.linspace(0.0, 0.8, 801)
    have = evaluate(basis, u)
    elements = [BSpline.basis_element(basis.knots[i : i + 4], False) for i in range(8)]
    want = np.nan_to_num(np.array([element(u) for element in elements]).T)
    np.testing.assert_allclose(have, want, atol=1e-13)
    inner = (u >= 0.16) & (u <= 0.64)
    np.testing.assert_allclose(have[inner].sum(axis=1), 1.0, atol=1e-13)
    assert np.all(have[~inner].sum(axis=1) < 1.0)
    assert have[0].sum() == have[-1].sum() == 0.0


def test_printed_middle_piece_jumps_at_the_knots():
    """Eq. 9 as printed: at k_i + dk the value jumps from 1/2 to 5/2."""
    knots = np.linspace(0.0, 0.8, 11)
    step = np.array([knots[1] - 1e-9, knots[1] + 1e-9])
    for middle, after in (("corrected", 0.5), ("printed", 2.5)):
        basis = Basis.uniform(0.0, 0.8, 8, kind="paper", middle_piece=middle)
        before, behind = evaluate(basis, step)[:, 0]
        assert before == pytest.approx(0.5, abs=1e-6)
        assert behind == pytest.approx(after, abs=1e-6)


@pytest.mark.parametrize("knots", [UNIFORM.knots, ASINH.knots], ids=["uniform", "asinh"])
def test_continuation_outside_the_knots(knots):
    weights = np.random.default_rng(0).standard_normal(len(knots) + 1)
    u = np.array([-1.7, -1.0, 2.0, 2.9])
    near = np.clip(u, -1.0, 2.0)
    inside = Basis(knots=knots).spline(weights)
    want = {
        "clamp": inside(near),
        "linear": inside(near) + inside(near, 1) * (u - near),
        "quadratic": inside(u),
    }
    for outside, value in want.items():
        have = evaluate(Basis(knots=knots, outside=outside), u) @ weights
        np.testing.assert_allclose(have, value, rtol=1e-11)
