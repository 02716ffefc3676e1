"""Screening: what each effect would gain at a few sizes, nuisances following to first order."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from leglab.diagnosis.balance.forces import forces_left
from leglab.diagnosis.effects.base import Effect
from leglab.diagnosis.effects.hypothesis import Hypothesis, Key, Site
from leglab.diagnosis.former.fitting import FreeTangents, Sums, Unknowns, profiled
from leglab.diagnosis.former.nuisances import departures
from leglab.diagnosis.plant.model import ForceLeft
from leglab.diagnosis.replay.residual import Linearisation, Problem


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """Best size of an effect in the screening.

    Attributes:
        key: Effect and element.
        values: Of its parameters, where a refit starts.
        gain: Cost saved against the baseline; chi-square units.
        direction: Whitened change of the errors by its smallest trial, (chosen windows, size).
        step: The same by `values`.
        detectable: Norm of that direction, beyond what nuisances imitate: below some 5 the trial
            size could not be told from noise.
    """

    key: Key
    values: np.ndarray
    gain: float
    direction: np.ndarray
    step: np.ndarray
    detectable: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """Values of an effect that were replayed; as those of its `Candidate`."""

    values: np.ndarray
    gain: float
    step: np.ndarray


def screen(
    problem: Problem,
    at: Linearisation,
    named: FreeTangents,
    floor: float,
    *,
    skip: frozenset[Key] = frozenset(),
    onset: np.ndarray | None = None,
    started_best: bool = False,
) -> list[Candidate]:
    """Tries every effect of the library on top of a baseline, best first.

    Args:
        problem: Recordings and machine.
        at: Baseline.
        named: Tangents of the effects that the baseline has already, which follow as well.
        floor: Cost of the best fit without a further effect, which gains are counted from.
        skip: Effects that the baseline has already.
        onset: Time at which the effect begins, shape (recordings,); None: throughout.
        started_best: Whether the baseline is that best fit.
    """
    # Steps of the nuisances alone are no effect's gain; where screening does not start from the
    # best fit, they say to first order what that costs.
    alone = profiled(problem, at, named)[1]
    floor = alone if started_best else max(floor, alone)
    searched = problem.library.searched - skip
    sites = {k: s for k, s in problem.library.sites.items() if k in searched and s.trials()}
    guessing = [s for s in sites.values() if type(s.effect).guesses is not Effect.guesses]
    left = forces_left(problem, at.base) if guessing else {}
    guesses = {s.key: _guesses(problem, s, left) for s in guessing}
    found = [
        _screened(problem, at.without({key}), named, floor, site, guesses.get(key, []), onset)
        for key, site in sites.items()
    ]
    return sorted(found, key=lambda c: -c.gain)


def _screened(
    problem: Problem,
    at: Linearisation,
    named: FreeTangents,
    floor: float,
    site: Site,
    guesses: list[np.ndarray],
    onset: np.ndarray | None,
) -> Candidate:
    """Best size of one effect; `at` is without its nuisances."""

    def tried(values: np.ndarray) -> Trial:
        moved = at.base.changed(site.key, values, onset)
        step = problem.residual(moved, at.chosen) - at.residual
        _, cost = profiled(problem, replace(at, residual=at.residual + step), named)
        return Trial(values=values, gain=floor - cost, step=step)

    now = at.base.get(site.key, site.nominal)
    scales = np.array([p.scale for p in site.parameters])
    values = [*(guesses or site.trials()), *_further_on(problem, site, now)]
    trials = [tried(one) for one in values]
    sizes = [np.abs(trial.values - now) / scales for trial in trials]
    smallest = trials[int(np.argmin([size.max() for size in sizes]))]
    # The best trial of every strength, to each side: one that goes too far on the right side may do
    # worse than a small one on the wrong side.
    leaders: dict[tuple[int, float], Trial] = {}
    for size, trial in zip(sizes, trials, strict=True):
        strength = int(np.argmax(size))
        way = strength, float(np.sign(trial.values[strength] - now[strength]))
        if way not in leaders or trial.gain > leaders[way].gain:
            leaders[way] = trial
    # Strengths together, and sizes between and beyond the trials, to first order; the
    # prediction is believed after a replay only.
    together = _combined(problem, at, named, list(leaders.values()), site)
    if together is not None:
        trials.append(tried(together))
    best = max(trials, key=lambda trial: trial.gain)
    known = np.concatenate([named.columns, at.tangents], axis=2)
    return Candidate(
        key=site.key,
        values=best.values,
        gain=best.gain,
        direction=smallest.step,
        step=best.step,
        detectable=float(np.linalg.norm(beyond_tangents(smallest.step.ravel()[:, None], known))),
    )


def _combined(
    problem: Problem, at: Linearisation, named: FreeTangents, leaders: list[Trial], site: Site
) -> np.ndarray | None:
    """Values to try next: multiples of the best trials that fit best to first order."""
    now = at.base.get(site.key, site.nominal)
    steps = np.stack([trial.step for trial in leaders], axis=2)
    furthest = np.full(len(leaders), problem.thresholds.furthest)
    differences = [trial.values - now for trial in leaders]
    backward = np.array([_backward(site, d) for d in differences])
    own = FreeTangents(
        columns=np.concatenate([named.columns, steps], axis=2),
        lower=np.concatenate([named.lower, -np.minimum(backward, furthest)]),
        upper=np.concatenate([named.upper, furthest]),
    )
    shares = profiled(problem, at, own)[0][named.lower.size :]
    values = now + sum(share * d for share, d in zip(shares, differences, strict=True))
    # Shapes of different trials do not add up: that of the best one stays.
    best = max(leaders, key=lambda trial: trial.gain).values
    values = np.where([p.role == "shape" for p in site.parameters], best, values)
    values = np.clip(values, site.lower, site.upper)
    near = any(
        np.allclose(values - now, d, rtol=0.15, atol=0.05 * abs(d).max()) for d in differences
    )
    return None if near or np.allclose(values, now) else values


def _guesses(problem: Problem, site: Site, left: Mapping[str, ForceLeft]) -> list[np.ndarray]:
    """Values that an effect guesses from the force left over on its joint, within its bounds."""
    if site.element not in left:
        return []
    found = site.effect.guesses(problem.machine, site.element, left[site.element])
    rows = [np.array([values[p.name] for p in site.parameters]) for values in found]
    return [np.clip(row, site.lower, site.upper) for row in rows]


def _further_on(problem: Problem, site: Site, now: np.ndarray) -> list[np.ndarray]:
    """Twice as far as a rough machine's baseline has gone with an effect that follows every fit.

    The trials lie about nominal, and a fault whose prior holds it half-way there may be beyond all.
    """
    if problem.worth is None or np.allclose(now, site.nominal):
        return []
    return [np.clip(2.0 * now - site.nominal, site.lower, site.upper)]


def _backward(site: Site, difference: np.ndarray) -> float:
    """Multiples of a trial that its bounds allow to the other side, 0 where that has trials too."""
    i = int(np.argmax(np.abs(difference) / [p.scale for p in site.parameters]))
    parameter, side = site.parameters[i], np.sign(difference[i])
    if any(side * (trial - parameter.nominal) < 0.0 for trial in parameter.trials):
        return 0.0
    now = site.nominal[i]
    room = now - parameter.lower if side > 0 else parameter.upper - now
    return float(room / abs(difference[i])) if difference[i] else 0.0


def beyond_tangents(directions: np.ndarray, tangents: np.ndarray) -> np.ndarray:
    """The part of directions that nuisances, under their priors, cannot imitate.

    Args:
        directions: Shape (chosen windows x size, directions).
        tangents: Of the nuisances, shape (chosen windows, size, nuisances).
    """
    flat = tangents.reshape(len(directions), tangents.shape[2])
    inner = flat.T @ flat + np.eye(flat.shape[1])
    return directions - flat @ np.linalg.solve(inner, flat.T @ directions)


def pairs(
    problem: Problem, at: Linearisation, candidates: Sequence[Candidate]
) -> list[tuple[Hypothesis, frozenset[Key]]]:
    """Two effects at once, to first order in the steps that screening found, best first.

    Returns:
        Where a refit starts, and the two effects, of all pairs.
    """
    if len(candidates) < 2:
        return []
    limits = problem.thresholds
    steps = np.stack([c.step for c in candidates], axis=2)
    sums = Sums.of(at.residual, np.concatenate([steps, at.tangents], axis=2), limits)
    away = departures(at.base, at.nuisances)
    weight = problem.prior_weight(at.chosen)
    found = []
    for places in combinations(range(len(candidates)), 2):
        both = [candidates[i] for i in places]
        keys = frozenset(c.key for c in both)
        kept = [i for i, n in enumerate(at.nuisances) if n.key not in keys]
        part = sums.only([*places, *(len(candidates) + i for i in kept)])
        furthest = np.full(2, limits.pair_furthest)
        unknowns = Unknowns.of(np.zeros(2), furthest, away[kept], limits.nuisance_box, weight)
        step = part.step(unknowns)
        cost = part.cost(step) + float((unknowns.prior * (unknowns.now + step) ** 2).sum())
        start = at.base
        for share, candidate in zip(step[:2], both, strict=True):
            site = problem.library.sites[candidate.key]
            nominal = at.base.get(candidate.key, site.nominal)
            values = nominal + share * (candidate.values - nominal)
            start = start.with_values(candidate.key, np.clip(values, site.lower, site.upper))
        found.append((cost, start, keys))
    found.sort(key=lambda entry: entry[0])
    return [(start, keys) for _, start, keys in found]
