"""Move to the sets of effects with the largest evidence by linearising the unchanged model."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from leglab.diagnosis import thresholds
from leglab.diagnosis.effects.hypothesis import Key
from leglab.diagnosis.likelihood.columns import Columns
from leglab.diagnosis.likelihood.evidence import Evidence, Score
from leglab.diagnosis.search.beam import beam, without_idle
from leglab.diagnosis.search.settle import Candidate, Fitter


def annealed(fitter: Fitter, first: Columns, kappa: float) -> tuple[Evidence, list[Score], float]:
    """Alternates between ranking sets and estimating the covariance of the best set's errors."""
    spread, weight = fitter.about(first.errors)
    last = None
    for _ in range(thresholds.ANNEALINGS):
        evidence = fitter.evidence(first, spread, weight, kappa)
        ranked = beam(evidence)
        best = ranked[0]
        left = evidence.left(best)
        spread = fitter.own_spread(left)
        weight = fitter.weights(left, spread, best.size)
        kappa = 1.0 / max(evidence.design_effect(best), 1.0)
        now = frozenset(best.unknowns), round(float(np.log(kappa)), 1)
        if now == last:
            break
        last = now
    return evidence, ranked, kappa


def candidates(evidence: Evidence, ranked: Sequence[Score]) -> list[Candidate]:
    """Returns the sets to fit, the most probable first."""
    u = evidence.unknowns
    picked: dict[frozenset[Key], Score] = {}

    nothing = next(s for s in ranked if not s.members)
    idle = thresholds.IDLE[0] + thresholds.IDLE[1] * max(ranked[0].log - nothing.log, 0.0)
    for score in ranked:
        score = without_idle(evidence, score, idle)
        near = len(picked) < thresholds.FIRST_FITS and score.log > ranked[0].log - thresholds.NEAR
        if len(picked) < thresholds.SURE_FITS or near:
            picked.setdefault(u.names(score.unknowns), score)
    for score in [s for s in ranked if len(s.members) == 1][: thresholds.SURE_FITS]:
        picked.setdefault(u.names(score.unknowns), score)
    # Best single effects without model error, because a model error may contain and hide a fault.
    widest = int(evidence.priors.usual().sum()) - 1
    shift = evidence.whole.follow(0, widest, np.eye(1, evidence.gram.shape[1])[0])
    exact = replace(evidence.score(()), size=evidence.places[0], spread=widest, shift=shift)
    for _, member in evidence.additions(exact)[: thresholds.EACH_WAY]:
        score = evidence.score((member,))
        picked.setdefault(u.names(score.unknowns), score)
    return [begun(evidence, score) for names, score in picked.items() if names]


def begun(evidence: Evidence, score: Score) -> Candidate:
    """Starts a set at the optimum that the linearisation predicts."""
    return Candidate(
        score.unknowns,
        evidence.departures(score),
        evidence.columns,
        evidence.spread,
        evidence.weight,
        score.log,
    )
