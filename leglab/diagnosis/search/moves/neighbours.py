"""Move to sets that add, remove or replace one effect of a good set."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from leglab.diagnosis.likelihood.evidence import Evidence, Score
from leglab.diagnosis.search.pool import Pool, Proposal
from leglab.diagnosis.search.settle import Candidate, Fit
from leglab.diagnosis.thresholds import BEHIND, BEST_SETS, LARGEST_SET, NEAR, SCORED


@dataclass(frozen=True, eq=False)
class Neighbour:
    """A set that differs from a fitted set by one effect, scored by the tangents of the fit."""

    score: Score
    fit: Fit
    evidence: Evidence


def propose(pool: Pool) -> Iterator[Proposal]:
    """Proposes the most probable neighbour that has not been fitted."""
    if pool.exhausted:
        return
    top = pool.sound[0].score.log
    found = [
        one
        for one in neighbours(pool)
        if one.score.log >= top + pool.scene.aim.ahead
        and 0 < len(one.score.members) <= LARGEST_SET
        and not pool.knows(frozenset(one.score.unknowns))
    ]
    if not found:
        return
    best = max(found, key=lambda one: one.score.log)
    score, fit, evidence = best.score, best.fit, best.evidence
    start = evidence.departures(score)
    new = Candidate(score.unknowns, start, evidence.columns, fit.spread, fit.weight, score.log)
    reason = f"tangents promise {score.log - top:+.0f} nats over the best set"
    yield Proposal("neighbours", new, reason, beside=False, late=True)


def neighbours(pool: Pool) -> list[Neighbour]:
    """Scores neighbours of the best sets, and of sets at a bound after an effect is removed."""
    fitter, scene, kappa = pool.scene.fitter, pool.scene, pool.ranks[0].evidence.kappa
    u, sound = fitter.at.unknowns, pool.sound
    best, top = sound[0].fit, sound[0].score.log
    found: list[Neighbour] = []

    def add(evidence: Evidence, members: Sequence[int], fit: Fit, least: float = -np.inf) -> None:
        score = evidence.score([(q, None) for q in members])
        found.append(Neighbour(score, fit, evidence))
        for _, new in evidence.additions(score)[: 2 * SCORED]:
            larger = evidence.score([*score.members, new])
            if larger.log > score.log + least:
                found.append(Neighbour(larger, fit, evidence))

    for row in [r for r in sound[:BEST_SETS] if r.score.log > top - BEHIND * NEAR]:
        own = (r.evidence for r in pool.ranks if r.evidence.columns is row.fit.columns)
        there = next(own, None) or fitter.evidence(
            row.fit.columns, row.fit.spread, row.fit.weight, kappa
        )
        add(there, row.fit.members, row.fit, 0.0)
    if (beside := scene.with_limits(best)).jumps:
        add(fitter.evidence(beside, best.spread, best.weight, kappa), best.members, best, 0.0)
    for row in [r for r in pool.ranks[:BEST_SETS] if r.fit is best or r.fit.ended]:
        fit = row.fit
        out = fit.members if fit is best else fit.ended
        for key in dict.fromkeys(u.keys[q] for q in out):
            if (columns := scene.without(fit, key)) is not None:
                rest = [q for q in fit.members if u.keys[q] != key]
                add(fitter.evidence(columns, fit.spread, fit.weight, kappa), rest, fit)
    return found
