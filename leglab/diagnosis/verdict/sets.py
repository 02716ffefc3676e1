"""Evidence of sets of effects for a verdict, from all recordings and with parts of them left out.

Each good set is also fitted without each of its effects, so that every named effect has a rival.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from leglab.diagnosis.effects.hypothesis import Hypothesis, Key
from leglab.diagnosis.likelihood.columns import Columns, Errors, Jump
from leglab.diagnosis.likelihood.evidence import Evidence, Member, Score
from leglab.diagnosis.replay.residual import inverse_roots, thinned
from leglab.diagnosis.search.healthy import Specimen
from leglab.diagnosis.search.moves.both_ways import both_ways
from leglab.diagnosis.search.pool import Found
from leglab.diagnosis.search.settle import Candidate
from leglab.diagnosis.thresholds import BLOWN, LAW, NEAR, NO_FAULT, SECANT, SMALL, WINDOWS


@dataclass(frozen=True, eq=False)
class Row:
    """A set of effects with its evidence."""

    keys: frozenset[Key]  #: Effects of the set
    ended: frozenset[Key]  #: Effects of the set with a parameter that ended at a bound
    score: Score  #: Score at the linearisation (fit) at which the set is most probable
    evidence: Evidence  #: Evidence at this linearisation
    #: Log evidence with each of the subsets `Evidence.subsets` left out, (subsets,).
    apart: np.ndarray
    left: np.ndarray  #: Errors that the set leaves, (windows, rows)
    hypothesis: Hypothesis  #: Hypothesis whose errors are `left`
    level: float  #: Median of `left` in noise levels
    #: New names by old name, of effects renamed as a simpler effect or one with the same motion.
    renamed: Mapping[Key, Key] = field(default_factory=dict)
    drive: float = 0.0  #: Change of log evidence by `Sets._in_units_of_the_drive` [nats], <= 0

    def places(self, key: Key) -> list[int]:
        """Returns the indices of an effect's parameters among the parameters of the set."""
        u = self.evidence.unknowns
        names = [self.renamed.get(u.keys[q], u.keys[q]) for q in self.score.unknowns]
        return [i for i, name in enumerate(names) if name == key]

    def size(self, key: Key) -> float:
        """Returns the largest departure of an effect's parameters, in smallest trials."""
        return float(np.abs(self.score.values[self.places(key)]).max(initial=0.0))


class Sets:
    """All sets of a search in `rows`, most probable first."""

    def __init__(self, found: Found, specimen: Specimen | None = None) -> None:
        self.found, self.fitter, self.at = found, found.fitter, found.fitter.at
        self.unknowns, problem = self.at.unknowns, self.at.problem
        self.best, self.size = found.ranks[0].evidence, found.ranks[0].score.size
        self.channels = len(problem.channels)
        self._roots = self._whiteners(self.at)
        # Windows of held-out recordings, which are not used if effects have onsets.
        held = thinned(problem.held, WINDOWS)
        shown = held.any() and found.onsets is None
        self.elsewhere = Errors(problem, self.unknowns, held) if shown else None
        # Linearisations of fitted sets without one effect, by set and effect.
        self.removed: dict[tuple[frozenset[Key], Key], Columns] = {}
        rows = self._all()
        if specimen is not None:
            rows = self._since(rows, specimen)
        lost = self._in_units_of_the_drive(rows)
        self.rows = [replace(row, drive=float(v)) for row, v in zip(rows, lost, strict=True)]

    def _whiteners(self, at: Errors) -> np.ndarray:
        """Computes inverse roots of the covariance of noise, and of healthy errors if known."""
        if self.fitter.fixed:
            return inverse_roots(at.covariance + self.fitter.fixed.replays[at.recording])
        return at.problem.noise.whitening[at.chosen]

    def shown(self, row: Row, key: Key) -> Iterator[tuple[Errors, np.ndarray]]:
        """Yields fitted windows, then held-out windows, with medians of squared whitened errors.

        The medians, (3, recordings, channels), are with the effect, without it, and of the squared
        difference c. Windows have the weight c/(c + 1), since a limit, e.g., acts in few windows.
        """
        tried = [(self.at, self._roots, row.left, self.without(row, key))]
        if self.elsewhere is not None:
            at = self.elsewhere
            gone = {row.score.unknowns[i]: -float(row.score.values[i]) for i in row.places(key)}
            both = (row.hypothesis, self.unknowns.moved(row.hypothesis, gone))
            with_, without = (np.clip(at.at(h), -BLOWN, BLOWN) for h in both)
            tried.append((at, self._whiteners(at), with_, without))
        for at, roots, with_, without in tried:
            change = self.channel_squares(without - with_, roots)
            squares = *(self.channel_squares(e, roots) for e in (with_, without)), change
            weight = change / (change + 1.0) + 1e-12
            parts = [at.recording == r for r in np.unique(at.recording)]
            middles = [
                [
                    np.quantile(square[p], 0.5, axis=0, weights=weight[p], method="inverted_cdf")
                    for p in parts
                ]
                for square in squares
            ]
            yield at, np.array(middles)

    def channel_squares(self, errors: np.ndarray, roots: np.ndarray | None = None) -> np.ndarray:
        """Computes mean squared whitened errors, (windows, channels).

        `roots` are the windows' inverse roots by `_whiteners`; None for the windows of the search.
        """
        roots = self._roots if roots is None else roots
        white = np.einsum("wij,wj->wi", roots, errors[:, : self.at.size])
        return np.asarray((white.reshape(len(white), self.channels, -1) ** 2).mean(axis=2))

    def _row(self, evidence: Evidence, members: Sequence[int], ended: Sequence[int]) -> Row:
        """Builds the `Row` of a set, with its evidence corrected by the errors of a replay.

        The replay is at the first-order optimum, or at the linearisation point for each spread
        between machines; the best counts, less the log likelihood that it loses to first order.
        """
        u, n, columns = self.unknowns, self.unknowns.single, evidence.columns
        chosen = [(q, None) for q in members]
        tries: list[tuple[Score, int | None, Hypothesis, np.ndarray, float]] = []
        score = evidence.score(chosen)
        there = u.moved(columns.base, evidence.departures(score))
        led = self.at.at(there)
        if np.abs(led).max() <= BLOWN:
            tries.append((score, None, there, led, 0.0))
        for spread in range(len(evidence.priors.spreads)):
            score = evidence.score(chosen, spread=spread)
            if not np.isfinite(score.log):  # not allowed: the set's faults are too small
                continue
            precision, _ = evidence.priors.precision(u, evidence.priors.spreads[spread])
            stays = columns.x[:n].copy()
            for q in score.unknowns:  # the prior of small deviations excludes the set's parameters
                stays[list(u.singles(q))] -= stays[list(u.singles(q))].mean()
            moves = columns.x[:n] + score.shift
            pull = 0.5 * float(stays @ precision @ stays - moves @ precision @ moves)
            tries.append((score, spread, columns.base, columns.errors, max(pull, 0.0)))
        beyond = np.array([self._beyond(evidence, one[0], one[3]) for one in tries])
        losses = np.maximum(beyond.sum(axis=1) + [one[4] for one in tries], 0.0)
        best = int(np.argmax([one[0].log - lost for one, lost in zip(tries, losses, strict=True)]))
        score, spread_there, hypothesis, errors, cost = tries[best]
        lost, all_parts = float(losses[best]), float(beyond[best].sum()) + cost
        parts = np.array([one.log for one in evidence.apart(chosen, spread_there, recordings=True)])
        return Row(
            keys=u.names(members),
            ended=u.names(q for q in ended if q in members),
            score=replace(score, log=score.log - lost, fit=score.fit - lost),
            evidence=evidence.with_kappa(evidence.kappa),  # a copy without the large caches
            apart=parts
            - np.maximum([all_parts - beyond[best][out].sum() for out in evidence.subsets], 0.0),
            left=errors,
            hypothesis=hypothesis,
            level=self.fitter.level(errors),
        )

    def _beyond(self, evidence: Evidence, score: Score, errors: np.ndarray) -> np.ndarray:
        """Computes the log likelihood [nats] that each part's errors lose against first order."""
        squares = [
            (evidence.white(one, score) ** 2).sum(axis=1) for one in (errors, evidence.left(score))
        ]
        lost = 0.5 * evidence.kappa * evidence.weight * (squares[0] - squares[1])
        return np.bincount(evidence.part, weights=lost)

    def _all(self) -> list[Row]:
        """Returns all sets, each at its most probable linearisation, most probable first."""
        u = self.unknowns
        rows: dict[tuple[frozenset[Key], bool], Row] = {}

        def enter(row: Row) -> None:
            # An effect too small to be noticed is no fault and is removed from the set's effects.
            row = replace(row, keys=frozenset(k for k in row.keys if row.size(k) >= NO_FAULT))
            names = row.keys, bool(row.renamed)
            if names not in rows or row.score.log > rows[names].score.log:
                rows[names] = row

        best, fitter = self.best, self.fitter
        for r in self.found.ranks:
            fit, own = r.fit, r.evidence
            if own.columns is not fit.columns:  # more probable where another set was fitted
                enter(self._row(own, fit.members, fit.ended))
                own = fitter.evidence(fit.columns, own.spread, best.weight, best.kappa)
            enter(self._row(own, fit.members, fit.ended))
        top, rivals = max(row.score.log for row in rows.values()), set[frozenset[int]]()
        for r in self.found.ranks:
            pattern, fit = r.evidence.spread, r.fit
            for key in fit.keys if r.score.log > top - NEAR else ():
                columns = self.at.without(fit.columns, fit.members, key)
                if columns is None:
                    continue
                self.removed[fit.keys, key] = columns
                members = tuple(q for q in fit.members if u.keys[q] != key)
                # Several sets may become equal without an effect, which are then fitted only once.
                if frozenset(members) in rivals:
                    continue
                rivals.add(frozenset(members))
                less = Candidate(members, {}, columns, pattern, best.weight)
                rest = fitter.fit(less, best.kappa, renewals=0, beside=True)
                # The covariance of the errors without the effect is tried as well.
                for spread in [pattern] if fitter.fixed else [pattern, rest.spread]:
                    there = fitter.evidence(rest.columns, spread, best.weight, best.kappa)
                    enter(self._row(there, members, fit.ended))
        for names, row in list(rows.items()):
            alike = self._alike(row)
            if alike and (alike.keys, False) in rows:  # the simpler set was fitted as well
                del rows[names]
                enter(alike)
                continue
            for key in row.keys:  # twins: other effects with the same motion
                pairs = [pair for pair in self.at.twins if key in pair]
                for twin in sorted({k for pair in pairs for k in pair} - row.keys):
                    enter(replace(row, keys=row.keys - {key} | {twin}, renamed={key: twin}))
        return sorted(rows.values(), key=lambda r: -r.score.log)

    def _since(self, rows: Sequence[Row], specimen: Specimen) -> list[Row]:
        """Ranks sets by log evidence less the log evidence that each gains on healthy recordings.

        Healthy windows have the same total weight as new windows. Prior odds are not subtracted.
        The fit to the healthy recordings lacks effects that are not `gradual`. If such an effect
        gains on these recordings, it probably existed before and is no change.
        """
        count = self.at.recording.size / specimen.at.recording.size
        unknowns = {q for row in rows for q in row.score.unknowns}
        jumps = list[Jump]()
        members = [
            [
                self._step(q, float(value), jumps)
                for q, value in zip(row.score.unknowns, row.score.values, strict=True)
            ]
            for row in rows
        ]
        before = specimen.as_new(self.unknowns.library, unknowns, jumps, self.best.kappa * count)
        nothing, found = before.score(()).log, []

        def gained(own: Sequence[Member]) -> float:
            return before.score(own).log - before.odds([q for q, _ in own]) - nothing

        for row, own in zip(rows, members, strict=True):
            stepped = {self.unknowns.keys[q] for q, jump in own if jump is not None}
            parts = {key: [m for m in own if self.unknowns.keys[m[0]] == key] for key in stepped}
            older = {key for key, one in parts.items() if gained(one) > 0.0}
            gain = max(gained([m for m in own if self.unknowns.keys[m[0]] not in older]), 0.0)
            score = replace(row.score, log=row.score.log - gain, fit=row.score.fit - gain)
            found.append(replace(row, keys=row.keys - older, score=score, apart=row.apart - gain))
        return sorted(found, key=lambda r: -r.score.log)

    def _step(self, unknown: int, value: float, jumps: list[Jump]) -> Member:
        """Returns a parameter as a member of a set: by its tangent, or if not `gradual` by a jump.

        For example, the tangent of a limit beyond all commands is zero. `jumps` is extended if no
        jump has a similar value.
        """
        if self.unknowns.gradual[unknown] or abs(value) < NO_FAULT:
            return unknown, None
        for i, (known, by) in enumerate(jumps):
            if known == unknown and SECANT[0] <= value / by <= SECANT[1]:
                return unknown, i
        jumps.append((unknown, value))
        return unknown, len(jumps) - 1

    def _alike(self, row: Row) -> Row | None:
        """Renames a direction-dependent effect, if both directions agree, to the symmetric effect.

        A relative difference of directions below `LAW` is not reported, since no friction law is
        exact. Returns None if the difference is larger, or if no effect has directions.
        """
        u, members, values = self.unknowns, row.score.unknowns, row.score.values
        simpler = both_ways(u, members, values.tolist())
        if simpler is None:
            return None
        both = [i for i, q in enumerate(members) if q not in simpler]
        names = u.names(simpler)
        new, old = names - row.keys, u.keys[members[both[0]]]
        if len(new) != 1 or old in names or np.ptp(values[both]) > LAW * abs(values[both].mean()):
            return None
        return replace(row, keys=names, renamed={old: next(iter(new))})

    def without(self, row: Row, key: Key) -> np.ndarray:
        """Computes errors without an effect if only the set's other effects are refitted."""
        gone, removed = row.places(key), self.removed.get((row.keys, key))
        columns, errors = row.evidence.columns, row.left
        if removed is not None:
            columns, errors = removed, removed.errors
        for i in gone if removed is None else ():
            errors = errors - columns.tangents[:, :, row.score.unknowns[i]] * row.score.values[i]
        members = [q for i, q in enumerate(row.score.unknowns) if i not in gone]
        if members:
            tangents = columns.tangents[:, :, members]
            size = self.fitter.priors.sizes[row.score.size]
            whitening = row.evidence.spread.whitening(self.at)
            factors = whitening.at(size, 1.0)[0] * np.sqrt(self.best.weight)[:, None]
            both = np.concatenate([errors[:, :, None], tangents], axis=2)
            white = factors[:, :, None] * (whitening.basis @ both)
            flat = white.reshape(-1, 1 + len(members))
            step = np.linalg.lstsq(flat[:, 1:], -flat[:, 0], rcond=None)[0]
            errors = errors + tangents @ step
        return np.asarray(errors)

    def _in_units_of_the_drive(self, rows: Sequence[Row]) -> np.ndarray:
        """Computes the change of each set's log evidence for a weakened drive, (sets,), <= 0.

        A misfit makes a fit weaken the drive, because a weak drive leaves small errors (as noise in
        a regressor shrinks the slope). So errors are divided by the motion that commands cause, as
        in inverse regression; sets with less such motion lose. Only errors beyond noise count.
        """
        at, size = self.at, self.fitter.priors.sizes[self.size]
        noise = at.covariance
        own = size**2 * self.best.spread.replays[at.recording]
        beyond = np.einsum("wij,wji->wi", np.linalg.inv(noise + own), own).clip(0.0, 1.0)
        numbers = beyond.reshape(len(beyond), self.channels, -1).sum(axis=2)
        lost = np.zeros(len(rows))
        # A set whose replay blows up gets the largest loss of all sets.
        blown = np.array([np.abs(row.left).max() > BLOWN for row in rows])
        for actuator in at.problem.machine.actuators:
            change = at.at(Hypothesis(), actuator) - self.found.first.errors
            squares = self.channel_squares(change)
            mean = squares.mean(axis=0)
            channels = mean > SMALL * mean.max()
            before = squares[:, channels].sum(axis=1)
            moving = before > SMALL * np.median(before)
            if not moving.any():  # the commands move nothing, so no set can weaken the drive
                continue
            count = self.best.kappa * float(numbers[moving][:, channels].sum())
            for i, row in enumerate(rows):
                change = at.at(row.hypothesis, actuator) - row.left
                if np.abs(change).max() > BLOWN:
                    blown[i] = True
                    continue
                after = self.channel_squares(change)[moving][:, channels].sum(axis=1)
                ratio = np.maximum(after, 1e-24) / before[moving]
                influence = 0.5 * float(np.median(np.log(ratio)))
                lost[i] += count * min(influence + SMALL, 0.0)
        return np.where(blown, lost.min(), lost)
