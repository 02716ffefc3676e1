"""Fitted sets under each other: their evidence, and which set to fit next."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leglab.diagnosis.effects.hypothesis import Key
from leglab.diagnosis.likelihood.columns import Columns
from leglab.diagnosis.likelihood.evidence import Evidence, Score
from leglab.diagnosis.likelihood.spread import Spread
from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.search.settle import Candidate, Fit, Fitter
from leglab.diagnosis.thresholds import BEHIND, BEST_SETS, LARGEST_SET, NEAR, SCORED, SURE_FITS

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


def next_candidate(
    fitter: Fitter,
    ranks: Sequence[Ranked],
    tried: set[frozenset[int]],
    without: Callable[[Fit, Key], Columns | None],
    limited: Callable[[Fit], Columns],
    least: float = -NEAR,
) -> Candidate | None:
    """The next set to fit; None where nothing promises to be above the best one by `least` nats.

    What says the same of both directions; then what adds a member to a good set, or leaves one out
    or swaps it, of the best sets and of those that ended at a bound. `tried` are the unknowns of
    all sets that have been, `without` linearises a fit without an effect, see `Errors.without`, and
    `limited` with jumps to limits, which have no tangent where nothing comes near them.
    """
    u = fitter.at.unknowns
    # What ended at a bound is a rival, but no yardstick: it would be another machine beyond.
    sound = [r for r in ranks if not r.fit.ended] or list(ranks)
    best, top = sound[0].fit, sound[0].score.log
    kappa = ranks[0].evidence.kappa
    levels = {r.fit.keys: r.fit.level for r in ranks}
    for row in [r for r in sound if least < 0.0 and r.score.log > top - BEHIND * NEAR]:
        simpler = both_ways(u, row.fit.members, row.fit.columns.x[list(row.fit.members)].tolist())
        if simpler is None:
            continue
        names = u.names(simpler)
        once = frozenset(simpler) | frozenset(row.fit.members)  # from here
        if once not in tried and row.fit.level < levels.get(names, np.inf):
            tried.add(once)
            x, fit = row.fit.columns.x, row.fit
            start = {q: -float(x[q]) for q in fit.members if q not in simpler}
            start |= {q: value - float(x[q]) for q, value in simpler.items()}
            return Candidate(tuple(simpler), start, fit.columns, fit.spread, fit.weight)
    found: list[tuple[Score, Fit, Evidence]] = []

    def add(evidence: Evidence, members: Sequence[int], fit: Fit, least: float = -np.inf) -> None:
        score = evidence.score([(q, None) for q in members])
        found.append((score, fit, evidence))
        for _, new in evidence.additions(score)[: 2 * SCORED]:
            larger = evidence.score([*score.members, new])
            if larger.log > score.log + least:
                found.append((larger, fit, evidence))

    for row in [r for r in sound[:BEST_SETS] if r.score.log > top - BEHIND * NEAR]:
        own = (r.evidence for r in ranks if r.evidence.columns is row.fit.columns)
        there = next(own, None) or fitter.evidence(
            row.fit.columns, row.fit.spread, row.fit.weight, kappa
        )
        add(there, row.fit.members, row.fit, 0.0)
    if (beside := limited(best)).jumps:
        add(fitter.evidence(beside, best.spread, best.weight, kappa), best.members, best, 0.0)
    for row in [r for r in ranks[:BEST_SETS] if r.fit is best or r.fit.ended]:
        fit = row.fit
        out = fit.members if fit is best else fit.ended
        for key in dict.fromkeys(u.keys[q] for q in out):
            if (columns := without(fit, key)) is not None:
                rest = [q for q in fit.members if u.keys[q] != key]
                add(fitter.evidence(columns, fit.spread, fit.weight, kappa), rest, fit)
    found = [
        one
        for one in found
        if one[0].log >= top + least
        and 0 < len(one[0].members) <= LARGEST_SET
        and frozenset(one[0].unknowns) not in tried
    ]
    if not found:
        return None
    score, fit, evidence = max(found, key=lambda entry: entry[0].log)
    start = evidence.departures(score)
    return Candidate(score.unknowns, start, evidence.columns, fit.spread, fit.weight, score.log)


def both_ways(
    u: Unknowns, members: Sequence[int], values: Sequence[float]
) -> dict[int, float] | None:
    """A set with an effect by direction replaced by the same one in both directions.

    Departures of its members, from those of the set; None where that has no such effect.
    """
    value = dict(zip(members, values, strict=True))
    for q in members:
        key, place = u.places[q][0]
        for pair in u.effect(q).by_direction:
            both = [i for i in members if u.places[i][0][0] == key and u.name(i) in pair]
            if len(both) < 2 or q not in both:
                continue
            mean = float(np.mean([value[i] * u.scale[i] for i in both]))
            for i in range(u.single):
                if u.effect(i).by_direction or not u.nameable[i]:
                    continue
                if factor := u.library.as_simpler((key, place), u.places[i][0]):
                    kept = {m: float(value[m]) for m in members if m not in both}
                    return {**kept, i: kept.get(i, 0.0) + factor * mean / u.scale[i]}
    return None
