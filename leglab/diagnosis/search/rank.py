"""Ranking of fitted sets by their evidence at the points of several fits."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leglab.diagnosis.effects.hypothesis import Key
from leglab.diagnosis.likelihood.columns import Columns
from leglab.diagnosis.likelihood.evidence import Evidence, Score
from leglab.diagnosis.likelihood.spread import Spread
from leglab.diagnosis.search.settle import Fit, Fitter
from leglab.diagnosis.thresholds import SURE_FITS

# Memory for cached products of linearisations [bytes]: a small part of any computer's.
_MEMORY = 2e8


@dataclass(frozen=True, eq=False)
class Ranked:
    """A fitted set at the linearisation where it is most probable."""

    fit: Fit  #: The fit
    evidence: Evidence  #: At the linearisation of this fit or of another
    score: Score  #: Score of the set by this evidence
    gain: float  #: Log evidence there less that at the linearisation of the fit [nats]


class Compared:
    """Evidence of sets at linearisations; caches all scores, and products up to `_MEMORY`."""

    def __init__(self, fitter: Fitter) -> None:
        self.fitter = fitter
        self._made: dict[tuple[Columns, Spread, Fit], Evidence] = {}
        self._scores: dict[tuple[object, ...], Score] = {}

    def evidence(self, at: Fit, spread: Spread, by: Fit, kappa: float) -> Evidence:
        """Returns evidence at the fit `at`, with a model-error covariance and weights of `by`."""
        key = at.columns, spread, by
        made = self._made.pop(key, None)
        if made is None:
            made = self.fitter.evidence(at.columns, spread, by.weight, kappa)
        elif made.kappa != kappa:
            made = made.with_kappa(kappa)
        self._made[key] = made
        # Each keeps products at all sizes, and reduced ones for each spread.
        each = made.gram.nbytes * (1 + len(made.priors.spreads))
        while len(self._made) * each > _MEMORY:
            self._made.pop(next(iter(self._made)))
        return made

    def score(self, fit: Fit, at: Fit, spread: Spread, by: Fit, kappa: float) -> Score:
        """Scores the set of `fit` at the point of another; other arguments as in `evidence`."""
        key = fit.members, at.columns, spread, by, kappa
        if key not in self._scores:
            members = [(q, None) for q in fit.members]
            self._scores[key] = self.evidence(at, spread, by, kappa).score(members)
        return self._scores[key]


def rank(compared: Compared, fits: Sequence[Fit], kappa: float) -> list[Ranked]:
    """Ranks sets by evidence, best first; of several fits of a set the best one counts.

    The model-error covariance is unknown: each set is scored with its own and those of the sets
    with the smallest errors, at its own linearisation and at theirs, and the best score counts. So
    a larger set is never worse than a set that it contains.
    """
    near = sorted(fits, key=lambda f: f.level)[:SURE_FITS]
    fixed = compared.fitter.fixed
    rows = []
    for fit in fits:
        own, others = fixed or fit.spread, [] if fixed else [f.spread for f in near]
        spreads = list(dict.fromkeys([own, *others]))
        tries = [(fit, spread) for spread in spreads]
        tries += [
            (other, spread)
            for spread in spreads
            for other in near
            if other is not fit
            and other.level <= fit.level
            and all(np.abs(other.columns.tangents[:, :, q]).max() > 0 for q in fit.members)
        ]
        scores = [compared.score(fit, *there, near[0], kappa) for there in tries]
        # At a fit's own point, the gain that tangents predict and no replay reached is subtracted.
        for n, score in enumerate(scores[: len(spreads)]):
            scores[n] = replace(score, log=score.log - fit.unkept)
        place = int(np.argmax([score.log for score in scores]))
        evidence = compared.evidence(*tries[place], near[0], kappa)
        here = max(score.log for score in scores[: len(spreads)])
        rows.append(Ranked(fit, evidence, scores[place], scores[place].log - here))
    best: dict[frozenset[Key], Ranked] = {}
    for row in sorted(rows, key=lambda r: (-r.score.log, r.fit.level)):
        best.setdefault(row.fit.keys, row)
    return list(best.values())
