"""Move that replaces a direction-dependent effect by the symmetric effect."""

from collections.abc import Iterator, Sequence

import numpy as np

from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.search.pool import Pool, Proposal
from leglab.diagnosis.search.settle import Candidate
from leglab.diagnosis.thresholds import BEHIND, NEAR


def propose(pool: Pool) -> Iterator[Proposal]:
    """Proposes good sets with the symmetric effect in place of a direction-dependent one."""
    if pool.exhausted:
        return
    u = pool.scene.fitter.at.unknowns
    sound = pool.sound
    levels = {r.fit.keys: r.fit.level for r in pool.ranks}
    for row in [r for r in sound if r.score.log > sound[0].score.log - BEHIND * NEAR]:
        fit, x = row.fit, row.fit.columns.x
        simpler = both_ways(u, fit.members, x[list(fit.members)].tolist())
        if simpler is None:
            continue
        once = frozenset(simpler) | frozenset(fit.members)
        if not pool.knows(once) and fit.level < levels.get(u.names(simpler), np.inf):
            start = {q: -float(x[q]) for q in fit.members if q not in simpler}
            start |= {q: value - float(x[q]) for q, value in simpler.items()}
            new = Candidate(tuple(simpler), start, fit.columns, fit.spread, fit.weight)
            reason = "the parameters of both directions agree"
            yield Proposal("both ways", new, reason, beside=False, once=once, late=True)


def both_ways(
    u: Unknowns, members: Sequence[int], values: Sequence[float]
) -> dict[int, float] | None:
    """Computes the departures of a set whose direction-dependent effect is made symmetric.

    Returns None for a set without a direction-dependent effect.
    """
    value = dict(zip(members, values, strict=True))
    for q in members:
        key, place = u.places[q][0]
        for pair in u.effect(q).by_direction:
            both = [i for i in members if u.places[i][0][0] == key and u.name(i) in pair]
            if len(both) < 2 or q not in both:
                continue
            mean = float(np.mean([value[i] * u.scale[i] for i in both]))
            for i in range(u.single):
                if u.effect(i).by_direction or not u.nameable[i]:
                    continue
                if factor := u.library.as_simpler((key, place), u.places[i][0]):
                    kept = {m: float(value[m]) for m in members if m not in both}
                    return {**kept, i: kept.get(i, 0.0) + factor * mean / u.scale[i]}
    return None
