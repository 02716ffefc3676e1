"""Confidence of named effects in view of rival sets, subsets of the data, and unknown causes.

If the cause is not in the library, a wrong effect (the "impostor") explains a share of the errors.
To estimate it, each effect is taken as the cause, and the best of another group as the impostor.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.stats import norm

from leglab.diagnosis import thresholds
from leglab.diagnosis.effects.hypothesis import Key
from leglab.diagnosis.likelihood.columns import DRIVE_GAIN
from leglab.diagnosis.result import Verdict
from leglab.diagnosis.verdict.table import Entry, Member, Table


@dataclass(frozen=True, kw_only=True)
class Judged:
    """Judgement of one effect, or of several effects of which one may be the cause."""

    confidence: float  #: Probability that the effect is the cause
    among: float  #: Mean probability over parts of recordings left out, without sets at a bound
    possible: float  #: Largest probability with one part of the recordings left out
    evidence: float  #: Probability by the evidence of sets from all recordings alone
    ties: tuple[frozenset[Key], ...]  #: Rivals that the data do not distinguish from the effect
    #: `evidence` without the least favourable part of the recordings and without sets at a bound.
    parts: float
    drive: float  #: `parts` if errors are divided by the motion that commands cause
    member: Member  #: The effect in its most probable set; of several, the one surest by `stands`


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """Verdict of a search, with named effects or a confusion set."""

    verdict: Verdict
    named: tuple[Key, ...] = ()  #: Named effects, the most confident first
    #: If none is named, effects one of which is the cause but which the data do not distinguish;
    #: the most probable first.
    confusion: tuple[Key, ...] = ()
    among: float = 0.0  #: Probability that the cause is in the confusion set
    effects: Mapping[Key, Judged]  #: Judgements of all effects
    as_it_was: bool = False  #: Whether errors are as small as in healthy recordings

    def cleared(self) -> "Judgement":
        """Returns a copy with the verdict "nothing_missing" and without names."""
        return replace(self, verdict="nothing_missing", named=(), confusion=())


def judge(table: Table) -> Judgement:
    """Judges the sets of a search by their evidence."""
    effects = {key: _effect(table, frozenset({key})) for key in table.effects}

    def most(measure: str, least: float, order: str) -> tuple[Key, ...]:
        above = [k for k, e in effects.items() if getattr(e, measure) > least]
        return tuple(sorted(above, key=lambda k: -getattr(effects[k], order)))

    named = most("confidence", thresholds.NAMED, "confidence")
    # The limit is relative, because of three equal rivals each has a probability of only a third.
    top = max((e.possible for e in effects.values()), default=0.0)
    confused = not named and top > thresholds.POSSIBLE
    least = min(thresholds.POSSIBLE, top / thresholds.TIE)
    confusion = most("possible", least, "evidence") if confused else ()
    tied = [k for k, e in effects.items() if e.ties]
    if tied and not named:
        leader = max(tied, key=lambda k: effects[k].evidence)
        rivals = [k for new in effects[leader].ties for k in sorted(new)]
        confusion = tuple(dict.fromkeys((leader, *rivals, *confusion)))
    # The probability that a confusion set contains the cause has to exceed one half.
    among = _effect(table, frozenset(confusion)).among if confusion else 0.0
    confusion, among = (confusion, among) if among > thresholds.NAMED else ((), 0.0)
    quiet = _quiet(table)
    as_it_was = bool(table.as_it_was) or (table.as_it_was is not None and quiet is not None)
    verdict: Verdict = "unexplained"
    if named:
        verdict = "named"
    elif as_it_was or quiet is not None:
        if as_it_was or (quiet and quiet.quiet_held_out):
            verdict = "nothing_missing"
        confusion = ()
    elif confusion:
        verdict = "confusion_set"
    return Judgement(
        verdict=verdict,
        named=named,
        confusion=confusion,
        among=among,
        effects=effects,
        as_it_was=as_it_was,
    )


def _quiet(table: Table) -> Entry | None:
    """Returns the empty set if it is possible and leaves only noise, or errors as when healthy.

    It is possible by the same measure as an effect of a confusion set. With healthy recordings, it
    must be more probable than all other sets together, since its fit moves the specimen's
    parameters within the healthy data's uncertainty.
    """
    share = _shares(np.array([one.log for one in table.sets]))
    enough = share > thresholds.NAMED
    if table.as_it_was is None:
        parts = _shares(np.array([one.apart for one in table.sets])).max(axis=1)
        enough = np.maximum(share, parts) >= thresholds.POSSIBLE
    empty = (one for one, own in zip(table.sets, enough, strict=True) if own and not one.keys)
    return next((one for one in empty if one.quiet), None)


def _shares(logs: np.ndarray) -> np.ndarray:
    """Computes probabilities of sets, (sets, ...), from log evidences."""
    share = np.exp(logs - logs.max(axis=0))
    return np.asarray(share / share.sum(axis=0))


def _effect(table: Table, names: frozenset[Key]) -> Judged:
    """Judges how probable it is that one of the effects `names` is the cause."""
    sets = table.sets
    logs, apart = np.array([one.log for one in sets]), np.array([one.apart for one in sets])
    drive = np.array([one.drive for one in sets])
    has = np.array([bool(names & one.names) for one in sets])
    # If an effect ends at a bound, the true value lies beyond. So no effect of the set is sure, and
    # the effect at the bound is not even possible.
    sound = has & ~np.array([bool(one.ended) for one in sets])
    there = np.array([bool(names & one.names - set(one.ended)) for one in sets])
    ways = (0.0 * drive, drive)
    best = [int(np.argmax(np.where(has, logs + lost, -np.inf))) for lost in ways]
    member = {i: max(_named(sets[i], names), key=partial(stands, table)) for i in best}
    inside = {i: stands(table, one) for i, one in member.items()}
    leasts, among, possible = [], 1.0, 0.0
    for i, lost in zip(best, ways, strict=True):
        share, parts = _shares(logs + lost), _shares(apart + lost[:, None])
        leasts.append(min(float(share[sound].sum()), float(parts[sound].sum(axis=0).min())))
        among = min(among, float(parts[sound].sum(axis=0).mean()) * inside[i])
        most = max(leasts[-1], float(parts[there].sum(axis=0).max()))
        possible = max(possible, most * inside[i])
    sure = min(least * inside[i] for i, least in zip(best, leasts, strict=True))
    alone = len(names) == 1 and sure > thresholds.NAMED
    ties = _ties(table, sets[best[0]], next(iter(names))) if alone else ()
    return Judged(
        confidence=sure / (1 + len(ties)),
        among=among,
        possible=possible,
        evidence=float(_shares(logs)[has].sum()),
        ties=ties,
        parts=leasts[0],
        drive=leasts[1],
        member=member[best[0]],
    )


def _named(one: Entry, names: frozenset[Key]) -> list[Member]:
    """Returns the effects of a set that are among `names`."""
    return [member for member in one.members if member.key in names]


def stands(table: Table, member: Member) -> float:
    """Computes the probability that an effect of a set is the cause and has the right name.

    It depends on the share of the errors that the effect explains, and on whether directions
    differ.
    """
    return inside(table, member) * member.differs


def _ties(table: Table, first: Entry, key: Key) -> tuple[frozenset[Key], ...]:
    """Returns rivals of the effect `key`: effects of sets without `key` with similar evidence.

    A weaker drive and more resistance change a joint's motion in the same way. So a set that fits
    as well as a drive's gain is a rival even with more parameters. An effect that contains `key` as
    a special case always fits as well and is no rival.
    """
    shared = first.names - {key}
    numbers = first.numbers - 1 + thresholds.RESISTING
    found: list[frozenset[Key]] = []
    for one in table.sets:
        new, ahead = one.names - shared, first.drive - one.drive - np.log(thresholds.TIE)
        rival = new and key not in one.names and not new & set(one.ended)
        near = one.log > first.log + ahead
        if key[0] == DRIVE_GAIN and one.numbers <= numbers:
            near |= one.fit > first.fit + ahead
        special = any((other, key) in table.contains for other in new)
        if rival and near and not special and not any(known <= new for known in found):
            found.append(new)
    return tuple(found)


def inside(table: Table, member: Member) -> float:
    """Computes the probability that an effect is the cause, not a cause outside of the library.

    The share of the errors that it explains is compared with those that impostors explain.
    """
    mean, deviation = table.impostor
    top = max(2.0 * math.log(table.level), 1.0)  # largest logit that is visible above the noise
    share = member.share
    t = min(float(np.log((share + 1e-9) / (1.0 - share + 1e-9))), top)
    outside = norm.pdf(t, mean, deviation)
    own = 1.0 / (1.0 + np.exp(-t / thresholds.EDGE)) / top
    odds = thresholds.LIBRARY_ODDS * own / max(float(outside), 1e-12)
    return float(odds / (1.0 + odds))
