"""Refinement of a remainder by replay: a robust Gauss-Newton fit with the balances as prior."""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from leglab.diagnosis.effects.hypothesis import Hypothesis, Key
from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.remainder.forms import Form
from leglab.diagnosis.remainder.part import LearnedLibrary, Part
from leglab.diagnosis.replay.residual import Problem, robust_cost, robust_weight, thinned


def directions(form: Form, most: int) -> np.ndarray:
    """Where a balance leaves unknowns most open, in standard deviations, (unknowns, directions)."""
    scale = np.sqrt(np.maximum(np.diag(form.covariance), 1e-300))
    values, vectors = np.linalg.eigh(form.covariance / np.outer(scale, scale))
    order = np.argsort(-values)[:most]
    return np.asarray(scale[:, None] * vectors[:, order] * np.sqrt(np.maximum(values[order], 0.0)))


def with_parts(problem: Problem, parts: Sequence[Part]) -> Problem:
    """The same problem, all of whose hypotheses have learned parts."""
    other = copy(problem)
    other.library = LearnedLibrary(problem.library, parts)
    return other


def refine(
    problem: Problem,
    hypothesis: Hypothesis,
    forms: Sequence[Form],
    fixed: frozenset[Key],
) -> tuple[tuple[Part, ...], Hypothesis]:
    """Fits principal directions of the forms, and nuisances from a hypothesis on, to replays.

    Effects in `fixed` stay as they are.

    Returns:
        The parts, in the order of the forms, each with a bound a little above what it reaches on
        its data, and the hypothesis with the nuisances beside them.
    """
    problem, limits = copy(problem), problem.thresholds
    chosen = thinned(problem.fitted, limits.learned_windows)
    each = max(3, limits.learned_directions // len(forms))
    along = [directions(form, each) for form in forms]
    ends = np.cumsum([one.shape[1] for one in along])
    u = Unknowns.of(problem.library)
    # What differs between good machines follows.
    loose = [i for i in range(u.single) if u.tolerance[i] > 0.0 and u.keys[i] not in fixed]
    count, z, base = ends[-1], np.zeros(ends[-1]), hypothesis

    def parts(z: np.ndarray) -> tuple[Part, ...]:
        rows = zip(forms, along, np.split(z, ends[:-1]), strict=True)
        return tuple(form.part(form.values + axes @ own) for form, axes, own in rows)

    def moved(step: np.ndarray) -> tuple[np.ndarray, Hypothesis, np.ndarray]:
        """Place and hypothesis after a step, and its departures from the priors' means."""
        by = dict(zip(loose, (step[count:] * u.tolerance[loose]).tolist(), strict=True))
        new = z + step[:count], u.moved(base, by)
        eta = u.departures(new[1])[loose] / u.tolerance[loose]
        return *new, np.concatenate([new[0], eta])

    def errors(z: np.ndarray, base: Hypothesis) -> np.ndarray:
        return with_parts(problem, parts(z)).residual(base, chosen)

    def cost(residual: np.ndarray, departed: np.ndarray, scale: float) -> float:
        squares = np.mean(residual**2, axis=1) / scale**2
        told = residual.shape[1] * robust_cost(squares, limits.robust_limit).sum()
        return float(told + departed @ departed)

    for iteration in range(4):
        # The noise model of a base without its parts tells little of start states.
        if iteration < 2:
            problem.noise = with_parts(problem, parts(z)).about(base).noise
        residual, (_, _, offset) = errors(z, base), moved(np.zeros(count + len(loose)))
        # Differences over half a standard deviation of what balances, or good machines, leave open.
        probes = (moved(0.5 * row)[:2] for row in np.eye(offset.size))
        columns = [(errors(*probe) - residual) / 0.5 for probe in probes]
        step, scale = _step(residual, np.stack(columns, axis=2), offset, limits.robust_limit)
        before = cost(residual, offset, scale)
        for share in 0.4 ** np.arange(5):
            new_z, new_base, departed = moved(share * step)
            after = cost(errors(new_z, new_base), departed, scale)
            if after < before:
                break
        else:
            break
        z, base = new_z, new_base
        if before - after < 1e-2 * before:
            break
    final = []
    for part, form in zip(parts(z), forms, strict=True):
        reach = float(np.max(np.abs(part.at(form.balance.inputs))))
        final.append(replace(part, bound=1.05 * reach) if reach > 0.0 else part)
    return tuple(final), base


def _step(
    residual: np.ndarray, jacobian: np.ndarray, offset: np.ndarray, limit: float
) -> tuple[np.ndarray, float]:
    """Robust step of all unknowns, in standard deviations of priors, and the scale of what is left.

    A model that is wrong elsewhere leaves errors of many noise levels. Their scale, the median
    window after the step, weighs replays against priors (Kennedy and O'Hagan 2001).
    """
    matrices = jacobian.transpose(0, 2, 1) @ jacobian
    rights = np.einsum("wnk,wn->wk", jacobian, residual)
    x, scale = np.zeros(offset.size), 1.0
    for _ in range(6):
        squares = np.mean((residual + jacobian @ x) ** 2, axis=1)
        scale = max(1.0, float(np.sqrt(np.median(squares))))
        weight = robust_weight(squares / scale**2, limit) / scale**2
        matrix = np.einsum("w,wij->ij", weight, matrices) + np.eye(offset.size)
        x = np.linalg.solve(matrix, -(weight @ rights + offset))
    return x, scale
