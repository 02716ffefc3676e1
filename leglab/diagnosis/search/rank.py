"""Fitted sets under each other: their evidence, and which set to fit next."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leglab.diagnosis.effects.hypothesis import Key
from leglab.diagnosis.likelihood.columns import Columns
from leglab.diagnosis.likelihood.evidence import Evidence, Score
from leglab.diagnosis.likelihood.spread import Spread
from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.search.settle import Fit, Fitter

# A set within so many nats of the best one is fitted; of one that is this many times further
# behind nothing is hoped for.
NEAR, BEHIND = 10.0, 3.0
# Sets whose errors say how the model errs; and whose additions are looked at, so many of each.
PATTERNS, HOPEFUL, ADDITIONS, SWAPS = 3, 6, 6, 4
# Members of a set.
LARGEST = 7


@dataclass(frozen=True, eq=False)
class Ranked:
    """A fitted set where it is most probable.

    Attributes:
        fit: The fit.
        evidence: At its own linearisation, or at another's.
        score: Of the set there.
    """

    fit: Fit
    evidence: Evidence
    score: Score


@dataclass(frozen=True, eq=False)
class Proposal:
    """A set to fit.

    Attributes:
        members: Its unknowns.
        start: By how much unknowns move from where the fit begins.
        columns: Linearisation there.
        spread: Pattern of the model's own error at first.
        weight: Of windows at first.
        promise: Log evidence that first order promises.
    """

    members: tuple[int, ...]
    start: Mapping[int, float]
    columns: Columns
    spread: Spread
    weight: np.ndarray
    promise: float = np.inf


def rank(fitter: Fitter, fits: Sequence[Fit], kappa: float) -> list[Ranked]:
    """Sets by evidence, best first; of several fits of a set the best.

    The pattern of the model's own error is not known either: each set counts with the one that
    makes it most probable, of its own and those of the sets that leave least; and at the point, its
    own or another's, where it does best: a larger set is never worse than one that it holds.
    """
    near = sorted(fits, key=lambda f: f.level)[:PATTERNS]
    weight = near[0].weight
    kept: dict[tuple[int, int], Evidence] = {}

    def evidence(at: Fit, spread: Spread) -> Evidence:
        key = id(at), id(spread)
        if key not in kept:
            kept[key] = fitter.evidence(at.columns, spread, weight, kappa)
        return kept[key]

    rows = []
    for fit in fits:
        members = [(q, None) for q in fit.members]
        own = [fit.spread, *(f.spread for f in near if f is not fit)]
        tries = [evidence(fit, spread) for spread in ([fitter.fixed] if fitter.fixed else own)]
        tries += [
            evidence(other, fitter.fixed or other.spread)
            for other in near
            if other is not fit
            and other.level <= fit.level
            and all(np.abs(other.columns.tangents[:, :, q]).max() > 0 for q in fit.members)
        ]
        scored = [(there, there.score(members)) for there in tries]
        rows.append(Ranked(fit, *max(scored, key=lambda entry: entry[1].log)))
    best: dict[frozenset[Key], Ranked] = {}
    for row in sorted(rows, key=lambda r: -r.score.log):
        best.setdefault(row.fit.keys, row)
    return list(best.values())


def proposal(
    fitter: Fitter, ranks: Sequence[Ranked], tried: set[frozenset[Key]]
) -> Proposal | None:
    """The next set to fit; None where nothing promises to come near the best one.

    Each member of the best set is left out once, whatever first order promises; then what adds a
    member to a good set, swaps one of the best set's, or says the same of both directions.
    """
    u = fitter.at.unknowns
    sound = [r for r in ranks if not r.fit.ended] or list(ranks)
    best, top = sound[0].fit, ranks[0].score.log

    def keys(members: Sequence[int]) -> frozenset[Key]:
        return frozenset(u.keys[q] for q in members)

    def of(fit: Fit, evidence: Evidence, members: tuple[int, ...], promise: float) -> Proposal:
        score = evidence.score([(q, None) for q in members])
        start = evidence.departures(score)
        return Proposal(members, start, fit.columns, fit.spread, fit.weight, promise)

    def there(fit: Fit) -> Evidence:
        own = (r.evidence for r in ranks if r.evidence.columns is fit.columns)
        kappa = ranks[0].evidence.kappa
        known = next(own, None)
        return known or fitter.evidence(fit.columns, fit.spread, fit.weight, kappa)

    for one in best.members if len(best.keys) > 1 else ():
        rest = tuple(q for q in best.members if u.keys[q] != u.keys[one])
        if keys(rest) not in tried:
            return of(best, there(best), rest, np.inf)
    found: list[tuple[float, tuple[int, ...], Fit, Evidence]] = []
    for row in sound[:HOPEFUL]:
        fit, evidence = row.fit, there(row.fit)
        score = evidence.score([(q, None) for q in fit.members])
        if score.log < top - BEHIND * NEAR:
            continue
        for gain, (q, _) in evidence.additions(score)[:ADDITIONS]:
            if gain > 0.0:
                found.append((score.log + gain, (*fit.members, q), fit, evidence))
        for one in fit.members if fit is best else ():
            rest = tuple(q for q in fit.members if q != one)
            left = evidence.score([(q, None) for q in rest])
            swaps = [
                (left.log + gain, (*rest, q), fit, evidence)
                for gain, (q, _) in evidence.additions(left)[:SWAPS]
                if q != one
            ]
            found += [(left.log, rest, fit, evidence), *swaps]
    found = [
        (promise, members, fit, evidence)
        for promise, members, fit, evidence in found
        if promise >= top - NEAR and len(members) <= LARGEST and keys(members) not in tried
    ]
    for row in sound[:HOPEFUL]:
        simpler = both_ways(u, row.fit)
        if simpler is not None and keys(tuple(simpler)) not in tried:
            x, fit = row.fit.columns.x, row.fit
            start = {q: -float(x[q]) for q in fit.members if q not in simpler}
            start |= {q: value - float(x[q]) for q, value in simpler.items()}
            return Proposal(tuple(simpler), start, fit.columns, fit.spread, fit.weight)
    if not found:
        return None
    promise, members, fit, evidence = max(found, key=lambda entry: entry[0])
    return of(fit, evidence, members, promise)


def both_ways(u: Unknowns, fit: Fit) -> dict[int, float] | None:
    """The set with an effect by direction replaced by the same one in both directions.

    Returns:
        Departures of its members; None where the set has no such effect.
    """
    x, sites = fit.columns.x, u.library.sites
    for q in fit.members:
        key, place = u.places[q][0]
        for pair in u.effect(q).by_direction:
            both = [i for i in fit.members if u.places[i][0][0] == key and u.name(i) in pair]
            if len(both) < 2 or q not in both:
                continue
            unit = sites[key].parameters[place].unit
            mean = float(np.mean([x[i] * u.scale[i] for i in both]))
            for i in range(u.single):
                other, j = u.places[i][0]
                alike = other != key and u.library.contains(key, other) and u.nameable[i]
                if alike and sites[other].parameters[j].unit == unit:
                    kept = {m: float(x[m]) for m in fit.members if m not in both}
                    return {**kept, i: mean / u.scale[i]}
    return None
