"""Fitted sets under each other: their evidence at the points of all fits."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leglab.diagnosis.effects.hypothesis import Key
from leglab.diagnosis.likelihood.columns import Columns
from leglab.diagnosis.likelihood.evidence import Evidence, Score
from leglab.diagnosis.likelihood.spread import Spread
from leglab.diagnosis.search.settle import Fit, Fitter
from leglab.diagnosis.thresholds import SURE_FITS

# Memory for products of linearisations that are kept [bytes]: a small part of any computer's.
_MEMORY = 2e8


@dataclass(frozen=True, eq=False)
class Ranked:
    """A fitted set where it is most probable."""

    fit: Fit  #: The fit
    evidence: Evidence  #: At its own linearisation, or at another's
    score: Score  #: Of the set there
    gain: float  #: By how much it is more probable there than at its own linearisation [nats]


class Compared:
    """Evidence of sets at linearisations: scores are made once, products as far as memory goes."""

    def __init__(self, fitter: Fitter) -> None:
        self.fitter = fitter
        self._made: dict[tuple[Columns, Spread, Fit], Evidence] = {}
        self._scores: dict[tuple[object, ...], Score] = {}

    def evidence(self, at: Fit, spread: Spread, by: Fit, kappa: float) -> Evidence:
        """At the point of a fit, with a pattern of errors and the weights of another fit."""
        key = at.columns, spread, by
        made = self._made.pop(key, None)
        if made is None:
            made = self.fitter.evidence(at.columns, spread, by.weight, kappa)
        elif made.kappa != kappa:
            made = made.with_kappa(kappa)
        self._made[key] = made
        # Each with its products at all sizes, and those beside priors of each spread.
        each = made.gram.nbytes * (1 + len(made.priors.spreads))
        while len(self._made) * each > _MEMORY:
            self._made.pop(next(iter(self._made)))
        return made

    def score(self, fit: Fit, at: Fit, spread: Spread, by: Fit, kappa: float) -> Score:
        """Of a set at the point of a fit; other arguments as of `evidence`."""
        key = fit.members, at.columns, spread, by, kappa
        if key not in self._scores:
            members = [(q, None) for q in fit.members]
            self._scores[key] = self.evidence(at, spread, by, kappa).score(members)
        return self._scores[key]


def rank(compared: Compared, fits: Sequence[Fit], kappa: float) -> list[Ranked]:
    """Sets by evidence, best first; of several fits of a set the best.

    The pattern of the model's own error is not known either: each set counts with the one that
    makes it most probable, of its own and those of the sets that leave least; and at the point, its
    own or another's, where it does best: a larger set is never worse than one that it holds.
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
        # Where a fit has ended, what tangents promised and no replay kept does not count.
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
