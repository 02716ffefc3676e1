"""Confidence of named effects against rival sets, parts of the recordings and unknown causes.

If the cause is not in the library, a wrong effect, the impostor, explains a share of the errors. To
estimate this share, each effect plays the cause, and the best effect of another group its impostor.
"""

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from leglab.diagnosis import thresholds
from leglab.diagnosis.effects.base import all_effects
from leglab.diagnosis.effects.hypothesis import Hypothesis, Key
from leglab.diagnosis.likelihood.columns import DRIVE_GAIN, Errors
from leglab.diagnosis.result import Verdict
from leglab.diagnosis.search.healthy import Specimen
from leglab.diagnosis.thresholds import EXPLAINED
from leglab.diagnosis.verdict.sets import Row, Sets


@dataclass(frozen=True)
class Judged:
    """Judgement of one effect, or of several effects of which one may be the cause."""

    confidence: float  #: Probability that the effect is the cause
    among: float  #: Mean probability with each part left out, without sets at a bound
    possible: float  #: Largest probability with one part of the recordings left out
    evidence: float  #: Probability by the evidence of sets from all recordings alone
    ties: tuple[frozenset[Key], ...]  #: Rivals that the data do not distinguish from the effect


class Judgement:
    """Verdict of a search, with named effects or a confusion set, by the evidence of all sets.

    `named` effects are ordered by confidence. If no effect is named, `confusion` may hold effects
    that the data do not distinguish and of which one is the cause, the most probable first.
    """

    def __init__(self, sets: Sets, specimen: Specimen | None) -> None:
        impostor, keys = impostors(sets), sorted({k for r in sets.rows for k in r.keys})
        effects = {key: _effect(sets, frozenset({key}), impostor) for key in keys}

        def most(measure: str, least: float, order: str) -> tuple[Key, ...]:
            above = [k for k, e in effects.items() if getattr(e, measure) > least]
            return tuple(sorted(above, key=lambda k: -getattr(effects[k], order)))

        named = most("confidence", thresholds.NAMED, "confidence")
        # The limit is relative: of three equal rivals each has a probability of only a third.
        top = max((e.possible for e in effects.values()), default=0.0)
        confused = not named and top > thresholds.POSSIBLE
        confusion = (
            most("possible", min(thresholds.POSSIBLE, top / thresholds.TIE), "evidence")
            if confused
            else ()
        )
        tied = [k for k, e in effects.items() if e.ties]
        if tied and not named:
            leader = max(tied, key=lambda k: effects[k].evidence)
            rivals = [k for new in effects[leader].ties for k in sorted(new)]
            confusion = tuple(dict.fromkeys((leader, *rivals, *confusion)))
        # A confusion set needs a probability above 0.5 that it holds the cause.
        among = _effect(sets, frozenset(confusion), impostor).among if confusion else 0.0
        confusion, among = (confusion, among) if among > thresholds.NAMED else ((), 0.0)
        verdict: Verdict = "unexplained"
        self.as_it_was = specimen is not None and _unchanged(sets, specimen)
        if named:
            verdict = "named"
        elif self.as_it_was or (specimen is None and _as_noise(sets)):
            verdict, confusion = "nothing_missing", ()
        elif confusion:
            verdict = "confusion_set"
        self.sets, self.rows, self.effects = sets, sets.rows, effects
        self.verdict, self.named, self.confusion, self.among = verdict, named, confusion, among

    def cleared(self) -> "Judgement":
        """Returns a copy with the verdict "nothing_missing" and without names."""
        other = copy(self)
        other.verdict, other.named, other.confusion = "nothing_missing", (), ()
        return other


def _unchanged(sets: Sets, specimen: Specimen) -> bool:
    """Tests whether errors are as small as in healthy recordings, whatever sets of effects gain.

    Errors are computed with the specimen's parameters and, if the empty set is more probable than
    all other sets together, with its fit, which moves them within the healthy data's uncertainty.
    """
    problem = sets.at.problem
    own = _shares(np.array([r.score.log for r in sets.rows]))
    open_ = [
        r.hypothesis
        for r, p in zip(sets.rows, own, strict=True)
        if not r.keys and p > thresholds.NAMED
    ]
    return any(specimen.as_it_was(problem, at) for at in (Hypothesis(), *open_))


def _as_noise(sets: Sets) -> bool:
    """Tests whether the empty set is probable, within tolerances, and leaves only noise."""
    whole = _shares(np.array([r.score.log for r in sets.rows]))
    for row, own in zip(sets.rows, whole, strict=True):
        if not row.keys and own >= thresholds.POSSIBLE:
            left = sets.channel_squares(row.left).mean(axis=1)
            return _within_tolerances(row) and as_noise(left, sets.at.recording)
    return False


def _within_tolerances(row: Row) -> bool:
    """Tests whether all parameters are within limits that 19 of 20 good machines keep."""
    u = row.evidence.unknowns
    known = np.flatnonzero(u.tolerance[: u.single])
    away = u.departures(row.hypothesis)[known] / u.tolerance[known]
    return bool((np.abs(away) <= norm.isf(0.025 / max(known.size, 1))).all())


def as_noise(squares: np.ndarray, recording: np.ndarray) -> bool:
    """Tests whether the errors of every single recording are noise alone.

    `squares` are the mean squared whitened errors of windows, `recording` the windows' recordings.
    """
    largest = max(float(np.median(squares[recording == r])) for r in np.unique(recording))
    return largest**0.5 <= EXPLAINED


def _shares(logs: np.ndarray) -> np.ndarray:
    """Computes probabilities of sets, (sets, ...), from log evidences."""
    share = np.exp(logs - logs.max(axis=0))
    return np.asarray(share / share.sum(axis=0))


def _effect(sets: Sets, names: frozenset[Key], impostor: tuple[float, float]) -> Judged:
    """Judges how probable it is that one of the effects `names` is the cause."""
    rows = sets.rows
    logs, apart = np.array([r.score.log for r in rows]), np.array([r.apart for r in rows])
    drive = np.array([r.drive for r in rows])
    has = np.array([bool(names & r.keys) for r in rows])
    # If an effect ends at a bound, the truth lies beyond. So no effect of that set is sure, and the
    # effect at the bound is not even possible.
    sound = has & ~np.array([bool(r.ended) for r in rows])
    there = np.array([bool(names & r.keys - r.ended) for r in rows])
    ways = (0.0 * drive, drive)
    best = [rows[int(np.argmax(np.where(has, logs + lost, -np.inf)))] for lost in ways]
    inside = {
        row: max(_stands(sets, row, key, impostor) for key in sorted(names & row.keys))
        for row in set(best)
    }
    sure, among, possible = 1.0, 1.0, 0.0
    for row, lost in zip(best, ways, strict=True):
        share, parts = _shares(logs + lost), _shares(apart + lost[:, None])
        least = min(float(share[sound].sum()), float(parts[sound].sum(axis=0).min()))
        sure = min(sure, least * inside[row])
        among = min(among, float(parts[sound].sum(axis=0).mean()) * inside[row])
        most = max(least, float(parts[there].sum(axis=0).max()))
        possible = max(possible, most * inside[row])
    alone = len(names) == 1 and sure > thresholds.NAMED
    ties = _ties(rows, best[0], next(iter(names))) if alone else ()
    evidence = float(_shares(logs)[has].sum())
    return Judged(sure / (1 + len(ties)), among, possible, evidence, ties)


def _stands(sets: Sets, row: Row, key: Key, impostor: tuple[float, float]) -> float:
    """Computes the probability that an effect of a set is the cause and has the right name.

    It depends on the share of the errors that the effect explains, and on `_claimed`.
    """
    (share, _), *elsewhere = (_explained(sets, *shown) for shown in sets.shown(row, key))
    for explains, acts in elsewhere:
        share -= acts * max(share - explains, 0.0)
    inside = _inside(share, impostor, max(2.0 * math.log(sets.found.level), 1.0))
    return inside * _claimed(row, key)


def _ties(rows: Sequence[Row], first: Row, key: Key) -> tuple[frozenset[Key], ...]:
    """Returns rivals of the effect `key`: effects of sets without `key` with similar evidence.

    A weaker drive and more resistance change a joint's motion alike. So a set that fits as well as
    a drive's gain is a rival even with more parameters. An effect that contains `key` as a special
    case always fits as well and is no rival.
    """
    library, shared = first.evidence.unknowns.library, first.keys - {key}
    numbers = len(first.score.members) - 1 + thresholds.RESISTING
    found: list[frozenset[Key]] = []
    for row in rows:
        new, ahead = row.keys - shared, first.drive - row.drive - np.log(thresholds.TIE)
        rival = new and key not in row.keys and not row.ended & new
        near = row.score.log > first.score.log + ahead
        if key[0] == DRIVE_GAIN and len(row.score.members) <= numbers:
            near |= row.score.fit > first.score.fit + ahead
        special = any(library.contains(other, key) for other in new)
        if rival and near and not special and not any(one <= new for one in found):
            found.append(new)
    return tuple(found)


def _claimed(row: Row, key: Key) -> float:
    """Computes the probability that directions differ noticeably; 1 for a symmetric effect."""
    u, score = row.evidence.unknowns, row.score
    places = [] if key in row.renamed.values() else row.places(key)
    if not places:
        return 1.0
    claims = []
    for pair in u.effect(score.unknowns[places[0]]).by_direction:
        both = [i for i in places if u.name(score.unknowns[i]) in pair]
        if both:
            values = score.values[both]
            away = abs(float(values[0] - values[1] if len(both) == 2 else values[0]))
            spread = float(np.linalg.norm(score.deviations[both]))
            claims.append(float(norm.cdf((away - 1.0) / max(spread, 1e-9))))
    return max(claims, default=1.0)


def impostors(sets: Sets) -> tuple[float, float]:
    """Computes mean and standard deviation of the logit of the best impostors' shares."""
    u, first, best = sets.unknowns, sets.found.first, sets.best
    evidence = sets.fitter.evidence(first, best.spread, best.weight, best.kappa, places=[sets.size])
    product = evidence.likeness(sets.found.ranks[0].score)
    size = np.maximum(np.diag(product), 1e-12)
    group = {e.name: e.group for e in all_effects()}
    keys = [u.keys[q] for q, _ in first.jumps]
    kinds = np.array([group[k[0]] for k in keys])
    best_of: dict[Key, tuple[float, float]] = {}
    for b in range(len(keys)):
        others = kinds != kinds[b]
        if size[b] < thresholds.VISIBLE or not others.any():
            continue
        share = np.maximum(product[others, b], 0.0) ** 2 / (size[others] * size[b])
        if keys[b] not in best_of or size[b] > best_of[keys[b]][0]:
            best_of[keys[b]] = float(size[b]), float(min(share.max(), 1.0))
    shares = np.array([share for _, share in best_of.values()])
    x = np.log((shares + 1e-3) / (1.0 - shares + 1e-3))
    m0, s0, w = thresholds.IMPOSTOR
    mean = (w * m0 + x.sum()) / (w + x.size)
    variance = w * (s0**2 + (m0 - mean) ** 2) + ((x - mean) ** 2).sum()
    return float(mean), float(np.sqrt(variance / (w + x.size)))


def _explained(sets: Sets, at: Errors, blocks: np.ndarray) -> tuple[float, float]:
    """Computes the share of errors beyond noise that an effect explains, and the effect's action.

    The action c/(c + e), with the effect's change of errors c and the errors left e, is the weight
    of the share: an effect that acts much but explains little is wrong, weak action tells nothing.
    """
    with_, without, change = blocks
    count = np.array([(at.recording == r).sum() for r in np.unique(at.recording)])
    left = np.maximum(with_ - 1.0, 0.0)
    left = left + np.sqrt(2.0 / (at.size // sets.channels * count))[:, None]
    gain = np.maximum(without - with_, 0.0)
    act = change / (change + left)
    share = gain / (gain + left)
    return float((share * act).sum() / max(float(act.sum()), 1e-9)), float(act.mean())


def _inside(share: float, impostor: tuple[float, float], top: float) -> float:
    """Computes the probability that an effect is the cause, not a cause outside of the library.

    `share` is the share of the errors that the effect explains, `impostor` mean and standard
    deviation of the logit of impostors' shares, `top` the largest logit that noise lets one see.
    """
    mean, deviation = impostor
    t = min(float(np.log((share + 1e-9) / (1.0 - share + 1e-9))), top)
    outside = norm.pdf(t, mean, deviation)
    own = 1.0 / (1.0 + np.exp(-t / thresholds.EDGE)) / max(top, 1.0)
    odds = thresholds.LIBRARY_ODDS * own / max(float(outside), 1e-12)
    return float(odds / (1.0 + odds))
