"""Move that refits a good set of effects from another fit, where the set is more probable."""

from collections.abc import Iterator

from leglab.diagnosis.search.pool import Pool, Proposal
from leglab.diagnosis.search.settle import Candidate
from leglab.diagnosis.thresholds import NEAR, RENEWALS


def propose(pool: Pool) -> Iterator[Proposal]:
    """Proposes to refit good sets from fits at which their evidence is larger, each once."""
    points = {id(f.columns): f for f in pool.fits}
    for r in pool.near:
        point = points[id(r.evidence.columns)]
        once = "another point", r.fit.keys, point.keys
        if r.gain > NEAR and once not in pool.done and pool.needed(r.fit, r.evidence):
            start = Candidate(r.fit.members, {}, point.columns, point.spread, point.weight)
            reason = f"it is {r.gain:.0f} nats more probable where another set was fitted"
            yield Proposal("another point", start, reason, renewals=RENEWALS, once=once)
