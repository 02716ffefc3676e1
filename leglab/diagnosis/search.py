"""Greedy search for effects: screen, refit, sharpen, compare."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leglab.diagnosis.fitting import Fit, free_tangents, refit
from leglab.diagnosis.hypothesis import Hypothesis, Key
from leglab.diagnosis.residual import Problem, robust_cost
from leglab.diagnosis.screening import Candidate, pairs, screen

# How many of the screened effects are refitted, and how many of those sharpened.
_REFITTED = 4
_SHARPENED = 3
# A round whose best screened effect saves less than this share of a noise variance ends there.
_HOPE = 0.04
# Of all pairs to first order so many are fitted.
_PAIRS = 3
# A rough fit that costs more than this share of the baseline is started again from there.
_STUCK = 0.95
# A robust mean square below which a rival may still catch up, in so many more fits.
_CLOSE = 4.0
_PATIENCE = 3
# Finite differences of the last fits, as a share of those of the first.
_FINE = 0.1
# A rival whose cost is this many times the best one's excess after a rough fit stays behind.
_HOPELESS = 8.0

Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Contender:
    """An effect set that was fitted to the end.

    Attributes:
        key: Effect that was added last.
        fit: On the fitted windows.
        cost: Robust mean square of every window, fitted and held out, shape (windows,).
    """

    key: Key
    fit: Fit
    cost: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class Stage:
    """One round of the search.

    Attributes:
        base: Robust mean square of every window before the round, shape (windows,).
        base_hypothesis: Of the base.
        candidates: As screened, best first.
        contenders: As fitted, best first.
        threshold: Gain that the best of all effects reaches by chance in 1 of 100 cases.
    """

    base: np.ndarray
    base_hypothesis: Hypothesis
    candidates: tuple[Candidate, ...]
    contenders: tuple[Contender, ...]
    threshold: float


def thinned(mask: np.ndarray, every: int) -> np.ndarray:
    """Every n-th of the windows in a mask, same shape."""
    out = np.zeros_like(mask)
    out[np.flatnonzero(mask)[::every]] = True
    return out


def window_cost(problem: Problem, hypothesis: Hypothesis) -> np.ndarray:
    """Robust mean square of all windows, shape (windows,)."""
    return robust_cost(np.mean(problem.residual(hypothesis) ** 2, axis=1))


def baseline(problem: Problem, chosen: np.ndarray) -> Fit:
    """The unmodified model with its nuisances refitted under their priors."""
    nominal = Hypothesis()
    residual = problem.residual(nominal, chosen)
    tangents = problem.tangents(nominal, residual, chosen, problem.nuisances)
    return refit(
        problem,
        nominal,
        frozenset(),
        chosen,
        tangents,
        problem.nuisances,
        iterations=3,
        residual=residual,
    )


def chance_gain(
    candidates: Sequence[Candidate],
    tangents: np.ndarray,
    overdispersion: float,
    rng: np.random.Generator,
    *,
    draws: int = 2000,
    quantile: float = 0.99,
) -> float:
    """Gain that the best of all effects reaches by chance: parametric bootstrap of the maximum.

    Under the null the gain of an effect is the square of the projection of white noise on its
    direction, nuisances projected out; directions of different effects are correlated.

    Args:
        candidates: With their directions.
        tangents: Of the nuisances, shape (chosen windows, size, nuisances).
        overdispersion: Mean square of the residuals when nothing is missing.
        rng: Draws the noise.
        draws: Bootstrap samples.
        quantile: Of the maximum.
    """
    flat = tangents.reshape(tangents.shape[0] * tangents.shape[1], tangents.shape[2])
    matrix = np.stack([c.direction.ravel() for c in candidates], axis=1)
    inner = flat.T @ flat + np.eye(flat.shape[1])
    matrix = matrix - flat @ np.linalg.solve(inner, flat.T @ matrix)
    norm = np.linalg.norm(matrix, axis=0)
    matrix = matrix[:, norm > 0] / norm[norm > 0]
    if not matrix.shape[1]:
        return np.inf
    correlation = matrix.T @ matrix
    values, vectors = np.linalg.eigh(correlation)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    scores = rng.standard_normal((draws, root.shape[1])) @ root.T
    return float(overdispersion * np.quantile((scores**2).max(axis=1), quantile))


def round_of_search(
    problem: Problem,
    base: Hypothesis,
    named: frozenset[Key],
    floor_fit: Fit,
    chosen: np.ndarray,
    rng: np.random.Generator,
    progress: Progress,
    onset: np.ndarray | None = None,
) -> Stage:
    """Looks for one more effect on top of those that are named already.

    Args:
        problem: What is fitted.
        base: Where screening starts: nominal nuisances in the first round, since nuisances that
            were pulled by a missing effect would mislead; the last fit in later rounds.
        named: Effects that are free already.
        floor_fit: Best fit without a further effect.
        chosen: Windows of screening and rough fits.
        rng: For the null.
        progress: Called with what is being done.
        onset: Time at which what is looked for begins, shape (recordings,); None: throughout.
    """
    nuisances = problem.active_nuisances(set(named))
    residual = problem.residual(base, chosen)
    progress("tangents of the nuisance parameters")
    tangents = problem.tangents(base, residual, chosen, nuisances)
    progress("screening")
    own = free_tangents(problem, base, named, residual, chosen)
    fitted_base = floor_fit.hypothesis
    floor = problem.cost(
        residual if fitted_base is base else problem.residual(fitted_base, chosen),
        problem.prior_cost(fitted_base, set(named)),
    )
    candidates = screen(
        problem,
        base,
        residual,
        tangents,
        nuisances,
        own,
        chosen,
        floor,
        skip=named,
        onset=onset,
    )
    settled = float(np.median(np.mean(floor_fit.residual**2, axis=1)))
    threshold = chance_gain(candidates, tangents, float(np.clip(settled, 1.0, 2.0)), rng)
    rough: list[tuple[Key, Fit]] = []
    hope = _HOPE * problem.size * chosen.sum()
    promising = candidates[:_REFITTED] if candidates and candidates[0].gain > hope else []
    for candidate in promising:
        progress(f"fitting {candidate.key[0]}")

        def fitted(start: Hypothesis, candidate: Candidate = candidate) -> Fit:
            start = start.with_values(candidate.key, candidate.values)
            start = start.with_onset(candidate.key, onset)
            free = named | {candidate.key}
            return refit(problem, start, free, chosen, tangents, nuisances, iterations=4)

        fit = fitted(base)
        if fit.cost > _STUCK * floor and fitted_base is not base:
            # Worse than without the effect: the nuisances are far from where they belong.
            fit = min(fit, fitted(fitted_base), key=lambda f: f.cost)
        rough.append((candidate.key, fit))
    rough.sort(key=lambda entry: entry[1].cost)
    contenders = []
    if rough:
        progress("start states and time step about the best fit")
        problem.rewhiten(rough[0][1].hypothesis)
        lead = np.inf
        for key, fit in rough[:_SHARPENED]:
            excess = fit.cost - problem.size * chosen.sum()
            if excess > _HOPELESS * max(lead, 0.2 * problem.size * chosen.sum()):
                continue
            progress(f"sharpening {key[0]}")
            sharp = sharpen(problem, fit, chosen)
            # A rival that comes near is fitted to the end, or a tie would pass for a victory.
            for _ in range(_PATIENCE):
                near = sharp.cost < _CLOSE * problem.size * chosen.sum()
                if not near or not np.isfinite(lead):
                    break
                again = sharpen(problem, sharp, chosen)
                improved = again.cost < 0.98 * sharp.cost
                sharp = again
                if not improved:
                    break
            lead = min(lead, sharp.cost - problem.size * chosen.sum())
            contenders.append(
                Contender(key=key, fit=sharp, cost=window_cost(problem, sharp.hypothesis))
            )
    order = sorted(contenders, key=lambda c: c.fit.cost)
    return Stage(
        base=window_cost(problem, floor_fit.hypothesis),
        base_hypothesis=floor_fit.hypothesis,
        candidates=tuple(candidates),
        contenders=tuple(order),
        threshold=threshold,
    )


def sharpen(problem: Problem, fit: Fit, chosen: np.ndarray, *, iterations: int = 4) -> Fit:
    """Refits with tangents taken anew where the first fit ended."""
    nuisances = problem.active_nuisances(set(fit.free))
    residual = problem.residual(fit.hypothesis, chosen)
    tangents = problem.tangents(fit.hypothesis, residual, chosen, nuisances, _FINE)
    return refit(
        problem,
        fit.hypothesis,
        fit.free,
        chosen,
        tangents,
        nuisances,
        iterations=iterations,
        residual=residual,
        fine=_FINE,
    )


def pair_search(
    problem: Problem, stage: Stage, chosen: np.ndarray, progress: Progress
) -> tuple[Contender, Key] | None:
    """Fits the most promising two effects at once: greedy search may start with an impostor.

    Returns:
        The best pair, whose `key` is the effect that matters less, and the other effect; None
        where there are no two candidates.
    """
    base = Hypothesis()
    residual = problem.residual(base, chosen)
    tangents = problem.tangents(base, residual, chosen, problem.nuisances)
    best: tuple[Fit, frozenset[Key]] | None = None
    # The round has changed the noise model since it screened: the steps are replayed under the new
    # one. What an effect gained alone says little about what it gains beside another.
    candidates = [
        replace(c, step=problem.residual(base.with_values(c.key, c.values), chosen) - residual)
        for c in stage.candidates
        if c.detectable > 0.0
    ]
    ranked = pairs(problem, base, residual, tangents, problem.nuisances, candidates, count=_PAIRS)
    for _, start, keys in ranked:
        progress(f"fitting {' and '.join(sorted(name for name, _ in keys))}")
        fit = refit(problem, start, keys, chosen, tangents, problem.nuisances, iterations=5)
        if best is None or fit.cost < best[0].cost:
            best = fit, keys
    if best is None:
        return None
    fit, keys = best
    problem.rewhiten(fit.hypothesis)
    fit = sharpen(problem, fit, chosen)
    cost = window_cost(problem, fit.hypothesis)
    loss = {k: window_cost(problem, fit.hypothesis.without(k)).mean() for k in keys}
    less, more = sorted(keys, key=lambda k: loss[k])
    return Contender(key=less, fit=fit, cost=cost), more
