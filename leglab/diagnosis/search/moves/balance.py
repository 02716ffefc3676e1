"""Move to sets of effects that explain the residual forces along the measured motion."""

import numpy as np

from leglab.diagnosis import thresholds
from leglab.diagnosis.likelihood.evidence import Evidence
from leglab.diagnosis.search.regression import Balanced
from leglab.diagnosis.search.settle import Candidate


def candidates(evidence: Evidence, found: dict[str, list[Balanced]]) -> list[Candidate]:
    """Unites the best sets of all joints, by number of effects; if there is one joint, adds all."""
    seeds: dict[frozenset[int], dict[int, float]] = {}
    joined: dict[int, dict[int, float]] = {}
    for sets in found.values():
        gaining = [one for one in sets if one.gain > 0.0]
        if len(found) == 1:
            seeds |= {frozenset(one.start): one.start for one in gaining}
        for count in {len(one.start) for one in gaining}:
            best = next(one for one in gaining if len(one.start) <= count)
            joined.setdefault(count, {}).update(best.start)
    for start in joined.values():
        if len(start) <= thresholds.LARGEST_SET:
            seeds.setdefault(frozenset(start), start)
    columns, spread, weight = evidence.columns, evidence.spread, evidence.weight
    return [
        Candidate(tuple(start), start, columns, spread, weight, -np.inf) for start in seeds.values()
    ]
