"""Move that removes each effect from the best set, so that its smaller rivals are fitted."""

from collections.abc import Iterator

from leglab.diagnosis.search.pool import Pool, Proposal
from leglab.diagnosis.search.settle import Candidate


def propose(pool: Pool) -> Iterator[Proposal]:
    """Proposes the best set without each of its effects, each once."""
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
