"""Evidence of sets against one large normal density, and steps against least squares."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from leglab.diagnosis.likelihood.columns import Errors
from leglab.diagnosis.likelihood.evidence import Evidence
from leglab.diagnosis.likelihood.priors import Priors
from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.replay.residual import thinned
from leglab.diagnosis.search.pipeline import DiagnosisSettings, set_up
from leglab.diagnosis.search.settle import Fitter
from leglab.diagnosis.thresholds import BESIDE, FINE, SPREADS, WIDER
from rigs import PENDULUM, Truth
from tests.helpers.unpleasant import of_kinds

EFFECTS = ("force_offset", "viscous_friction", "payload", "armature", "encoder_offset")


@cache
def evidence():
    """Of two recordings of a pendulum that has twice its friction, in a dozen windows."""
    logs = of_kinds(PENDULUM, Truth(viscous_factor=2.0), ("multisine", "fast"), seconds=2.0)
    problem = set_up(PENDULUM.model, logs, (), DiagnosisSettings(effects=EFFECTS, threads=1))
    at = Errors(problem, Unknowns.of(problem.library), thinned(problem.fitted, 12))
    fitter = Fitter(at, Priors())
    columns = at.columns(FINE)
    spread, _ = fitter.about(columns.errors)
    weight = np.linspace(0.4, 1.0, len(columns.errors))  # as robust weights may be
    return Evidence(at, columns, spread, weight, 0.3, fitter.priors)


def dense(found, windows, size, deviation):
    """Log density of the errors of some windows, but for its constant, unknowns integrated out.

    What least squares leave at a bound stands there: no friction is negative.
    """
    u, n, columns = found.unknowns, found.unknowns.single, found.columns
    factors, logs = whitened(found, size)
    counts = found.kappa * found.weight
    roots = np.sqrt(counts)[:, None, None] * factors
    errors = (roots @ columns.errors[:, :, None])[windows].ravel()
    tangents = np.concatenate((roots @ columns.tangents[:, :, :n])[windows])
    precision, _ = found.priors.precision(u, deviation)
    both = np.concatenate([tangents, np.sqrt(precision)]), np.append(-errors, np.zeros(n))
    moves = lsq_linear(*both, bounds=(u.lower[:n], u.upper[:n])).active_mask == 0
    tangents, precision = tangents[:, moves], precision[np.ix_(moves, moves)]
    whole = np.eye(errors.size) + tangents @ np.linalg.solve(precision, tangents.T)
    determinants = np.linalg.slogdet(whole)[1] + (counts * logs)[windows].sum()
    return -0.5 * (errors @ np.linalg.solve(whole, errors) + determinants)


def whitened(found, size):
    """Inverse roots of the covariances of windows at a size of the model's own error, and logs."""
    whitening = found.spread.whitening(found.at)
    factors, logs = whitening.at(size, 1.0)
    return factors[:, :, None] * whitening.basis, logs


@pytest.mark.parametrize("size", [0.0, 0.35, 1.5])
def test_errors_count_by_the_noise_and_the_models_own_error(size):
    found = evidence()
    roots, logs = whitened(found, size)
    n = found.at.size
    own = size**2 * found.spread.replays[found.at.recording]
    for root, covariance in zip(roots[:, :n, :n], found.at.covariance + own, strict=True):
        np.testing.assert_allclose(root @ covariance @ root.T, np.eye(n), atol=1e-6)
    if size == 0.0:  # forces say nothing of an exact model
        np.testing.assert_allclose(logs, np.linalg.slogdet(found.at.covariance)[1], rtol=1e-9)
        assert not roots[:, n:].any()


@pytest.mark.parametrize(
    ("left_out", "spread"), [(None, None), (2, None), (None, 1), (2, 1), (-1, None), (-2, None)]
)
def test_evidence_of_nothing_is_that_of_one_normal_density(left_out, spread):
    """With all windows, without a part or a recording, with all spreads of machines or one."""
    found = evidence()
    windows = np.ones(found.part.size, dtype=bool)
    if left_out is None:
        score = found.score((), spread=spread)
    else:
        score = found.apart((), spread, recordings=True)[left_out]
        windows = found.part != left_out if left_out >= 0 else found.at.recording != 2 + left_out
    deviations = found.priors.spreads
    grid = [
        dense(found, windows, size, deviation) + prior
        for size, prior in zip(found.priors.sizes, found.priors.log_sizes, strict=True)
        for deviation in (deviations if spread is None else deviations[spread : spread + 1])
    ]
    assert score.log == pytest.approx(np.logaddexp.reduce(grid), rel=1e-8)
    assert score.fit == pytest.approx(score.log)


@pytest.mark.parametrize("calibrated", [False, True])
def test_all_else_departs_further_beside_a_large_fault_of_a_known_machine(calibrated):
    """A law is off by a share of the fault; an unknown machine is off for reasons of its own."""
    found = evidence()
    u, columns = found.unknowns, found.columns
    q = next(i for i, key in enumerate(u.keys) if key[0] == "force_offset")
    priors = found.priors
    if calibrated:
        priors = replace(priors, covariance=1e-6 * np.eye(u.single), spreads=SPREADS + WIDER)
    assert priors.spreads == (SPREADS + WIDER if calibrated else SPREADS)
    for size in (1.0, 40.0):
        errors = columns.errors - size * columns.tangents[:, :, q]
        faulty = Evidence(
            found.at,
            replace(columns, errors=errors),
            found.spread,
            found.weight,
            found.kappa,
            priors,
        )
        widest = max(SPREADS[-1], BESIDE * size)
        for place, spread in enumerate(priors.spreads):
            counts = np.isfinite(faulty.score([(q, None)], spread=place).log)
            assert counts == (spread <= widest)
        assert np.isfinite(faulty.score((), spread=len(priors.spreads) - 1).log) != calibrated


def test_a_step_meets_the_bend_that_a_replay_showed():
    """As from a linearisation that has the bend in its errors; and it goes where the fit is."""
    found = evidence()
    score = found.score(())
    bend = 0.1 * np.random.default_rng(1).normal(size=found.columns.errors.shape)
    bend *= np.abs(found.columns.errors).max()
    columns = found.columns.__class__(
        **{**vars(found.columns), "errors": found.columns.errors + bend}
    )
    bent = Evidence(found.at, columns, found.spread, found.weight, found.kappa, found.priors)
    none = np.zeros(0)
    straight, met, there = (
        one.step(score, none, 0.0, beyond)[1]
        for one, beyond in ((found, None), (found, bend), (bent, None))
    )
    np.testing.assert_allclose(met, there, rtol=1e-6, atol=1e-9)
    assert np.abs(met - straight).max() > 0.01
