"""Fit of a set of effects by replays: Gauss-Newton iteration on the likelihood of `Evidence`.

In the first iterations only members (parameters of the set) move freely, because a gross
fault would drive other parameters to wrong values. The tangents (derivatives of errors) by members
are computed in every iteration; others are corrected by replays (Broyden 1965) or computed anew.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from leglab.base.scale import rms
from leglab.diagnosis import thresholds
from leglab.diagnosis.effects.hypothesis import Hypothesis, Key
from leglab.diagnosis.likelihood.columns import Columns, Errors, change
from leglab.diagnosis.likelihood.evidence import Evidence, Score
from leglab.diagnosis.likelihood.priors import Priors
from leglab.diagnosis.likelihood.spread import Spread
from leglab.diagnosis.replay.residual import noise_alone, robust_weight
from leglab.diagnosis.thresholds import EXPLAINED, SAME, SMALL


@dataclass(frozen=True, eq=False)
class Candidate:
    """A set of effects to fit, and the start of its fit."""

    members: tuple[int, ...]  #: Unknowns of the set
    start: Mapping[int, float]  #: Moves of unknowns from the linearisation to the start of the fit
    columns: Columns  #: Linearisation to which `start` refers
    spread: Spread  #: Initial covariance of the model error
    weight: np.ndarray  #: Initial weights of windows
    promise: float = np.inf  #: Log evidence predicted to first order


@dataclass(frozen=True, eq=False)
class Fit:
    """A set of effects fitted by replays."""

    members: tuple[int, ...]  #: Unknowns of the set
    keys: frozenset[Key]  #: Effects and elements of the set
    columns: Columns  #: Linearisation at the end of the fit
    spread: Spread  #: Covariance of the errors that the set leaves
    weight: np.ndarray  #: Weights of windows
    score: Score  #: Evidence at the end of the fit
    level: float  #: Median error in noise levels of the sensors
    ended: tuple[int, ...]  #: Unknowns of the set that ended at a bound
    finished: bool  #: Whether the fit converged or was given up
    unkept: float  #: Gain that tangents predict at the end but no replay reached [nats]
    #: Gain of an unfinished fit [nats], which may gain as much again; 0 for a finished fit.
    gained: float


@dataclass(frozen=True, eq=False)
class Point:
    """Parameters of a fit with their errors and tangents."""

    hypothesis: Hypothesis  #: Values of all effects
    errors: np.ndarray  #: Errors of the hypothesis, (windows, rows)
    x: np.ndarray  #: Departures of all unknowns
    values: np.ndarray  #: Departures of the members from the specimen, (members,)
    deviations: np.ndarray  #: Departures of single unknowns less `values`, all small, (single,)
    tangents: np.ndarray  #: Latest tangents, (windows, rows, unknowns)

    @property
    def columns(self) -> Columns:
        """The point as a linearisation without jumps."""
        none = np.zeros((*self.errors.shape, 0))
        return Columns(self.hypothesis, self.x, self.errors, self.tangents, (), none)


@dataclass(frozen=True, eq=False)
class State:
    """State of a fit between two iterations."""

    point: Point
    spread: Spread  #: Covariance of the model error
    weight: np.ndarray  #: Weights of windows
    kappa: float  #: 1/design effect
    stiff: int  #: Number of first iterations in which parameters outside of the set hardly move
    fine: bool  #: Whether all tangents are differences over small (`FINE`) steps
    taken: np.ndarray  #: Departures at which all tangents were last computed
    off: np.ndarray  #: Error of the tangents' prediction in the last step, (windows, rows)
    missed: float = 0.0  #: Sum of prediction errors since all tangents were computed [nats]
    most: np.ndarray | None = None  #: Largest steps over which tangents are taken, (single,)
    #: Largest indices of model-error scale and of spread between machines; None for no limit.
    places: tuple[int, int] | None = None
    iterations: int = 0  #: Number of iterations
    renewed: int = 0  #: Number of renewals of all tangents
    damping: float = 0.0  #: Damping of the last step
    slow: bool = False  #: Whether the last step gained little or was damped
    gained: float = 0.0  #: Gain of all steps [nats]
    unkept: float = 0.0  #: Gain that tangents predict at the end but no replay reached [nats]
    #: Reason for which the fit ended; "" while it continues.
    ended: Literal["", "finished", "given up", "unfinished"] = ""


class Fitter:
    """Fitter of sets of effects to windows of recordings, under `priors`.

    `fixed` is the covariance of the model error from healthy recordings; None without these.
    """

    def __init__(self, at: Errors, priors: Priors, fixed: Spread | None = None) -> None:
        self.at, self.priors, self.fixed = at, priors, fixed
        tolerances, spread = thresholds.STIFF
        self._stiff = replace(priors, spreads=(spread,), tolerances=tolerances, covariance=None)
        self._sensors = at.problem.noise.whitening[at.chosen]
        self._of_noise: Spread | None = None

    def level(self, errors: np.ndarray) -> float:
        """Computes the median error of windows in noise levels of the sensors."""
        return float(np.sqrt(np.median(np.mean(self._white(errors) ** 2, axis=1))))

    def rms(self, errors: np.ndarray) -> float:
        """Computes the RMS error in noise levels; unlike `level`, it rises by a few bad windows."""
        return float(rms(self._white(errors)))

    def explains(self, fit: Fit) -> bool:
        """Tests whether a fit leaves only noise, or errors as large as the healthy specimen's."""
        if self.fixed is None:
            return fit.level <= EXPLAINED
        white = self.fixed.whitening(self.at).white(fit.columns.errors, 1.0, 1.0)[:, : self.at.size]
        return float(np.median(np.mean(white**2, axis=1))) <= EXPLAINED**2

    def clear(self, errors: np.ndarray) -> bool:
        """Tests whether the errors of each recording are noise alone."""
        return noise_alone(np.mean(self._white(errors) ** 2, axis=1), self.at.recording)

    def _white(self, errors: np.ndarray) -> np.ndarray:
        return np.asarray(np.einsum("wij,wj->wi", self._sensors, errors[:, : self.at.size]))

    def evidence(
        self,
        columns: Columns,
        spread: Spread,
        weight: np.ndarray,
        kappa: float,
        priors: Priors | None = None,
        places: Sequence[int] | None = None,
    ) -> Evidence:
        """Builds the evidence of sets at a linearisation; arguments as in `Evidence`."""
        return Evidence(self.at, columns, spread, weight, kappa, priors or self.priors, places)

    def own_spread(self, errors: np.ndarray) -> Spread:
        """Returns the model-error covariance from healthy recordings, or else from `errors`.

        Once errors are noise alone, their first covariance is kept, as later ones are no better.
        """
        if self.fixed or not self.clear(errors):
            return self.fixed or Spread.of(self.at, errors)
        self._of_noise = self._of_noise or Spread.of(self.at, errors)
        return self._of_noise

    def about(self, errors: np.ndarray) -> tuple[Spread, np.ndarray]:
        """Returns the model-error covariance by `errors`, and window weights at its scale 1."""
        spread = self.own_spread(errors)
        return spread, self.weights(errors, spread, self.priors.sizes.index(1.0))

    def weights(self, errors: np.ndarray, spread: Spread, place: int) -> np.ndarray:
        """Computes robust weights of windows (Huber 1964), (windows,).

        `place` is the index in `priors.sizes` of the model error's scale.
        """
        size, forces = self.priors.sizes[place], self.priors.force_size(place)
        square = np.mean(spread.whitening(self.at).white(errors, size, forces) ** 2, axis=1)
        limit = self.at.problem.thresholds.robust_limit
        return robust_weight(square / max(float(np.median(square)), 1.0), limit)

    def fit(
        self,
        new: Candidate,
        kappa: float,
        *,
        renewals: int = thresholds.RENEWALS,
        give_up: float = np.inf,
        beside: bool = False,
    ) -> Fit:
        """Fits a set.

        Args:
            new: The set, and the linearisation whose tangents the fit corrects.
            kappa: Initial 1/design effect.
            renewals: Largest number of times that all tangents are computed anew.
            give_up: Median error beyond which the fit is abandoned, in noise levels.
            beside: Whether all other parameters start at the values of another set's fit and move
                with the members from the first iteration on.
        """
        iteration = _Iteration(self, new.members, renewals, give_up)
        state = iteration.begin(new, kappa, beside=beside)
        while not state.ended:
            state = iteration.step(state)
        _, score = iteration.judged(replace(state, places=None))
        members, point, finished = new.members, state.point, state.ended != "unfinished"
        return Fit(
            members=members,
            keys=self.at.unknowns.names(members),
            columns=replace(point.columns, fine=state.fine),
            spread=state.spread,
            weight=state.weight,
            score=score,
            level=self.level(point.errors),
            ended=self._ended(members, point.x, score.values),
            finished=finished,
            unkept=max(state.unkept, 0.0),
            gained=0.0 if finished else state.gained,
        )

    def _point(
        self,
        hypothesis: Hypothesis,
        errors: np.ndarray,
        tangents: np.ndarray,
        members: Sequence[int],
        values: np.ndarray | None = None,
    ) -> Point:
        """Builds a point; by default members' values are the whole departures of their unknowns."""
        u = self.at.unknowns
        x = u.departures(hypothesis)
        if values is None:
            values = np.array([x[list(u.singles(q))].mean() for q in members])
        deviations = x[: u.single].copy()
        for q, value in zip(members, values, strict=True):
            deviations[list(u.singles(q))] -= value
        return Point(hypothesis, errors, x, values, deviations, tangents)

    def _stepped(
        self,
        evidence: Evidence,
        score: Score,
        point: Point,
        dampings: Sequence[float],
        *,
        lower: bool,
    ) -> tuple[float, tuple[float, float, np.ndarray, Point] | None]:
        """Tries a step per damping; returns the undamped step's predicted gain, and the best step.

        The best step is its damping, its gain [nats], its errors less those by tangents, and its
        point; None if no step lowers the cost. If `lower`, the median error in noise levels may not
        grow either, because until a gross fault is explained, the model-error covariance contains
        the pattern of its errors, so that any errors of this pattern cost little.
        """
        highest = self.level(point.errors) if lower else np.inf
        before = self._cost(evidence, score, point.errors, point.values, point.deviations)
        u, single, members = self.at.unknowns, self.at.unknowns.single, score.unknowns

        def step(damping: float, bend: np.ndarray | None = None) -> tuple[np.ndarray, ...]:
            values, deviations = evidence.step(score, point.values, damping, bend)
            return values, deviations, self._by(members, values, deviations, point)

        def promised(values: np.ndarray, deviations: np.ndarray, by: np.ndarray) -> float:
            errors = point.errors + point.tangents[:, :, :single] @ by
            return 0.5 * (before - self._cost(evidence, score, errors, values, deviations))

        promise = promised(*step(0.0))
        best, lowest = None, before
        for damping in dampings:
            values, deviations, by = step(damping)
            own = promised(values, deviations, by)
            if own < thresholds.ENOUGH:
                break
            for _ in range(1 + thresholds.BENDS):
                moved = u.moved(point.hypothesis, {i: d for i, d in enumerate(by.tolist()) if d})
                errors = self.at.at(moved)
                after = self._cost(evidence, score, errors, values, deviations)
                if after < lowest and self.level(errors) <= highest:
                    best, lowest = (damping, moved, errors, values, deviations), after
                if before - after > own:
                    break
                # The next step is corrected for the curvature of errors observed at the end of
                # this step (second-order correction; Fletcher 1982).
                bend = errors - point.errors - point.tangents[:, :, :single] @ by
                bend[np.abs(errors).max(axis=1) > thresholds.BLOWN] = 0.0
                values, deviations, by = step(damping, bend)
            # A step that gains little of its prediction is too long (Conn, Gould and Toint 2000).
            if 0.5 * (before - lowest) > SMALL * own:
                break
        if best is None:
            return promise, None
        damping, moved, errors, values, deviations = best
        x = u.departures(moved)
        tangents, off = _broyden(
            point.tangents, errors - point.errors, x - point.x, members, single
        )
        new = Point(moved, errors, x, values, deviations, tangents)
        return promise, (damping, 0.5 * (before - lowest), off, new)

    def _by(
        self, members: Sequence[int], values: np.ndarray, deviations: np.ndarray, point: Point
    ) -> np.ndarray:
        """Computes moves of single unknowns from `point` to the arguments, (single,)."""
        u = self.at.unknowns
        goal = deviations.copy()
        for q, value in zip(members, values, strict=True):
            goal[list(u.singles(q))] += value
        return goal - point.x[: u.single]

    def _cost(
        self,
        evidence: Evidence,
        score: Score,
        errors: np.ndarray,
        values: np.ndarray,
        deviations: np.ndarray,
    ) -> float:
        """Computes twice the negative log posterior at a score's model-error scale and spread."""
        square = self._square(evidence, score, errors)
        spread = evidence.priors.spreads[score.spread]
        precision, _ = evidence.priors.precision(self.at.unknowns, spread)
        fault = float(2.0 * np.log1p((values / thresholds.FAULT_SIZE) ** 2).sum())
        return square + float(deviations @ precision @ deviations) + fault

    def _square(self, evidence: Evidence, score: Score, errors: np.ndarray) -> float:
        """Computes the weighted squared error at a score's model-error scale."""
        white = evidence.white(errors, score)
        return evidence.kappa * float((evidence.weight[:, None] * white**2).sum())

    def _shapes(self, members: Sequence[int]) -> list[int]:
        """Returns shape parameters of the members' effects; without the effect, they do nothing."""
        u = self.at.unknowns
        keys = frozenset[Key]().union(*(u.library_keys(q) for q in members))
        return [i for i in range(u.single) if u.shape[i] and u.keys[i] in keys]

    def _own_tangents(
        self, point: Point, members: Sequence[int], coarse: bool, most: np.ndarray | None = None
    ) -> Point:
        """Returns the point with new tangents of the members and their shapes."""
        at, u = self.at, self.at.unknowns
        which = [q for q in members if q < u.single] + self._shapes(members)
        step = thresholds.COARSE if coarse else thresholds.FINE
        out = at.tangents(point.hypothesis, point.errors, which, step, point.tangents, most)
        for q in members:
            if q >= u.single:
                h = max(step[0], step[1] * abs(float(np.mean(point.x[list(u.singles(q))]))))
                moved = at.at(u.moved(point.hypothesis, {q: h}))
                out[:, :, q] = change(point.errors, moved) / h
        return replace(point, tangents=out)

    def _all_tangents(
        self, point: Point, members: Sequence[int], telling: np.ndarray, most: np.ndarray | None
    ) -> Point:
        """Returns the point with new tangents of members and of the unknowns in `telling`."""
        u = self.at.unknowns
        own = {i for q in members for i in u.singles(q)} | set(self._shapes(members))
        which = [
            i
            for i in range(u.single)
            if i in own or (u.gradual[i] and not u.shape[i] and bool(telling[i]))
        ]
        known = point.tangents.copy()
        known[:, :, : u.single][:, :, u.shape[: u.single]] = 0.0
        out = self.at.tangents(point.hypothesis, point.errors, which, thresholds.FINE, known, most)
        return replace(point, tangents=out)

    def _on_ladder(self, evidence: Evidence, score: Score, point: Point) -> Point | None:
        """Moves nonlinear members to the best multiple in `LADDER`; None if none is better."""
        u, begun, members = self.at.unknowns, point, score.unknowns
        lowest = self._cost(evidence, score, point.errors, point.values, point.deviations)
        for n, q in enumerate(members):
            now = float(point.values[n])
            sizes = sorted(
                {float(np.clip(f * now, u.lower[q], u.upper[q])) for f in thresholds.LADDER}
            )
            sizes = [y for y in sizes if abs(y - now) > SAME * abs(now)]
            if len(sizes) < 2:
                continue
            ends = (sizes[1], sizes[-2]) if len(sizes) > 3 else (sizes[0], sizes[-1])
            tried = self._at_sizes(point, members, n, ends)
            low, high = (self._white(tried[y].errors - point.errors) / (y - now) for y in ends)
            # If the tangent hardly changes, Gauss-Newton finds the value without further replays.
            if np.linalg.norm(high - low) < 0.2 * np.linalg.norm(low):
                continue
            tried |= self._at_sizes(point, members, n, [y for y in sizes if y not in tried])
            for one in tried.values():
                cost = self._cost(evidence, score, one.errors, one.values, point.deviations)
                if cost < lowest:
                    lowest, point = cost, one
        return None if point is begun else self._own_tangents(point, members, True)

    def _at_sizes(
        self, point: Point, members: Sequence[int], n: int, sizes: Sequence[float]
    ) -> dict[float, Point]:
        """Returns points that differ from `point` in the n-th member's value, by this value."""
        u, now = self.at.unknowns, float(point.values[n])
        moved = [u.moved(point.hypothesis, {members[n]: size - now}) for size in sizes]
        found = {}
        for size, hypothesis, errors in zip(sizes, moved, self.at.each(moved), strict=True):
            values = np.where(np.arange(point.values.size) == n, size, point.values)
            found[size] = self._point(hypothesis, errors, point.tangents, members, values)
        return found

    def _ended(self, members: Sequence[int], x: np.ndarray, values: np.ndarray) -> tuple[int, ...]:
        """Returns members at a bound, except a lower bound of 0 (no friction), which is valid."""
        u, found = self.at.unknowns, []
        for q, value in zip(members, values, strict=True):
            v = float(value if q >= u.single else x[q])
            near = SAME * max(abs(v), 1e-9)
            key, i = u.places[q][0]
            natural = u.library.sites[key].lower[i] == 0.0
            above = v >= u.upper[q] - near and u.upper[q] > 0
            if above or (v <= u.lower[q] + near and u.lower[q] < 0 and not natural):
                found.append(q)
        return tuple(found)


class _Iteration:
    """Gauss-Newton iteration of one fit: each iteration computes tangents and takes a step."""

    def __init__(
        self, fitter: Fitter, members: tuple[int, ...], renewals: int, give_up: float
    ) -> None:
        self.fitter, self.members = fitter, members
        self.renewals, self.give_up = renewals, give_up

    def begin(self, new: Candidate, kappa: float, *, beside: bool) -> State:
        """Returns the state before the first iteration; arguments are those of `Fitter.fit`."""
        fitter, columns = self.fitter, new.columns
        spread, weight = new.spread, new.weight
        point = fitter._point(columns.base, columns.errors, columns.tangents, new.members)
        if new.start:
            moved = fitter.at.unknowns.moved(columns.base, new.start)
            errors = fitter.at.at(moved)
            if new.members or beside or fitter.level(errors) < fitter.level(point.errors):
                point = fitter._point(moved, errors, columns.tangents, new.members)
                spread, weight = fitter.about(errors)
        return State(
            point=point,
            spread=spread,
            weight=weight,
            kappa=kappa,
            stiff=0 if beside or not new.members else thresholds.STIFF_FIRST,
            fine=columns.fine,
            taken=columns.x,
            off=_beyond(columns, point),
        )

    def judged(self, s: State, *, stiff: bool = False) -> tuple[Evidence, Score]:
        """Scores a state; if `stiff`, under priors that nearly fix all other parameters."""
        fitter = self.fitter
        priors = fitter._stiff if stiff else None
        made = fitter.evidence(s.point.columns, s.spread, s.weight, s.kappa, priors)
        return made, made.score([(q, None) for q in self.members], most=s.places)

    def step(self, s: State) -> State:
        """Returns the state after one more iteration."""
        if s.iterations == thresholds.ITERATIONS:
            return replace(s, ended="unfinished")
        fitter, first = self.fitter, s.iterations < s.stiff
        s, fresh = self._with_tangents(s, first)
        if s.ended:
            return s
        evidence, score = self.judged(s, stiff=first)
        s = replace(s, missed=s.missed + 0.5 * fitter._square(evidence, score, s.off))
        if first and (other := fitter._on_ladder(evidence, score, s.point)):
            s = replace(s, point=other)
            evidence, score = self.judged(s, stiff=True)
        if not first:
            s = replace(s, most=evidence.visible(score))
        if s.renewed:
            # Model-error scale and spread may only fall now: if they alternated, so would the fit.
            s = replace(s, places=(score.size, score.spread))
        # The smallest damping tried is one value below that of the last step; with all tangents
        # renewed, and in the first iterations, it is 0.
        begin = 0 if first or fresh else max(thresholds.DAMPINGS.index(s.damping) - 1, 0)
        dampings = thresholds.DAMPINGS[:1] if first else thresholds.DAMPINGS[begin:]
        promise, then = fitter._stepped(evidence, score, s.point, dampings, lower=first)
        s = replace(s, iterations=s.iterations + 1)
        if then is not None:
            return self._after(s, first, fresh, evidence, score, promise, then)
        if first:
            return replace(s, stiff=s.iterations)
        # If no step reaches the gain that tangents predict, the tangents are wrong.
        if self._exact(s, fresh, promise):
            return replace(s, ended="finished", unkept=promise)
        return replace(s, slow=True, missed=np.inf, off=0.0 * s.off)

    def _exact(self, s: State, fresh: bool, promise: float) -> bool:
        """Tests whether tangents are good enough to end the fit."""
        return fresh or (s.fine and s.missed + promise < thresholds.ENOUGH)

    def _with_tangents(self, s: State, first: bool) -> tuple[State, bool]:
        """Renews the tangents of the set, or of all parameters after large prediction errors.

        Returns the state and whether all tangents were renewed.
        """
        fitter, members = self.fitter, self.members
        wrong = s.missed > thresholds.ENOUGH and (s.slow or s.renewed < self.renewals)
        if first or not wrong:
            return replace(s, point=fitter._own_tangents(s.point, members, first, s.most)), False
        if s.renewed == self.renewals:
            return replace(s, ended="unfinished"), False
        evidence, score = self.judged(s)
        which, most = evidence.telling(score), evidence.visible(score)
        if s.renewed:
            # Tangents of parameters that hardly move need no renewal.
            step = fitter._by(members, *evidence.step(score, s.point.values, 0.0), s.point)
            gone = np.maximum(np.abs(step), np.abs(s.point.x - s.taken)[: step.size])
            which = which & (gone > thresholds.FINE[0] * most)
        point, renewed = fitter._all_tangents(s.point, members, which, most), s.renewed + 1
        new = replace(s, point=point, taken=point.x, most=most, fine=True, renewed=renewed)
        return replace(new, missed=0.0), True

    def _after(
        self,
        s: State,
        first: bool,
        fresh: bool,
        evidence: Evidence,
        score: Score,
        promise: float,
        then: tuple[float, float, np.ndarray, Point],
    ) -> State:
        """Returns the state after a step, see `Fitter._stepped`."""
        fitter, (damping, gain, off, point) = self.fitter, then
        spread = fitter.own_spread(point.errors)
        weight = fitter.weights(point.errors, spread, score.size)
        s = replace(s, damping=damping, off=off, point=point, spread=spread, weight=weight)
        if not first:
            # The better a set explains the recordings, the less its errors are correlated.
            kappa = 1.0 / max(evidence.design_effect(score), 1.0)
            s = replace(s, gained=s.gained + gain, kappa=kappa)
        if s.iterations >= thresholds.STIFF_FIRST and fitter.level(point.errors) > self.give_up:
            # Small departures of all other parameters may still reduce the error.
            there, ahead = self.judged(s)
            if fitter.level(there.left(ahead)) > self.give_up:
                return replace(s, ended="given up")
        if not first and gain < thresholds.ENOUGH:
            if self._exact(s, fresh, promise - gain):
                return replace(s, ended="finished", unkept=promise - gain)
            s = replace(s, missed=np.inf)
        return replace(s, slow=damping > 0.0 or gain < thresholds.NEAR)


def _beyond(columns: Columns, point: Point) -> np.ndarray:
    """Computes errors at a point less those predicted by a linearisation, (windows, rows)."""
    single = point.deviations.size
    moved = (point.x - columns.x)[:single]
    return np.asarray(point.errors - columns.errors - columns.tangents[:, :, :single] @ moved)


def _broyden(
    tangents: np.ndarray, change: np.ndarray, moved: np.ndarray, members: Sequence[int], single: int
) -> tuple[np.ndarray, np.ndarray]:
    """Corrects tangents by the error of their prediction over a step (Broyden 1965).

    If members moved, only their tangents change. Also returns this error, (windows, rows).
    """
    direction = moved[:single].copy()
    along = np.zeros(single)
    own = [q for q in members if q < single]
    along[own] = direction[own]
    if not along.any():
        along = direction
    norm = float(direction @ along)
    missed = change - tangents[:, :, :single] @ direction
    if norm <= 1e-12:
        return tangents, missed
    out = tangents.copy()
    out[:, :, :single] += missed[:, :, None] * (along / norm)
    return out, missed
