"""Beam search over sets of effects by the evidence of one linearisation."""

from collections.abc import Iterable

import numpy as np

from leglab.diagnosis.likelihood.evidence import Evidence, Member, Score
from leglab.diagnosis.thresholds import BEST_SETS, DEPTH, SCORED


def beam(evidence: Evidence) -> list[Score]:
    """Ranks sets of effects by evidence; of sets that differ only in jumps, keeps the best."""
    seen: dict[frozenset[Member], Score] = {}

    def score(members: Iterable[Member]) -> Score:
        key = frozenset(members)
        if key not in seen:
            seen[key] = evidence.score(
                sorted(key, key=lambda m: (m[0], -1 if m[1] is None else m[1]))
            )
        return seen[key]

    current = [score(())]
    for depth in range(DEPTH):
        found = []
        for one in current:
            for member in one.members:
                score(m for m in one.members if m != member)
            for _, member in evidence.additions(one)[: SCORED if depth else 5 * SCORED]:
                found.append(score((*one.members, member)))
        if not found:
            break
        before = max(s.log for s in current)
        # More single effects are kept, since if a pair is right, the best single one often is not.
        current = _best(found)[: BEST_SETS if depth else 3 * BEST_SETS]
        if depth and current[0].log < before:
            break
    return _best(seen.values())


def _best(scores: Iterable[Score]) -> list[Score]:
    """Sorts scores by evidence; keeps only the best of those with the same unknowns."""
    best: dict[frozenset[int], Score] = {}
    for one in sorted(scores, key=lambda s: -s.log):
        best.setdefault(frozenset(one.unknowns), one)
    return list(best.values())


def without_idle(evidence: Evidence, score: Score, lost: float) -> Score:
    """Removes parameters from a set while each removal costs at most `lost` nats of evidence."""
    while len(score.members) > 1:
        less = [evidence.score([m for m in score.members if m != one]) for one in score.members]
        best = less[int(np.argmax([s.log for s in less]))]
        if best.log < score.log - lost:
            break
        score = best
    return score
