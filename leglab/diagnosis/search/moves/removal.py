"""Takes each effect out of the best set: what does without it is its rival."""

from collections.abc import Iterator

from leglab.diagnosis.search.pool import Pool, Proposal
from leglab.diagnosis.search.settle import Candidate


def propose(pool: Pool) -> Iterator[Proposal]:
    """The best set without each of its effects, from where it was fitted."""
    best, keys = pool.best.fit, pool.scene.fitter.at.unknowns.keys
    if len(best.keys) < 2:
        return
    for out in sorted(best.keys):
        once = "removal", best, out
        if once in pool.done or (columns := pool.scene.without(best, out)) is None:
            continue
        rest = tuple(q for q in best.members if keys[q] != out)
        start = Candidate(rest, {}, columns, best.spread, best.weight)
        yield Proposal("removal", start, f"the best set without {out[0]}", once=once, late=True)
