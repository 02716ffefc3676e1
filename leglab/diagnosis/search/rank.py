"""Ranking of fitted sets of effects by their evidence at the linearisations of several fits."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leglab.diagnosis.effects.hypothesis import Key
from leglab.diagnosis.likelihood.columns import Columns
from leglab.diagnosis.likelihood.evidence import Evidence, Score
from leglab.diagnosis.likelihood.spread import Spread
from leglab.diagnosis.search.settle import Fit, Fitter
from leglab.diagnosis.thresholds import SURE_FITS

# Upper limit on cached products of linearisations [bytes]: a small part of any computer's memory.
_MEMORY = 2e8


@dataclass(frozen=True, eq=False)
class Ranked:
    """A fitted set at the linearisation where it is most probable."""

    fit: Fit  #: The fit
    evidence: Evidence  #: Evidence at the linearisation of this fit or of another fit
    score: Score  #: Score of the set by this evidence
    gain: float  #: Log evidence of `score` less the log evidence at this fit [nats]


class Compared:
    """Evidence of sets at the fits' linearisations, with all scores and some products cached."""

    def __init__(self, fitter: Fitter) -> None:
        self.fitter = fitter
        self._made: dict[tuple[Columns, Spread, Fit], Evidence] = {}
        self._scores: dict[tuple[object, ...], Score] = {}

    def evidence(self, at: Fit, spread: Spread, by: Fit, kappa: float) -> Evidence:
        """Returns the evidence at the fit `at`, with the window weights of the fit `by`."""
        key = at.columns, spread, by
        made = self._made.pop(key, None)
        if made is None:
            made = self.fitter.evidence(at.columns, spread, by.weight, kappa)
        elif made.kappa != kappa:
            made = made.with_kappa(kappa)
        self._made[key] = made
        # Each evidence keeps products at all scales, and reduced products for each spread.
        each = made.gram.nbytes * (1 + len(made.priors.spreads))
        while len(self._made) * each > _MEMORY:
            self._made.pop(next(iter(self._made)))
        return made

    def score(self, fit: Fit, at: Fit, spread: Spread, by: Fit, kappa: float) -> Score:
        """Scores the set of `fit` at the linearisation of `at`; arguments as in `evidence`."""
        key = fit.members, at.columns, spread, by, kappa
        if key not in self._scores:
            members = [(q, None) for q in fit.members]
            self._scores[key] = self.evidence(at, spread, by, kappa).score(members)
        return self._scores[key]


def rank(compared: Compared, fits: Sequence[Fit], kappa: float) -> list[Ranked]:
    """Ranks sets by evidence, best first; of several fits of one set, the best one counts.

    Each set is scored at the linearisations of its own fit and of the fits with the smallest
    errors. The model-error covariances of all these fits are tried, because without healthy
    recordings it is unknown. The best score counts, so a set is never worse than its subset.
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
        # For a fit's linearisation, the predicted gain that no replay reached is subtracted.
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
