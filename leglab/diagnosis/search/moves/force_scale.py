"""Move to sets of effects with the motion of a good set and all forces scaled by one factor."""

from collections.abc import Iterator

from leglab.diagnosis.likelihood.twins import scale_twins
from leglab.diagnosis.search.pool import Pool, Proposal
from leglab.diagnosis.search.settle import Candidate
from leglab.diagnosis.thresholds import RENEWALS


def propose(pool: Pool) -> Iterator[Proposal]:
    """Proposes good sets with all forces scaled (`scale_twins`), if no drive's gain is known."""
    fitter = pool.scene.fitter
    problem, u = fitter.at.problem, fitter.at.unknowns
    for fit in [r.fit for r in pool.near]:
        twins = scale_twins(problem, u, pool.scene.forces, fit.members, fit.columns.x)
        for members, moves in twins:
            if frozenset(members) not in pool.tried:
                start = Candidate(members, moves, fit.columns, fit.spread, fit.weight)
                reason = "it is the same motion with all forces scaled"
                yield Proposal("force scale", start, reason, renewals=RENEWALS)
