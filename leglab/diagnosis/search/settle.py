"""Fits of one set of effects by replays, to the end.

Gauss-Newton on the likelihood of `likelihood.evidence`: tangents of the members are taken anew at
every turn, those of all other unknowns are corrected by what the replays show (Broyden 1965) and
taken anew at the end. The model's own error is what the set itself leaves. Members find their place
first while the rest of the machine stays as it is built: beside a gross fault the rest would move to
where it does not belong. Whatever is not smooth (play, dead band, delay) is looked at along a ladder
of sizes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leglab.diagnosis.effects.hypothesis import Key
from leglab.diagnosis.likelihood.columns import COARSE, LARGE, LARGE_FIRST, Columns, Errors
from leglab.diagnosis.likelihood.evidence import Evidence, Score, robust_weights
from leglab.diagnosis.likelihood.priors import ABSENT, FAULT_SIZE, Priors
from leglab.diagnosis.likelihood.spread import Spread

# Share of the log likelihood that counts before anything is known.
KAPPA = 0.1
# Level up to which errors are those of noise: windows that start in stick-slip or beside jumps of
# the command lift it on good models.
EXPLAINED = 2.0
TURNS = 16
# Another turn that gains less is not worth its replays [nats].
ENOUGH = 2.0
# All tangents are taken anew so often at most.
RENEWALS = 5
# In the first turns machines are built almost as their model.
STIFF_TURNS, STIFF = 3, 0.05
SHARES = (1.0, 0.5, 0.2, 0.05)
# Multiples of a size that are looked at.
LADDER = (0.3, 0.5, 0.75, 1.3, 1.8, 2.8)
# Relative change of a slope over the ladder below which an unknown is smooth.
SMOOTH = 0.2
_FINE = 0.05
LOG = lambda s: None


@dataclass(frozen=True, eq=False)
class Fit:
    """A set fitted by replays.

    Attributes:
        members: Unknowns of the set.
        columns: Linearisation where the fit ended.
        spread: Pattern of the error that the set leaves.
        weight: Of windows.
        score: Evidence there.
        level: Median error in noise levels of the sensors.
        ended: Members that ended at a bound.
    """

    members: tuple[int, ...]
    columns: Columns
    spread: Spread
    weight: np.ndarray
    score: Score
    level: float
    ended: tuple[int, ...]

    def keys(self, fitter: "Fitter") -> frozenset[Key]:
        """Effects of the set."""
        return frozenset(fitter.at.unknowns.keys[q] for q in self.members)


class Fitter:
    """Fits sets of effects on the windows of a problem.

    Args:
        at: Windows.
        priors: Of everything but the errors.
        fixed: Pattern of the model's own error, where healthy recordings have shown it.
    """

    def __init__(self, at: Errors, priors: Priors, fixed: Spread | None = None) -> None:
        self.at, self.priors, self.fixed = at, priors, fixed
        self.stiff = replace(priors, spreads=(0.02,), tolerances=STIFF, covariance=None)
        sensors = at.problem.noise.whitening[at.chosen]
        self._sensors = sensors

    def level(self, errors: np.ndarray) -> float:
        """Median error of windows in noise levels of the sensors."""
        white = np.einsum("wij,wj->wi", self._sensors, errors[:, : self.at.size])
        return float(np.sqrt(np.median(np.mean(white**2, axis=1))))

    def evidence(
        self,
        columns: Columns,
        spread: Spread,
        weight: np.ndarray,
        kappa: float,
        priors: Priors | None = None,
        places: Sequence[int] | None = None,
    ) -> Evidence:
        """Evidence of sets at a linearisation."""
        return Evidence(self.at, columns, spread, weight, kappa, priors or self.priors, places)

    def own_spread(self, errors: np.ndarray) -> Spread:
        """Pattern of the model's own error: what healthy recordings say, else these errors."""
        return self.fixed or Spread.of(self.at, errors)

    def weights(self, errors: np.ndarray, spread: Spread, place: int) -> np.ndarray:
        """Robust weights of windows."""
        size = self.priors.sizes[place]
        forces = max(1.0, size) if self.priors.calibrated else 1.0
        return robust_weights(self.at, errors, spread, size, forces)

    def ended(self, members: Sequence[int], x: np.ndarray, values: np.ndarray) -> tuple[int, ...]:
        """Members that stand within 2 % of a bound; zero is none: no friction is an answer."""
        u, found = self.at.unknowns, []
        for q, value in zip(members, values, strict=True):
            v = value if q >= u.single else x[q]
            near = 0.02 * max(abs(v), 1e-9)
            key, i = u.places[q][0]
            natural = u.library.sites[key].lower[i] == 0.0
            if (v >= u.upper[q] - near and u.upper[q] > 0) or (
                v <= u.lower[q] + near and u.lower[q] < 0 and not natural
            ):
                found.append(q)
        return tuple(found)

    def fit(
        self,
        columns: Columns,
        start: dict[int, float],
        members: Sequence[int],
        spread: Spread,
        weight: np.ndarray,
        kappa: float,
        *,
        turns: int = TURNS,
        give_up: float = np.inf,
        beside: bool = False,
    ) -> Fit:
        """Fits a set.

        Args:
            columns: Linearisation from which it starts; its tangents are corrected on the way.
            start: By how much unknowns move from there at first.
            members: Unknowns of the set.
            spread: Pattern of the model's own error at first.
            weight: Of windows at first.
            kappa: 1/design effect.
            turns: At most.
            give_up: Level of the errors beyond which the fit is not finished.
            beside: Whether the rest of the machine starts where another set has left it, and moves
                with the members from the first turn on.
        """
        at, u = self.at, self.at.unknowns
        members = tuple(members)
        hypothesis, tangents = columns.base, columns.tangents
        errors, x = columns.errors, columns.x
        z = np.zeros(len(members))
        spikes = x[: u.single].copy()
        if start:
            moved = u.moved(hypothesis, start)
            now = at.at(moved)
            if members or self.level(now) < self.level(errors) or beside:
                hypothesis, errors, x = moved, now, u.departures(moved)
                z = np.array([x[list(u.singles(q))].mean() for q in members])
                spikes = self._spikes(x, members, z)
                spread = self.own_spread(errors)
                weight = np.ones(len(errors))
        given_up = False
        anew = slow = False
        telling, renewals = None, 0
        for turn in range(turns):
            first = turn < STIFF_TURNS and bool(members) and not beside
            priors = self.stiff if first else self.priors
            if (
                not first
                and not anew
                and (turn == (0 if beside else STIFF_TURNS) or slow or not members)
            ):
                tangents = self._all(hypothesis, errors, members, tangents, telling)
                anew, renewals = True, renewals + 1
            else:
                tangents = self._fresh(hypothesis, errors, x, members, tangents, first)
            here = Columns(hypothesis, x, errors, tangents, (), np.zeros((*errors.shape, 0)))
            evidence = self.evidence(here, spread, weight, kappa, priors)
            score = evidence.score([(q, None) for q in members])
            if first:
                begun = z
                hypothesis, errors, x, z, spikes, tangents = self._profiled(
                    evidence, score, hypothesis, errors, x, z, spikes, tangents, members
                )
                if z is not begun:
                    here = Columns(hypothesis, x, errors, tangents, (), here.changes)
                    evidence = self.evidence(here, spread, weight, kappa, priors)
                    score = evidence.score([(q, None) for q in members])
            if not first:
                telling = evidence.telling(score)
            goal = evidence.step(score)
            before = self._cost(evidence, errors, z, spikes, score)
            for share in SHARES:
                z_new = z + share * (goal[0] - z)
                spikes_new = spikes + share * (goal[1] - spikes)
                moved = u.moved(hypothesis, self._moves(x, members, z_new, spikes_new))
                errors_new = at.at(moved)
                after = self._cost(evidence, errors_new, z_new, spikes_new, score)
                if after < before:
                    break
            else:
                if anew and not first:
                    break
                slow = True
                continue
            x_new = u.departures(moved)
            tangents = _broyden(tangents, errors_new - errors, x_new - x, members, u.single)
            hypothesis, errors, x, z, spikes = moved, errors_new, x_new, z_new, spikes_new
            gain = 0.5 * (before - after)
            LOG(
                f"      turn {turn} share {share} gain {gain:.1f} size {score.size} spread {score.spread} level {self.level(errors):.3f} z {np.round(z, 2)} anew {anew}"
            )
            spread = self.own_spread(errors)
            weight = self.weights(errors, spread, score.size)
            if not first:
                # As explanations get better, errors are worth more numbers.
                kappa = 1.0 / max(evidence.design_effect(score), 1.0)
            if turn + 1 >= STIFF_TURNS and self.level(errors) > give_up:
                given_up = True
                break
            if not first and anew and (gain < ENOUGH or renewals >= RENEWALS):
                break
            slow, anew = share < 1.0 or gain < 5.0 * ENOUGH, False
        if not given_up and not anew:
            tangents = self._all(hypothesis, errors, members, tangents, telling)
        here = Columns(hypothesis, x, errors, tangents, (), np.zeros((*errors.shape, 0)))
        evidence = self.evidence(here, spread, weight, kappa)
        score = evidence.score([(q, None) for q in members])
        return Fit(
            members,
            here,
            spread,
            weight,
            score,
            self.level(errors),
            self.ended(members, x, score.values),
        )

    def _spikes(self, x: np.ndarray, members: Sequence[int], z: np.ndarray) -> np.ndarray:
        """Departures of single unknowns beside the members' values."""
        u = self.at.unknowns
        spikes = x[: u.single].copy()
        for q, value in zip(members, z, strict=True):
            spikes[list(u.singles(q))] -= value
        return spikes

    def _moves(
        self, x: np.ndarray, members: Sequence[int], z: np.ndarray, spikes: np.ndarray
    ) -> dict[int, float]:
        """By how much single unknowns move from x for members' values and spikes."""
        u = self.at.unknowns
        goal = spikes.copy()
        for q, value in zip(members, z, strict=True):
            goal[list(u.singles(q))] += value
        goal = np.where(u.gradual[: u.single] | (np.abs(goal) > ABSENT), goal, 0.0)
        return {i: float(d) for i, d in enumerate(goal - x[: u.single]) if d != 0.0}

    def _cost(
        self,
        evidence: Evidence,
        errors: np.ndarray,
        z: np.ndarray,
        spikes: np.ndarray,
        score: Score,
    ) -> float:
        """Twice the negative log posterior at the score's size and spread."""
        roots, _ = self._roots(evidence, score.size)
        white = (roots @ errors[:, :, None])[:, :, 0]
        square = evidence.kappa * float((evidence.weight[:, None] * white**2).sum())
        precision, _ = evidence.priors.precision(
            self.at.unknowns, evidence.priors.spreads[score.spread]
        )
        fault = float(2.0 * np.log1p((z / FAULT_SIZE) ** 2).sum())
        return square + float(spikes @ precision @ spikes) + fault

    def _roots(self, evidence: Evidence, place: int) -> tuple[np.ndarray, np.ndarray]:
        key = (id(evidence), place)
        if getattr(self, "_kept", (None,))[0] != key:
            size = evidence.priors.sizes[place]
            self._kept = key, evidence.spread.whiteners(self.at, size, evidence.force_size(place))
        return self._kept[1]

    def _fresh(self, hypothesis, errors, x, members, tangents, coarse=False):
        """Tangents with those of the members and their shapes taken anew."""
        at, u = self.at, self.at.unknowns
        keys = frozenset().union(*(u.library_keys(q) for q in members))
        which = [q for q in members if q < u.single]
        which += [i for i in range(u.single) if u.shape[i] and u.keys[i] in keys]
        step, large = (COARSE, LARGE_FIRST) if coarse else (_FINE, LARGE)
        out = at.tangents(hypothesis, errors, which, step, tangents, large)
        for q in members:
            if q < u.single:
                continue
            now = float(np.mean(x[list(u.singles(q))]))
            h = max(step, large * abs(now))
            moved = at.at(u.moved(hypothesis, {q: h}))
            difference = (moved - errors) / h
            difference[np.abs(moved).max(axis=1) > 1e11] = 0.0
            out[:, :, q] = difference
        return out

    def _all(self, hypothesis, errors, members, tangents, telling=None):
        """All tangents taken anew, but of unknowns of which the data hardly tell anything."""
        u = self.at.unknowns
        # A shape is the effect's whose strength is a member: of a spike it means nothing.
        keys = {u.library_keys(q) for q in members}
        there = frozenset().union(*keys) if keys else frozenset()
        which = [
            i
            for i in range(u.single)
            if u.keys[i] in there
            or (u.gradual[i] and not u.shape[i] and (telling is None or telling[i]))
        ]
        known = tangents.copy()
        known[:, :, : u.single][:, :, u.shape[: u.single]] = 0.0
        return self.at.tangents(hypothesis, errors, which, _FINE, known)

    def _profiled(self, evidence, score, hypothesis, errors, x, z, spikes, tangents, members):
        """The best size of each member that is not smooth, on a ladder; all else stays."""
        at, u = self.at, self.at.unknowns
        lowest = self._cost(evidence, errors, z, spikes, score)
        changed = False
        for n, q in enumerate(members):
            sizes = sorted({float(np.clip(f * z[n], u.lower[q], u.upper[q])) for f in LADDER})
            sizes = [y for y in sizes if abs(y - z[n]) > 0.02 * abs(z[n])]
            if len(sizes) < 2:
                continue
            tried = {}

            def look(y: float) -> np.ndarray:
                moved = u.moved(hypothesis, {q: y - z[n]})
                tried[y] = moved, at.at(moved)
                change = (tried[y][1] - errors)[:, : at.size] / (y - z[n])
                return np.einsum("wij,wj->wi", self._sensors, change)

            near = [sizes[i] for i in (1, -2)] if len(sizes) > 3 else [sizes[0], sizes[-1]]
            slopes = [look(y) for y in near]
            if np.linalg.norm(slopes[1] - slopes[0]) < SMOOTH * np.linalg.norm(slopes[0]):
                continue
            for y in sizes:
                if y not in tried:
                    look(y)
            for y, (moved, there) in tried.items():
                z_there = np.where(np.arange(z.size) == n, y, z)
                cost = self._cost(evidence, there, z_there, spikes, score)
                if cost < lowest:
                    lowest, best, changed = cost, (moved, there, z_there), True
            if changed:
                hypothesis, errors, z = best
                x = u.departures(hypothesis)
        if changed:
            tangents = self._fresh(hypothesis, errors, x, members, tangents)
        return hypothesis, errors, x, z, spikes, tangents


def _broyden(tangents, change, moved, members, single):
    """Tangents corrected by what a step showed, along the unknowns that moved most."""
    direction = moved[:single].copy()
    on = [q for q in members if q < single]
    along = direction.copy()
    if on:
        mask = np.zeros(single)
        mask[on] = 1.0
        if (direction * mask).any():
            along = direction * mask
    norm = float(direction @ along)
    if norm <= 1e-12:
        return tangents
    missed = change - tangents[:, :, :single] @ direction
    out = tangents.copy()
    out[:, :, :single] += missed[:, :, None] * (along / norm)
    return out
