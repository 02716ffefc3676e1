"""Whether an effect that says two directions differ shows that they do."""

from collections.abc import Sequence

import numpy as np

from leglab.diagnosis.effects.hypothesis import Key, Site
from leglab.diagnosis.former.evidence import posterior
from leglab.diagnosis.former.fitting import Fit, refit
from leglab.diagnosis.former.search import Contender, total_cost
from leglab.diagnosis.replay.residual import Problem

# Steps of a fit whose directions depart alike.
_STEPS = 6
# Names of a constant force, and of friction without directions by what its parameters begin with.
_PUSH = "force_offset"
_FRICTION = {"viscous": "viscous_friction", "coulomb": "coulomb_friction"}


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


def pushed_instead(problem: Problem, fit: Fit, key: Key) -> tuple[tuple[str, ...], float]:
    """Whether directions that are alike, and a constant force, do as well as ones that differ.

    While a joint slides, dry friction that differs by direction is one that does not and a constant
    force: at rest, and in what grows with the speed, they are told apart.

    Args:
        problem: Of a rough machine.
        fit: With the effect.
        key: The effect.

    Returns:
        Names of what is there instead, and how many times as probable it is as the effect, by its
        error and its parameters. None and 0 for an effect that says nothing of directions, and
        where the library has no constant force.
    """
    sites, limit = problem.library.sites, problem.thresholds.noticeable
    site = sites[key]
    push = (_PUSH, problem.machine.driven.get(key[1], (key[1],))[0])
    if not site.effect.by_direction or push not in sites:
        return (), 0.0
    same = _alike(problem, fit, key, beside=push)
    costs = [float(total_cost(problem, one).mean()) for one in (fit, same)]
    rest = sum(sites[k].used(fit.hypothesis[k], limit) for k in fit.free - {key})
    values = same.hypothesis[key]
    # A further number is each pair of directions that differs, or the force.
    further = (_differing_pairs(site, fit.hypothesis[key], limit), int(push not in fit.free))
    counts = [
        rest + more + site.used(one.hypothesis[key], limit, alike=True)
        for one, more in zip((fit, same), further, strict=True)
    ]
    own, other = posterior(costs, problem.numbers, counts).tolist()
    kinds = {
        _FRICTION[p.name.partition("_")[0]]
        for p, v, n in zip(site.parameters, values, site.nominal, strict=True)
        if p.departure(float(v), float(n)) > limit
    }
    names = tuple(n for n in sorted({*kinds, _PUSH}) if n in problem.library.names)
    return names, other / max(own, 1e-300)


def _differing_pairs(site: Site, values: np.ndarray, noticeable: float) -> int:
    """Pairs of parameters whose directions differ by this share of the smallest trial."""
    scaled = {
        p.name: value / p.scale for p, value in zip(site.parameters, values.tolist(), strict=True)
    }
    return sum(abs(scaled[a] - scaled[b]) > noticeable for a, b in site.effect.by_direction)


def _alike(problem: Problem, fit: Fit, key: Key, beside: Key | None = None) -> Fit:
    """The fit with both directions of an effect departing from nominal by the same amounts.

    With a further effect `beside`, if there is one.
    """
    site = problem.library.sites[key]
    moves = site.alike
    departed = moves.T @ (fit.hypothesis[key] - site.nominal) / moves.sum(axis=0)
    start = fit.hypothesis.with_values(key, site.nominal + moves @ departed)
    free, steps = fit.free, _STEPS
    if beside is not None:
        now = start.get(beside, problem.library.sites[beside].nominal)
        start, free, steps = start.with_values(beside, now), free | {beside}, 2 * _STEPS
    fine = problem.thresholds.fine_differences
    return refit(problem, fit.at, free, start=start, iterations=steps, fine=fine, alike=(key,))
