"""Move that continues the unfinished fits of good sets of effects."""

from collections.abc import Iterator

from leglab.diagnosis.search.pool import Pool, Proposal
from leglab.diagnosis.search.settle import Candidate, Fit
from leglab.diagnosis.thresholds import HOPELESS, RENEWALS


def propose(pool: Pool) -> Iterator[Proposal]:
    """Proposes to continue the unfinished fits of good sets, each once.

    A fit continues from its own parameters, or from the parameters of the best finished fit if
    these give a smaller error.
    """
    most = HOPELESS * pool.least.level
    for fit in [r.fit for r in pool.near if not r.fit.finished and r.fit.level < most]:
        if fit in pool.done or not pool.needed(fit):
            continue
        where = [fit, *([pool.least] if pool.least.finished else [])]
        start = min((_from(pool, fit, point) for point in where), key=pool.scene.begins)
        reason = "it may be the best set, and its fit has not ended"
        yield Proposal("finish", start, reason, renewals=RENEWALS, finishes=fit)


def _from(pool: Pool, fit: Fit, point: Fit) -> Candidate:
    """Starts the set of `fit` at the optimum that the tangents of the fit `point` predict."""
    start: dict[int, float] = {}
    if fit is not point:
        evidence = pool.scene.fitter.evidence(point.columns, point.spread, point.weight, pool.kappa)
        start = evidence.departures(evidence.score([(q, None) for q in fit.members]))
    return Candidate(fit.members, start, point.columns, point.spread, point.weight)
