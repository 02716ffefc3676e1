"""Confidence of names: against every rival, without each part of the recordings, and against causes
outside of the library.

Evidence alone is sure of whatever absorbs most. Three questions bound it. Does the name hold without
each part of the recordings in turn? Among the sets are those that lack it where it stands. And does
it explain as much of what is left without it as the cause itself would, or as little as the best
impostor of a cause that no effect describes? How much an impostor would explain is computed: every
effect of the library in turn plays the unknown cause, and the best effect of another kind its
impostor.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import norm

from leglab.diagnosis.effects.base import all_effects
from leglab.diagnosis.effects.hypothesis import Hypothesis, Key
from leglab.diagnosis.likelihood.columns import Columns
from leglab.diagnosis.likelihood.evidence import Evidence, Score
from leglab.diagnosis.likelihood.spread import Spread
from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.search.search import Found
from leglab.diagnosis.verdict.twins import twins

# Odds of a cause in the library against one outside of it.
LIBRARY_ODDS = 2.0
# Logit of the share that the best impostor explains: mean and standard deviation on a machine of
# which nothing is known, and how many computed ones that counts for.
IMPOSTOR, IMPOSTOR_WEIGHT = (-0.85, 1.8), 5.0
# A jump whose chi-square beside all that machines differ in is beyond this can be seen.
VISIBLE = 25.0
# Width, in logits, of the edge about one half below which the right cause hardly explains less.
EDGE = 0.5
# Confidence of a name; of a member of a confusion set, without some part of the recordings.
NAMED, POSSIBLE = 0.5, 0.3
# Sets whose fits differ by less than this factor in probability are not told apart by the data,
# whichever is simpler, if the rival needs no more than so many further numbers.
TIE, FURTHER = 4.0, 2
# Level up to which errors are those of noise, or of a healthy specimen.
EXPLAINED = 2.0
# Log of the influence of a drive that differs between good fits.
SLACK = 0.1


@dataclass(frozen=True, eq=False)
class Row:
    """A set with its evidence, whole and without each part.

    Attributes:
        fitted: Whether its linearisation is where it was fitted by replays.
    """

    keys: frozenset[Key]
    ended: bool
    score: Score
    evidence: Evidence
    apart: np.ndarray
    left: np.ndarray
    level: float
    fitted: bool = False
    drive: dict[str, float] = field(default_factory=dict)
    renamed: Mapping[Key, Key] = field(default_factory=dict)

    def unknowns_of(self, unknowns: Unknowns, key: Key) -> list[int]:
        """Places among the members of an effect's parameters."""
        names = [self.renamed.get(unknowns.keys[q], unknowns.keys[q]) for q in self.score.unknowns]
        return [i for i, name in enumerate(names) if name == key]


@dataclass(frozen=True)
class Judged:
    """One effect.

    Attributes:
        confidence: Probability that the name is right.
        possible: The same without the part of the recordings that speaks most against it.
        evidence: Probability by evidence alone.
        apart: Without the worst part.
        share: Of what is left without it, that it explains.
        inside: Probability that it stands for itself and not for an unknown cause.
        size: Largest departure in trials.
    """

    confidence: float
    possible: float
    evidence: float
    apart: float
    share: float
    inside: float
    size: float


@dataclass(frozen=True, eq=False)
class Verdict:
    """What is said.

    Attributes:
        verdict: "named", "confusion_set", "unexplained" or "nothing_missing".
        named: Effects, surest first.
        confusion: Effects of the confusion set.
        effects: All effects of all sets.
        rows: Sets, best first.
        level: Before and after.
    """

    verdict: str
    named: tuple[Key, ...]
    confusion: tuple[Key, ...]
    effects: Mapping[Key, Judged] = field(default_factory=dict)
    rows: tuple[Row, ...] = ()
    level: tuple[float, float] = (np.nan, np.nan)


class Judge:
    """Judges all fitted sets of a search."""

    def __init__(self, found: Found) -> None:
        self.found, self.fitter, self.at = found, found.fitter, found.fitter.at
        self.unknowns = self.at.unknowns
        best = found.evidence[0]
        self.spread, self.weight, self.kappa = best.spread, best.weight, best.kappa
        self.channels = len(self.at.problem.channels)
        place = found.scores[0].size
        self.place = place
        roots, _ = best.spread.whiteners(self.at, 1.0, 1.0)
        n = self.at.size
        self.roots = (
            roots[:, :n, :n]
            if found.fitter.fixed
            else self.at.problem.noise.whitening[self.at.chosen]
        )

    def blocks(self, errors: np.ndarray) -> np.ndarray:
        """Mean squares, median of windows, by recording and channel."""
        white = np.einsum("wij,wj->wi", self.roots, errors[:, : self.at.size])
        square = (white.reshape(len(white), self.channels, -1) ** 2).mean(axis=2)
        recording = self.at.recording
        return np.stack([np.median(square[recording == r], axis=0) for r in np.unique(recording)])

    def row(self, evidence: Evidence, members: tuple[int, ...], ended: bool) -> Row:
        u = self.unknowns
        chosen = [(q, None) for q in members]
        score = evidence.score(chosen)
        parts = int(evidence.part.max()) + 1
        apart = np.array(
            [evidence.score(chosen, self._without(evidence, r)).log for r in range(parts)]
        )
        left = evidence.left(score)
        return Row(
            frozenset(u.keys[q] for q in members),
            ended,
            score,
            evidence,
            apart,
            left,
            self.fitter.level(left),
        )

    def _without(self, evidence: Evidence, part: int):
        kept = evidence.__dict__.setdefault("_apart", {})
        if part not in kept:
            kept[part] = evidence.reduced(without=part)
        return kept[part]

    def rows(self) -> list[Row]:
        """All sets: fitted, and with each effect of a good one taken out by a replay."""
        found, u = self.found, self.unknowns
        rows: dict[frozenset[Key], Row] = {}

        def enter(row: Row) -> None:
            if row.keys not in rows or row.score.log > rows[row.keys].score.log:
                rows[row.keys] = row

        self.removed: dict[tuple[frozenset[Key], Key], Columns] = {}
        for fit, evidence, score in zip(found.fits, found.evidence, found.scores, strict=True):
            row = self.row(evidence, fit.members, bool(fit.ended))
            enter(replace(row, fitted=evidence.columns is fit.columns))
        top = max(row.score.log for row in rows.values())
        for fit, evidence, score in zip(found.fits, found.evidence, found.scores, strict=True):
            if score.log < top - 10.0:
                continue
            for key in {u.keys[q] for q in fit.members}:
                members = tuple(q for q in fit.members if u.keys[q] != key)
                x = fit.columns.x
                gone = {
                    i: -float(x[i]) for q in fit.members if u.keys[q] == key for i in u.singles(q)
                }
                base = u.moved(fit.columns.base, gone)
                errors = self.at.at(base)
                if np.abs(errors).max() > 1e11:
                    continue
                columns = Columns(
                    base, u.departures(base), errors, fit.columns.tangents, (), fit.columns.changes
                )
                self.removed[frozenset(u.keys[q] for q in fit.members), key] = columns
                # What it is without the effect has a pattern of its own.
                own = (
                    [evidence.spread]
                    if self.fitter.fixed
                    else [evidence.spread, Spread.of(self.at, errors)]
                )
                for spread in own:
                    there = self.fitter.evidence(columns, spread, self.weight, self.kappa)
                    enter(self.row(there, members, bool(fit.ended) and bool(members)))
        for row in list(rows.values()):
            for key in row.keys:
                for twin in twins(self.at.problem, key):
                    alike = (row.keys - {key}) | {twin}
                    if twin not in row.keys:
                        # The same motion by another name.
                        known = rows.get(alike)
                        if known is None or known.score.log < row.score.log:
                            rows[alike] = replace(row, keys=alike, renamed={key: twin})
        return sorted(rows.values(), key=lambda r: -r.score.log)

    def quieter(self, rows: list[Row]) -> np.ndarray:
        """Nats by which sets lose in units of the drive, (sets,), 0 and less.

        Any misfit shrinks the influence of a drive on the motion that a fit predicts, as noise in
        a regressor shrinks its slope. Errors counted in units of the drive, motion error over how
        much motion a command makes, do not profit from that; the other direction of the same
        regression. Only errors beyond the sensors' noise count.
        """
        priors = self.fitter.priors
        noise = self.at.problem.noise.covariance[self.at.chosen]
        size = priors.sizes[self.place] ** 2
        own = size * self.spread.replays[self.at.recording]
        beyond = np.einsum("wij,wji->wi", np.linalg.inv(noise + own), own).clip(0.0, 1.0)
        lost = np.zeros(len(rows))
        nothing = Hypothesis()
        for actuator in self.at.problem.machine.actuators:

            def moved(hypothesis, errors):
                return (
                    self.at.at(hypothesis, actuator)[:, : self.at.size] - errors[:, : self.at.size]
                )

            first = moved(nothing, self.found.first.errors)
            white = np.einsum("wij,wj->wi", self.roots, first)
            channels = (white.reshape(len(white), self.channels, -1) ** 2).mean(axis=2)
            # Channels that it moves, and windows in which it does.
            drives = channels.mean(axis=0) > 0.1 * channels.mean(axis=0).max()
            in_window = channels[:, drives].sum(axis=1)
            moving = in_window > 0.1 * np.median(in_window)
            numbers = (
                beyond.reshape(len(white), self.channels, -1).sum(axis=2)[moving][:, drives].sum()
            )
            before = np.sqrt(in_window[moving])
            for i, row in enumerate(rows):
                base = self.unknowns.moved(
                    row.evidence.columns.base, row.evidence.departures(row.score)
                )
                there = moved(base, self.at.at(base))
                white = np.einsum("wij,wj->wi", self.roots, there)
                after = (white.reshape(len(white), self.channels, -1) ** 2).mean(axis=2)
                after = np.sqrt(after[moving][:, drives].sum(axis=1))
                if not np.isfinite(after).all() or after.max() > 1e9:
                    continue
                louder = float(np.median(np.log(np.maximum(after, 1e-12) / before)))
                row.drive[actuator] = louder
                lost[i] += self.kappa * float(numbers) * min(louder + SLACK, 0.0)
        return lost

    def _ties(self, rows: list[Row], first: Row, key: Key) -> tuple[frozenset[Key], ...]:
        """Sets without an effect that fit as well as the best one with it, in both ways.

        A simpler set is more probable, but where the data have no say its name is no finding.
        """
        lost = {id(r): float(v) for r, v in zip(rows, self.lost, strict=True)}
        own, numbers = first.score.fit + lost[id(first)], len(first.score.members)
        shared = first.keys - {key}
        found: list[frozenset[Key]] = []
        for row in rows:
            new = row.keys - shared
            if (
                key in row.keys
                or row.ended
                or not new
                or len(row.score.members) > numbers + FURTHER
            ):
                continue
            fit = row.score.fit + lost[id(row)]
            if fit > own - np.log(TIE) and not any(one <= new for one in found):
                found.append(new)
        return tuple(found)

    def _claimed(self, row: Row, key: Key) -> float:
        """Probability that directions differ by more than is noticeable, where a name says so."""
        u, score = self.unknowns, row.score
        places = row.unknowns_of(u, key)
        claims = []
        for pair in u.effect(score.unknowns[places[0]]).by_direction:
            both = [i for i in places if u.name(score.unknowns[i]) in pair]
            if both:
                away = abs(
                    float(
                        np.subtract(*score.values[both])
                        if len(both) == 2
                        else score.values[both[0]]
                    )
                )
                spread = float(np.linalg.norm(score.deviations[both]))
                claims.append(float(norm.cdf((away - 1.0) / max(spread, 1e-9))))
        return max(claims, default=1.0)

    def without(self, row: Row, key: Key) -> np.ndarray:
        """Errors with an effect taken out and the other members fitted anew; spikes stay."""
        u = self.unknowns
        gone = row.unknowns_of(u, key)
        columns = self.removed.get((row.keys, key))
        errors = row.left
        if columns is not None:
            errors = columns.errors
        else:
            for i in gone:
                q = row.score.unknowns[i]
                errors = errors - row.evidence.columns.tangents[:, :, q] * row.score.values[i]
        members = [q for i, q in enumerate(row.score.unknowns) if i not in gone]
        if members:
            tangents = (columns or row.evidence.columns).tangents[:, :, members]
            size = self.fitter.priors.sizes[row.score.size]
            roots, _ = row.evidence.spread.whiteners(self.at, size, 1.0)
            white = roots @ np.concatenate([errors[:, :, None], tangents], axis=2)
            white = (white * np.sqrt(self.weight)[:, None, None]).reshape(-1, 1 + len(members))
            step = np.linalg.lstsq(white[:, 1:], -white[:, 0], rcond=None)[0]
            errors = errors + tangents @ step
        return errors

    def impostors(self) -> tuple[float, float]:
        """Mean and standard deviation of the logit of the share that the best impostor explains."""
        u, first = self.unknowns, self.found.first
        n = u.single
        evidence = self.fitter.evidence(
            first, self.spread, self.weight, self.kappa, places=[self.place]
        )
        inner = evidence.whole.inner[0, self.found.scores[0].spread]
        jumps = [1 + len(u) + j for j in range(len(first.jumps))]
        R = inner[np.ix_(jumps, jumps)]
        size = np.maximum(np.diag(R), 1e-12)
        group = {e.name: e.group for e in all_effects()}
        keys = [u.keys[q] for q, _ in first.jumps]
        kinds = np.array([group[k[0]] for k in keys])
        best: dict[Key, tuple[float, float]] = {}
        for b in range(len(jumps)):
            others = kinds != kinds[b]
            if size[b] < VISIBLE or not others.any():
                continue
            share = np.maximum(R[others, b], 0.0) ** 2 / (size[others] * size[b])
            if keys[b] not in best or size[b] > best[keys[b]][0]:
                best[keys[b]] = float(size[b]), float(min(share.max(), 1.0))
        x = np.array([np.log((r + 1e-3) / (1.0 - r + 1e-3)) for _, r in best.values()])
        (m0, s0), w = IMPOSTOR, IMPOSTOR_WEIGHT
        mean = (w * m0 + x.sum()) / (w + x.size)
        variance = (w * (s0**2 + (m0 - mean) ** 2) + ((x - mean) ** 2).sum()) / (w + x.size)
        return float(mean), float(np.sqrt(variance))

    def judge(self) -> Verdict:
        """The verdict."""
        rows = self.rows()
        logs = np.array([r.score.log for r in rows])
        share = np.exp(logs - logs.max())
        share /= share.sum()
        apart = np.array([r.apart for r in rows])
        apart = np.exp(apart - apart.max(axis=0))
        apart /= apart.sum(axis=0)
        self.lost = self.quieter(rows)
        in_drive = logs + self.lost
        in_drive = np.exp(in_drive - in_drive.max())
        in_drive /= in_drive.sum()
        apart_drive = np.array([r.apart for r in rows]) + self.lost[:, None]
        apart_drive = np.exp(apart_drive - apart_drive.max(axis=0))
        apart_drive /= apart_drive.sum(axis=0)
        self.f0 = self.impostors()
        top = float(np.log(max(self.found.level**2, np.e)))
        recording = self.at.recording
        bins = self.at.size // self.channels
        grain = np.sqrt(
            2.0 / (bins * np.array([(recording == r).sum() for r in np.unique(recording)]))
        )[:, None]
        effects: dict[Key, Judged] = {}
        tied: dict[Key, tuple[frozenset[Key], ...]] = {}
        for key in sorted({k for r in rows for k in r.keys}):
            has = np.array([key in r.keys for r in rows])
            sound = has & ~np.array([r.ended for r in rows])
            evidence, nameable = float(share[has].sum()), float(share[sound].sum())
            first = rows[int(np.argmax(np.where(has, logs, -np.inf)))]
            worst = np.inf
            own = np.max([r.apart for r in rows if key in r.keys], axis=0)
            lack = [r.apart for r in rows if key not in r.keys]
            worst = float(np.max(np.max(lack, axis=0) - own)) if lack else -50.0
            alone = 1.0 / (1.0 + np.exp(np.clip(worst, -50.0, 50.0)))
            rho = _explained(self.blocks(first.left), self.blocks(self.without(first, key)), grain)
            inside = _inside(rho, self.f0, top)
            size = float(np.abs(first.score.values[first.unknowns_of(self.unknowns, key)]).max())
            possible = 0.0
            if sound.any():
                possible = max(float(apart[sound].sum(axis=0).max()), nameable)
                possible = max(possible, float(apart_drive[sound].sum(axis=0).max()))
            nameable = min(nameable, float(in_drive[sound].sum()))
            alone = min(alone, float(apart_drive[sound].sum(axis=0).min()) if sound.any() else 0.0)
            inside *= self._claimed(first, key)
            ties = self._ties(rows, first, key) if min(nameable, alone) * inside > NAMED else ()
            tied |= {key: ties} if ties else {}
            sure = min(nameable, alone) * inside / (1 + len(ties))
            effects[key] = Judged(sure, possible * inside, evidence, alone, rho, inside, size)
        named = tuple(
            sorted(
                (k for k, e in effects.items() if e.confidence > NAMED),
                key=lambda k: -effects[k].confidence,
            )
        )
        confusion = (
            ()
            if named
            else tuple(
                sorted(
                    (k for k, e in effects.items() if e.possible >= POSSIBLE),
                    key=lambda k: -effects[k].possible,
                )
            )
        )
        if tied and not named:
            leader = max(tied, key=lambda k: effects[k].evidence)
            others = [k for row in tied[leader] for k in sorted(row)]
            confusion = tuple(dict.fromkeys((leader, *others, *confusion)))
        still = any(
            not r.keys
            and apart[i].max() >= POSSIBLE
            and (self.fitter.priors.sizes[r.score.size] if self.fitter.fixed else r.level)
            <= EXPLAINED
            for i, r in enumerate(rows)
        )
        if named:
            said = "named"
        elif still:
            said, confusion = "nothing_missing", ()
        elif confusion:
            said = "confusion_set"
        else:
            said = "unexplained"
        return Verdict(
            said, named, confusion, effects, tuple(rows), (self.found.level, rows[0].level)
        )


def _explained(with_: np.ndarray, without: np.ndarray, grain: np.ndarray) -> float:
    """Share of the errors beyond noise that an effect explains where it acts."""
    gain = np.maximum(without - with_, 0.0)
    share = gain / (gain + np.maximum(with_ - 1.0, 0.0) + grain)
    act = gain / np.maximum(without, 1e-9)
    return float((share * act).sum() / max(act.sum(), 1e-9))


def _inside(share: float, impostor: tuple[float, float], top: float) -> float:
    """Probability that an effect stands for itself and not for a cause outside of the library."""
    mean, deviation = impostor
    t = min(float(np.log((share + 1e-9) / (1.0 - share + 1e-9))), top)
    outside = np.exp(-0.5 * ((t - mean) / deviation) ** 2) / (deviation * np.sqrt(2.0 * np.pi))
    own = 1.0 / (1.0 + np.exp(-t / EDGE)) / max(top, 1.0)
    odds = LIBRARY_ODDS * own / max(outside, 1e-12)
    return float(odds / (1.0 + odds))
