"""Judgement: paired comparisons of hypotheses over windows, and intervals of parameters."""

from collections.abc import Sequence

import numpy as np
from scipy.stats import t as student

from leglab.diagnosis.fitting import Fit, free_tangents
from leglab.diagnosis.residual import Problem, robust_weight

_DRAWS = 1000
# A window has changed if its cost did by more than this noise variance ...
_CHANGED = 1.0
# ... and so many must have, of which this share for the better.
_FEW = 2
_NEARLY_ALL = 0.9


def t_value(difference: np.ndarray) -> float:
    """Mean over its standard error of paired differences of windows, shape (windows,)."""
    if difference.size < 2:
        return 0.0
    spread = float(difference.std(ddof=1)) / np.sqrt(difference.size)
    return float(difference.mean()) / spread if spread > 0 else 0.0


def rarely_but_surely(saved: np.ndarray) -> bool:
    """Whether a few windows gain much and hardly any loses: an effect that shows at times only.

    A play shows when the torque changes its sign; in a slow recording these are two windows of
    nineteen, too few for a mean over its standard error.

    Args:
        saved: Robust cost saved in held-out windows, in noise variances, shape (windows,).
    """
    changed = saved[np.abs(saved) > _CHANGED]
    return changed.size >= _FEW and bool(np.mean(changed > 0) >= _NEARLY_ALL)


def preferences(costs: Sequence[np.ndarray], rng: np.random.Generator) -> np.ndarray:
    """Share of resampled sets of windows in which i costs less than j, shape (k, k).

    Args:
        costs: Of each hypothesis, shape (windows,) each.
        rng: Draws windows with replacement (Efron's bootstrap of paired blocks).
    """
    table = np.stack(costs)
    count = table.shape[1]
    weights = rng.multinomial(count, np.full(count, 1.0 / count), size=_DRAWS)
    totals = weights @ table.T
    wins = (totals[:, :, None] < totals[:, None, :]).mean(axis=0)
    ties = (totals[:, :, None] == totals[:, None, :]).mean(axis=0)
    return wins + 0.5 * ties


def intervals(problem: Problem, fit: Fit, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Standard errors of the free parameters in their units, and the factor of 95 %.

    The larger of two: the sandwich with windows as clusters (Liang and Zeger 1986), and a
    jackknife over recordings, which sees what all windows of a recording share. Both to first
    order about the fit.

    Returns:
        Standard errors, shape (parameters,), in the order of sorted effects; and half the width
        of the 95 % interval, same shape.
    """
    own = free_tangents(problem, fit.hypothesis, fit.free, fit.residual, chosen, 0.1)
    count = own.columns.shape[2]
    jacobian = np.concatenate([own.columns, fit.tangents], axis=2)
    weight = robust_weight(np.mean(fit.residual**2, axis=1))
    matrices = np.einsum("w,wni,wnj->wij", weight, jacobian, jacobian)
    gradients = np.einsum("w,wni,wn->wi", weight, jacobian, fit.residual)
    prior = np.diag(np.concatenate([np.zeros(count), np.ones(jacobian.shape[2] - count)]))
    total = matrices.sum(axis=0) + prior
    total[np.diag_indices_from(total)] *= 1.0 + 1e-9
    inverse = np.linalg.pinv(total, hermitian=True)
    centred = gradients - gradients.mean(axis=0)
    bread = inverse @ (centred.T @ centred) @ inverse
    noise = np.maximum(np.diag(bread), np.diag(inverse))[:count]
    recording = problem.replay.recording[chosen]
    present = np.unique(recording)
    half = student.ppf(0.975, max(gradients.shape[0] - count, 1)) * np.sqrt(noise)
    if present.size > 1:
        shifts = []
        mean = gradients.mean(axis=0)
        for number in present:
            keep = recording != number
            part = matrices[keep].sum(axis=0) + prior
            step = -np.linalg.pinv(part, hermitian=True) @ (
                gradients[keep].sum(axis=0) - keep.sum() * mean
            )
            shifts.append(step[:count])
        spread = np.stack(shifts)
        share = (present.size - 1) / present.size
        jack = np.sqrt(share * ((spread - spread.mean(axis=0)) ** 2).sum(axis=0))
        half = np.maximum(half, student.ppf(0.975, present.size - 1) * jack)
    scale = np.concatenate(
        [[p.scale for p in problem.library.sites[k].parameters] for k in sorted(fit.free)]
    )
    return np.sqrt(noise) * scale, half * scale
