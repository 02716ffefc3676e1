"""Whether an effect that says two directions differ shows that they do."""

from collections.abc import Sequence

from leglab.diagnosis.evidence import posterior
from leglab.diagnosis.fitting import Fit, refit
from leglab.diagnosis.hypothesis import Key
from leglab.diagnosis.residual import Problem
from leglab.diagnosis.search import Contender, total_cost

# Steps of a fit whose directions depart alike.
_STEPS = 6


def differing(problem: Problem, contenders: Sequence[Contender]) -> list[Contender]:
    """Contenders without those whose directions may as well depart alike.

    Two numbers a direction follow many a law of friction, and so make up for one that is not the
    model's. Where both directions depart alike, the cause has another name.
    """
    return [c for c in contenders if differs(problem, c)]


def differs(problem: Problem, contender: Contender) -> bool:
    """Whether the directions of an effect more probably differ than not.

    True of an effect that says nothing of directions; and on an exact machine, where special cases
    of an effect that do as well take its place anyway.
    """
    key, fit = contender.key, contender.fit
    site, limit = problem.library.sites[key], problem.thresholds.noticeable
    if not site.effect.by_direction or problem.noise.discrepancy is None:
        return True
    same = _alike(problem, fit, key)
    costs = [float(cost.mean()) for cost in (contender.cost, total_cost(problem, same))]
    # Both have the same effects beside.
    counts = [
        site.used(fit.hypothesis[key], limit),
        site.used(same.hypothesis[key], limit, alike=True),
    ]
    return bool(posterior(costs, problem.numbers, counts)[0] >= 0.5)


def _alike(problem: Problem, fit: Fit, key: Key) -> Fit:
    """The fit with both directions of an effect departing from nominal by the same amounts."""
    site = problem.library.sites[key]
    moves = site.alike
    departed = moves.T @ (fit.hypothesis[key] - site.nominal) / moves.sum(axis=0)
    start = fit.hypothesis.with_values(key, site.nominal + moves @ departed)
    fine = problem.thresholds.fine_differences
    return refit(problem, fit.at, fit.free, start=start, iterations=_STEPS, fine=fine, alike=(key,))
