"""Challenges of a set of named effects: is each needed, and would another do as well or better?

A greedy search names what explains most at first, and an early impostor then stays beside the
effects that it stood in for. So every effect is left out, every one is swapped for what came near
it when it was named, and where a swap does as well, a further effect that it makes needless goes:
two effects that imitate one are replaced by that.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from leglab.diagnosis.effects.hypothesis import Hypothesis, Key
from leglab.diagnosis.former.directions import differs
from leglab.diagnosis.former.fitting import Fit, refit
from leglab.diagnosis.former.judging import earns, parameters, t_value
from leglab.diagnosis.former.search import Contender, Round, finished, total_cost
from leglab.diagnosis.replay.residual import Problem

# Steps of a fit with a rival in an effect's place.
_SWAPPING = 8

# By effect: the final fit, and what became of it with a rival in the effect's place.
Checks = Mapping[Key, tuple[Contender, ...]]


def challenged(
    problem: Problem, fit: Fit, named: Sequence[Key], rounds: Sequence[Round]
) -> tuple[Problem, Fit, list[Key], Checks]:
    """Drops effects that others make needless, and swaps impostors for their rivals.

    Args:
        problem: With the noise model about the fit.
        fit: With all named effects.
        named: In the order of discovery.
        rounds: Of the search, whose contenders are the rivals.

    Returns:
        The problem, with the defect of the time step that the fit has after a swap; the fit, the
        effects that stay, and their checks.
    """
    kept = list(named)
    checks: Checks = {}
    for _ in range(problem.thresholds.challenges):
        fit, kept = _needed(problem, fit, kept)
        better, checks = _swapped(problem, fit, kept, rounds)
        if better is None:
            break
        fit, kept = better
        problem = problem.with_defect_of(fit.hypothesis)
    else:
        checks = {}  # They are those of the set before.
    return problem, fit, kept, checks


def _refitted(
    problem: Problem,
    fit: Fit,
    free: frozenset[Key],
    start: Hypothesis,
    *,
    iterations: int = 3,
    alone: bool = False,
) -> Fit:
    """A fit of some effects on from a start, with what follows unless they are fitted alone."""
    at = fit.at.without([n.key for n in fit.at.nuisances]) if alone else fit.at
    return refit(problem, at, free, start=start, iterations=iterations, fine=0.3)


def with_rival(problem: Problem, fit: Fit, free: frozenset[Key], start: Hypothesis) -> Fit:
    """A fit with a rival in an effect's place, that starts from the rival's values when alone.

    The effects may have to go far first: what stood in for the rival has bent them. What follows
    stays meanwhile, or it would go with them, and the way back along what imitates them is slow: a
    heavy rotor that began with a drive 12 % weak kept 8 % of it.
    """
    effects = _refitted(problem, fit, free, start, iterations=_SWAPPING, alone=True)
    return _refitted(problem, fit, free, effects.hypothesis, iterations=_SWAPPING)


def _needless(problem: Problem, best: np.ndarray, cost: np.ndarray) -> bool:
    """Whether a fit of these costs of windows does as well as the best, though it has less."""
    worthwhile = problem.thresholds.worthwhile * max(1.0, float(cost.mean()) - 1.0)
    return float((cost - best).mean()) < worthwhile


def _needed(problem: Problem, fit: Fit, named: list[Key]) -> tuple[Fit, list[Key]]:
    """The fit without effects that can go, the least needed first."""
    while len(named) > 1:
        best = total_cost(problem, fit)
        tried = []
        for key in named:
            start = fit.hypothesis.without(key)
            without = _refitted(problem, fit, frozenset(named) - {key}, start)
            tried.append((total_cost(problem, without), without, key))
        cost, without, key = min(tried, key=lambda entry: float(entry[0].mean()))
        if not _needless(problem, best, cost):
            break
        fit, named = without, [k for k in named if k != key]
    return fit, named


def _rivals(
    problem: Problem, key: Key, named: Sequence[Key], rounds: Sequence[Round]
) -> dict[Key, np.ndarray]:
    """Rivals that cost little more than an effect when it was named, and their values there.

    All that lost to it while others were missing count, too, those that were not even finished: a
    weak drive fits a heavy rotor until both have their friction.
    """
    sets = [r for r in rounds if any(c.key == key for c in r.contenders)]
    rivals: dict[Key, np.ndarray] = {}
    for tried in sets:
        own = min(float(c.cost.mean()) for c in tried.contenders if c.key == key)
        last = key == named[-1]
        limit = problem.thresholds.near_factor * own if last else np.inf
        found = [(c.key, c.fit) for c in tried.contenders if c.cost.mean() <= limit]
        for rival, fit in [*found, *(() if last else tried.dropped)]:
            if rival not in named:
                rivals.setdefault(rival, fit.hypothesis[rival])
    return rivals


def _swapped(
    problem: Problem, fit: Fit, named: list[Key], rounds: Sequence[Round]
) -> tuple[tuple[Fit, list[Key]] | None, dict[Key, tuple[Contender, ...]]]:
    """The first swap that explains more, or as much with less; and what was tried."""
    best = total_cost(problem, fit)
    checks: dict[Key, tuple[Contender, ...]] = {}
    for key in named:
        tried = [Contender(key=key, fit=fit, cost=best)]
        for rival, values in _rivals(problem, key, named, rounds).items():
            changed = [rival if k == key else k for k in named]
            start = fit.hypothesis.without(key).with_values(rival, values)
            swapped = with_rival(problem, fit, frozenset(changed), start)
            cost = total_cost(problem, swapped)
            swap = Contender(key=rival, fit=swapped, cost=cost)
            if cost.mean() < _promising(problem, best):
                swap = finished(problem, swap)
            if not differs(problem, swap):
                continue
            if _better(problem, swap, tried[0]):
                return (swap.fit, changed), checks
            if _needless(problem, best, swap.cost):
                fewer = _freed(problem, fit, swap, changed, best)
                if fewer is not None:
                    return fewer, checks
            tried.append(swap)
        checks[key] = tuple(tried)
    return None, checks


def _better(problem: Problem, swap: Contender, own: Contender) -> bool:
    """Whether a swap explains more, or as much as a special case of what it replaces."""
    contains = problem.library.contains
    if contains(own.key, swap.key):
        return not earns(problem, own, swap)
    if contains(swap.key, own.key) and not earns(problem, swap, own):
        return False
    return t_value(own.cost - swap.cost) > problem.thresholds.significant


def _promising(problem: Problem, best: np.ndarray) -> float:
    """Cost below which a swap is fitted to the end, or a tie would pass for a victory."""
    limits = problem.thresholds
    if problem.noise.discrepancy is None:
        return limits.close_cost
    return limits.near_factor * float(best.mean())


def _freed(
    problem: Problem, own: Fit, swap: Contender, named: list[Key], best: np.ndarray
) -> tuple[Fit, list[Key]] | None:
    """The fit without the effect that a swap has made needless, if it did.

    One effect in place of two may not take more parameters than these. On a rough machine it must
    take less: a small one of two is how such a machine is made, and nothing is simpler without it.
    """
    most = parameters(problem, own) - (problem.noise.discrepancy is not None)
    for key in named:
        if key == swap.key:
            continue
        start = swap.fit.hypothesis.without(key)
        fewer = _refitted(problem, swap.fit, frozenset(named) - {key}, start)
        if parameters(problem, fewer) > most:
            continue
        if _needless(problem, best, total_cost(problem, fewer)):
            return fewer, [k for k in named if k != key]
    return None
