"""Screening: what each effect would gain at a few sizes, nuisances following to first order."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from leglab.diagnosis.fitting import BOX, FreeTangents, Sums, departures, profiled, profiled_step
from leglab.diagnosis.hypothesis import Hypothesis, Key, Site
from leglab.diagnosis.residual import Nuisance, Problem

# First-order steps go this many times as far as a trial.
_FURTHEST = 20.0
_PAIR_FURTHEST = 3.0


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


def screen(
    problem: Problem,
    base: Hypothesis,
    residual: np.ndarray,
    tangents: np.ndarray,
    nuisances: Sequence[Nuisance],
    named: FreeTangents,
    chosen: np.ndarray,
    floor: float,
    *,
    skip: frozenset[Key] = frozenset(),
    onset: np.ndarray | None = None,
) -> list[Candidate]:
    """Tries every effect of the library on top of `base`, best first.

    Args:
        problem: What is fitted.
        base: Baseline.
        residual: Its whitened errors, shape (chosen windows, size).
        tangents: Of the nuisances at the baseline, shape (chosen windows, size, nuisances).
        nuisances: Those of the columns.
        named: Of the effects that the baseline has already, which follow as well.
        chosen: Mask of windows.
        floor: Cost of the best fit without a further effect, which gains are counted from.
        skip: Effects that the baseline has already.
        onset: Time at which what is looked for begins, shape (recordings,); None: throughout.
    """
    found = []
    # Where screening does not start from the best fit, that is counted to first order as well.
    floor = max(floor, profiled(problem, base, residual, tangents, nuisances, named))
    for key, site in problem.library.sites.items():
        if key in skip:
            continue
        own = [i for i, n in enumerate(nuisances) if n.key != key]
        others = [nuisances[i] for i in own]
        space = tangents[:, :, own]
        known = np.concatenate([named.columns, space], axis=2)
        now = base.get(key, site.nominal)
        scales = np.array([p.scale for p in site.parameters])

        def residual_at(values: np.ndarray, key: Key = key, base: Hypothesis = base) -> np.ndarray:
            moved = base.with_values(key, values).with_onset(key, onset)
            return problem.residual(moved, chosen)

        best, gain, taken = site.nominal, -np.inf, np.zeros_like(residual)
        # Of every strength: its best trial as (gain, difference, direction).
        leaders: dict[int, tuple[float, np.ndarray, np.ndarray]] = {}
        smallest: tuple[float, np.ndarray] | None = None
        for values in site.trials():
            direction = residual_at(values) - residual
            cost = profiled(problem, base, residual + direction, space, others, named)
            if floor - cost > gain:
                best, gain, taken = values, floor - cost, direction
            difference = values - now
            strength = int(np.argmax(np.abs(difference) / scales))
            if strength not in leaders or floor - cost > leaders[strength][0]:
                leaders[strength] = (floor - cost, difference, direction)
            size = float(abs(difference[strength]) / scales[strength])
            if smallest is None or size < smallest[0]:
                smallest = (size, direction)
        if smallest is None:
            continue
        # Strengths together, and sizes between and beyond the trials, to first order; the
        # prediction is believed after a replay only.
        step = _combined(
            problem, base, residual, space, others, named, list(leaders.values()), site, now
        )
        if step is not None:
            direction = residual_at(step) - residual
            cost = profiled(problem, base, residual + direction, space, others, named)
            if floor - cost > gain:
                best, gain, taken = step, floor - cost, direction
        unit = _orthogonal(smallest[1], known)
        found.append(
            Candidate(
                key=key,
                values=best,
                gain=gain,
                direction=smallest[1],
                step=taken,
                detectable=float(np.sqrt((unit**2).sum())),
            )
        )
    return sorted(found, key=lambda c: -c.gain)


def pairs(
    problem: Problem,
    base: Hypothesis,
    residual: np.ndarray,
    tangents: np.ndarray,
    nuisances: Sequence[Nuisance],
    candidates: Sequence[Candidate],
    *,
    count: int,
) -> list[tuple[float, Hypothesis, frozenset[Key]]]:
    """Two effects at once, to first order in the steps that screening found, best first.

    Returns:
        Predicted cost, where a refit starts, and the two effects, of the best `count` pairs.
    """
    steps = np.stack([c.step for c in candidates], axis=2)
    sums = Sums.of(residual, np.concatenate([steps, tangents], axis=2))
    away = departures(problem, base, nuisances)
    found = []
    for one, other in combinations(range(len(candidates)), 2):
        keys = candidates[one].key, candidates[other].key
        kept = [i for i, n in enumerate(nuisances) if n.key not in keys]
        now = np.concatenate([np.zeros(2), away[kept]])
        own = np.arange(now.size) < 2
        part = sums.only([one, other, *(len(candidates) + i for i in kept)])
        step = part.step(
            now,
            np.where(own, 0.0, 1.0),
            np.where(own, 0.0, -BOX - now),
            np.where(own, _PAIR_FURTHEST, BOX - now),
        )
        cost = part.cost(step) + float(((now + step)[2:] ** 2).sum())
        start = base
        for share, candidate in zip(step[:2], (candidates[one], candidates[other]), strict=True):
            site = problem.library.sites[candidate.key]
            nominal = base.get(candidate.key, site.nominal)
            values = nominal + share * (candidate.values - nominal)
            start = start.with_values(candidate.key, np.clip(values, site.lower, site.upper))
        found.append((cost, start, frozenset(keys)))
    return sorted(found, key=lambda entry: entry[0])[:count]


def _combined(
    problem: Problem,
    base: Hypothesis,
    residual: np.ndarray,
    space: np.ndarray,
    others: Sequence[Nuisance],
    named: FreeTangents,
    leaders: list[tuple[float, np.ndarray, np.ndarray]],
    site: Site,
    now: np.ndarray,
) -> np.ndarray | None:
    """Values to try next: multiples of the best trials that fit best to first order."""
    count = named.columns.shape[2]
    columns = np.stack([direction for _, _, direction in leaders], axis=2)
    own = FreeTangents(
        columns=np.concatenate([named.columns, columns], axis=2),
        lower=np.concatenate([named.lower, np.zeros(len(leaders))]),
        upper=np.concatenate([named.upper, np.full(len(leaders), _FURTHEST)]),
    )
    shares = profiled_step(problem, base, residual, space, others, own)[count:]
    values = now + sum(
        share * difference for share, (_, difference, _) in zip(shares, leaders, strict=True)
    )
    values = np.clip(values, site.lower, site.upper)
    near = any(
        np.allclose(values, now + d, rtol=0.15, atol=0.05 * abs(d).max()) for _, d, _ in leaders
    )
    return None if near or np.allclose(values, now) else values


def _orthogonal(direction: np.ndarray, tangents: np.ndarray) -> np.ndarray:
    """The part of a direction that nuisances, under their priors, cannot imitate."""
    flat = tangents.reshape(tangents.shape[0] * tangents.shape[1], tangents.shape[2])
    matrix = flat.T @ flat + np.eye(flat.shape[1])
    share = np.linalg.solve(matrix, flat.T @ direction.ravel())
    return direction - (flat @ share).reshape(direction.shape)
