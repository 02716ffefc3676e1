"""Marginal likelihood of sets of effects (assumed faults), by normal equations at one point.

The errors have covariance N + s^2 D: N from sensors, start states and time step, D from model error
of unknown scale s. Parameters of a set ("members") have the prior of faults (slab). All others have
that of good machines (spike): normal, with an unknown standard deviation, here called the spread
(George and McCulloch 1993). Log likelihoods are divided by the design effect, since errors are
correlated (Pauli, Racugno and Ventura 2011).
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_solve
from scipy.linalg.lapack import dtrtrs
from scipy.special import logsumexp

from leglab.diagnosis.likelihood.columns import Columns, Errors
from leglab.diagnosis.likelihood.priors import Priors, log_fault, slab_curvature
from leglab.diagnosis.likelihood.spread import Spread
from leglab.diagnosis.thresholds import (
    CERTAIN,
    FAULT_ODDS,
    FEW_RECORDINGS,
    FINE,
    NEGLIGIBLE,
    SECANT,
    SMALL,
)

# Parameter of a set: index of the unknown; index of its jump (finite step), None for its tangent.
Member = tuple[int, int | None]

# Relative rounding error of a sum of squares.
ROUNDING = 1e-14
# An unknown is fixed by adding this multiple of its curvature. In sums with a larger multiple, the
# unknowns that are free would keep fewer than half of their digits.
HELD = ROUNDING**-0.5


def parts_of(recording: np.ndarray) -> np.ndarray:
    """Returns each window's part: the index of its recording, or of a piece if these are few."""
    every = np.unique(recording)
    pieces = 1 if every.size >= FEW_RECORDINGS else int(np.ceil(2 * FEW_RECORDINGS / every.size))
    out, count = np.zeros(recording.size, dtype=int), 0
    for r in every:
        own = np.flatnonzero(recording == r)
        for run in np.array_split(own, min(pieces, max(1, own.size // 2))):
            out[run] = count
            count += 1
    return out


@dataclass(frozen=True, eq=False)
class Score:
    """Evidence of a set of effects."""

    members: tuple[Member, ...]  #: Parameters of the set
    log: float  #: Log evidence: log of the marginal likelihood times prior odds
    fit: float  #: Log evidence without prior odds, fault priors and the members' determinant
    size: int  #: Index of the most probable scale of the model error
    spread: int  #: Index of the most probable standard deviation between machines
    values: np.ndarray  #: Departures of the members from the specimen, (members,)
    deviations: np.ndarray  #: Standard deviations of `values`
    shift: np.ndarray  #: Changes of all single unknowns, to which `values` are added, (single,)
    coefficients: np.ndarray  #: Factors on the members' tangents or jumps

    @property
    def unknowns(self) -> tuple[int, ...]:
        """Indices of the members' unknowns."""
        return tuple(u for u, _ in self.members)


@dataclass(frozen=True, eq=False)
class _Steps:
    """Most probable steps of members at every model-error scale and spread."""

    factors: np.ndarray  #: Factors on the members' tangents or jumps, (scales, spreads, members)
    values: np.ndarray  #: Departures of the members, (scales, spreads, members)
    deviations: np.ndarray  #: Standard deviations of `values`
    square: np.ndarray  #: Squared whitened error after the steps, (scales, spreads)
    log: np.ndarray  #: Log of the integral of fault priors over the members, (scales, spreads)


class _Reduced:
    """Inner products of errors, tangents and jumps (columns), with single unknowns integrated out.

    `gram` are the products before this integration, (scales, columns, columns), and `log` the log
    determinants of the errors' covariance, (scales,), for each scale of the model error. `base` is
    the log evidence of the empty set without its quadratic term, (scales, spreads). `stays` has the
    mask of the single unknowns (one parameter of one element each) that are fixed at a bound.
    """

    def __init__(
        self,
        evidence: "Evidence",
        gram: np.ndarray,
        log: np.ndarray,
        stays: Mapping[tuple[int, int], np.ndarray] | None = None,
    ) -> None:
        priors, u, n = evidence.priors, evidence.unknowns, evidence.unknowns.single
        self.gram, self._kappa = gram, evidence.kappa
        self._now = now = evidence.columns.x[:n]
        self.base = np.zeros((len(evidence.places), len(priors.spreads)))
        self._precisions = []
        self._roots: dict[tuple[int, int], np.ndarray] = {}
        self._every: dict[tuple[int, int], np.ndarray] = {}
        self.stays = dict(stays or {})
        lower, upper = u.lower[:n] - now, u.upper[:n] - now
        for o, deviation in enumerate(priors.spreads):
            precision, log_prior = priors.precision(u, deviation)
            self._precisions.append(precision)
            for k, place in enumerate(evidence.places):
                data = self._kappa * gram[k, : 1 + n, : 1 + n]
                if stays is None:
                    self.stays[k, o] = _held(data, precision, now, lower, upper)
                matrix, prior = data[1:, 1:] + precision, log_prior
                hold = HELD * self.stays[k, o] * np.diag(matrix)
                if hold.any():
                    prior = np.linalg.slogdet(precision + np.diag(hold))[1]
                # The term covers rounding only: a larger one would be a prior against departures.
                matrix[np.diag_indices(n)] *= 1.0 + ROUNDING
                root = np.linalg.cholesky(matrix + np.diag(hold))
                self._roots[k, o] = root
                self.base[k, o] = (
                    0.5 * prior
                    - np.log(np.diag(root)).sum()
                    - 0.5 * self._kappa * log[k]
                    + priors.log_sizes[place]
                )

    def _beside_priors(self, k: int, o: int, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns products, with priors, of columns `held` with each other and single unknowns."""
        gram, n = self._kappa * self.gram[k][:, held], self._now.size
        whole, cross = gram[held], gram[1 : 1 + n]
        if held.size and held[0] == 0:
            pulled = self._precisions[o] @ self._now
            whole[0, 0] += self._now @ pulled
            cross[:, 0] += pulled
        return whole, cross

    def inner(self, k: int, o: int, held: np.ndarray) -> np.ndarray:
        """Computes reduced products of sorted columns `held` at scale k, spread o, (held, held)."""
        whole, cross = self._beside_priors(k, o, held)
        half = dtrtrs(self._roots[k, o].T, cross, lower=0, trans=1)[0]
        return np.asarray(whole - half.T @ half)

    def several(self, held: np.ndarray) -> np.ndarray:
        """Computes `inner` at all scales and spreads, (scales, spreads, held, held)."""
        sizes, spreads = self.base.shape
        return np.array([[self.inner(k, o, held) for o in range(spreads)] for k in range(sizes)])

    def every(self, k: int, o: int) -> np.ndarray:
        """Computes `inner` of all columns at scale k and spread o, (columns, columns)."""
        if (k, o) not in self._every:
            self._every[k, o] = self.inner(k, o, np.arange(self.gram.shape[1]))
        return self._every[k, o]

    def follow(self, k: int, o: int, along: np.ndarray) -> np.ndarray:
        """Computes the most probable changes of single unknowns for a step `along` columns."""
        used = np.flatnonzero(along)
        _, cross = self._beside_priors(k, o, used)
        return np.asarray(-cho_solve((self._roots[k, o], True), cross @ along[used]))


class Evidence:
    """Evidence of any set of effects at one linearisation.

    Args:
        at: Errors in the windows of the fit.
        columns: The linearisation.
        spread: Covariance of the model error.
        weight: Weights of windows, (windows,).
        kappa: Factor on the log likelihood, 1/design effect.
        priors: Priors of parameters and of the model error's scale.
        places: Indices of the model-error scales to use in `priors.sizes`; None for all.
    """

    def __init__(
        self,
        at: Errors,
        columns: Columns,
        spread: Spread,
        weight: np.ndarray,
        kappa: float,
        priors: Priors,
        places: Sequence[int] | None = None,
    ) -> None:
        self.at, self.columns, self.priors, self.kappa = at, columns, priors, kappa
        self.unknowns, self.spread, self.weight = at.unknowns, spread, weight
        self.places = tuple(range(len(priors.sizes)) if places is None else places)
        self.part = parts_of(at.recording)
        self.gram, self.log_covariance = self._products(np.ones(self.part.size, dtype=bool))

    def _white(
        self, sizes: Iterable[int], own: np.ndarray
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yields whitened columns of the windows `own` and log determinants, scale by scale."""
        columns, whitening = self.columns, self.spread.whitening(self.at)
        stacked = [columns.errors[own][:, :, None], columns.tangents[own], columns.changes[own]]
        turned = whitening.basis[own] @ np.concatenate(stacked, axis=2)
        for k in sizes:
            place = self.places[k]
            factors, log = whitening.at(self.priors.sizes[place], self.priors.force_size(place))
            weight = self.weight[own]
            factors = factors[own] * np.sqrt(weight)[:, None]
            yield factors[:, :, None] * turned, weight * log[own]

    def _products(self, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Computes inner products of columns, (scales, columns, columns), and log determinants."""
        gram, logs = [], []
        for white, log in self._white(range(len(self.places)), own):
            flat = white.reshape(-1, white.shape[2])
            gram.append(flat.T @ flat)
            logs.append(log.sum())
        return np.stack(gram), np.array(logs)

    def white(self, errors: np.ndarray, score: Score) -> np.ndarray:
        """Whitens errors by the covariance at a score's model-error scale, (windows, rows)."""
        size, forces = self.priors.sizes[score.size], self.priors.force_size(score.size)
        return self.spread.whitening(self.at).white(errors, size, forces)

    def _against(self, errors: np.ndarray, score: Score) -> np.ndarray:
        """Computes weighted inner products of all tangents with errors, (unknowns,)."""
        size, forces = self.priors.sizes[score.size], self.priors.force_size(score.size)
        whitening = self.spread.whitening(self.at)
        factors, _ = whitening.at(size, forces)
        scaled = self.weight[:, None] * factors * whitening.white(errors, size, forces)
        back = (scaled[:, None, :] @ whitening.basis)[:, 0]
        return np.asarray(np.einsum("wr,wru->u", back, self.columns.tangents, optimize=True))

    def with_kappa(self, kappa: float) -> "Evidence":
        """Returns a copy with another `kappa`, without the cached products `whole`."""
        other = copy(self)
        other.kappa = kappa
        other.__dict__.pop("whole", None)
        return other

    @cached_property
    def subsets(self) -> list[np.ndarray]:
        """Parts that are left out together: each part alone, then those of each recording.

        A recording is added if it has several parts and is not the only one.
        """
        first = np.unique(self.part, return_index=True)[1]
        owner = self.at.recording[first]
        whole = [np.flatnonzero(owner == r) for r in np.unique(owner)]
        return [np.array([r]) for r in range(first.size)] + [
            own for own in whole if 1 < own.size < first.size
        ]

    def apart(
        self, members: Sequence[Member], spread: int | None = None, *, recordings: bool = False
    ) -> list[Score]:
        """Scores a set with each part (see `parts_of`) left out in turn; `spread` as in `score`.

        With `recordings`, all `subsets` are left out in turn.
        """
        count = int(self.part.max()) + 1
        parts = [self._products(self.part == r) for r in range(count)]
        found = []
        for out in self.subsets[: None if recordings else count]:
            # The other parts are summed, since rounding can make total less one part indefinite.
            gram, log = np.zeros_like(self.gram), np.zeros_like(self.log_covariance)
            for r in np.setdiff1d(np.arange(count), out):
                gram, log = gram + parts[r][0], log + parts[r][1]
            # Unknowns are fixed at the same bounds as in the evidence of all windows.
            reduced = _Reduced(self, gram, log, self.whole.stays)
            found.append(self.score(members, reduced, spread))
        return found

    @cached_property
    def whole(self) -> _Reduced:
        """Reduced products of all windows."""
        return _Reduced(self, self.gram, self.log_covariance)

    def _columns_of(
        self, members: Sequence[Member]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Returns members' columns: index, departure per unit of the factor, factor's bounds."""
        u, rows = self.unknowns, []
        for unknown, jump in members:
            low = max(u.lower[unknown], -np.inf if u.below[unknown] else 0.0)
            high = min(u.upper[unknown], np.inf if u.above[unknown] else 0.0)
            if jump is None:
                rows.append((1 + unknown, 1.0, low, high))
            else:
                by = self.columns.jumps[jump][1]
                low, high = sorted((low / by, high / by))
                high = max(SECANT[0], min(SECANT[1], high))
                rows.append((1 + len(u) + jump, by, max(SECANT[0], low), high))
        index, unit, lower, upper = np.array(rows).reshape(-1, 4).T.copy()
        return index.astype(int), unit, lower, upper

    def odds(self, members: Sequence[int]) -> float:
        """Computes a set's prior log odds over the empty set; -inf if two are `Errors.twins`."""
        u = self.unknowns
        keys = u.names(members)
        if any(pair <= keys for pair in self.at.twins):
            return -np.inf
        first = len(keys) * np.log(FAULT_ODDS / max(u.sites, 1))
        return float(first + (len(members) - len(keys)) * np.log(FAULT_ODDS))

    def score(
        self,
        members: Sequence[Member],
        reduced: _Reduced | None = None,
        spread: int | None = None,
        most: tuple[int, int] | None = None,
    ) -> Score:
        """Computes the evidence of a set from `reduced`, by default the products of all windows.

        `spread` is the index of the only standard deviation between machines to use, `most` are the
        largest indices of the model-error scale and of this deviation; None for no restriction.
        """
        members = tuple(members)
        own = reduced or self.whole
        steps = self._steps(own, members)
        fits = own.base - 0.5 * steps.square
        usual = self.priors.usual(np.abs(steps.values).max(axis=2, initial=0.0))
        if spread is not None:
            usual[:, np.arange(fits.shape[1]) != spread] = False
        if most is not None:
            usual &= np.array(self.places)[:, None] <= most[0]
            usual[:, most[1] + 1 :] = False
        fits[~usual] = -np.inf
        grid = fits + steps.log + self.odds([q for q, _ in members])
        k, o = np.unravel_index(int(np.argmax(grid)), grid.shape)
        along = np.zeros(self.gram.shape[1])
        along[0] = 1.0
        np.add.at(along, self._columns_of(members)[0], steps.factors[k, o])
        return Score(
            members=members,
            log=float(logsumexp(grid)),
            fit=float(logsumexp(fits)),
            size=self.places[k],
            spread=int(o),
            values=steps.values[k, o],
            deviations=steps.deviations[k, o],
            shift=own.follow(int(k), int(o), along),
            coefficients=steps.factors[k, o],
        )

    def _steps(self, own: _Reduced, members: Sequence[Member]) -> _Steps:
        """Computes the most probable steps of members from reduced products."""
        u, m = self.unknowns, len(members)
        index, unit, lower, upper = self._columns_of(members)
        held = np.unique([0, *index])
        inner, place = own.several(held), np.searchsorted(held, index)
        first = inner[:, :, :, 0]
        matrix = inner[:, :, place[:, None], place]
        matrix = matrix + (1e-9 * np.einsum("koii->koi", matrix) + 1e-12)[..., None] * np.eye(m)
        gradient = first[:, :, place]
        steps = _bounded(matrix, gradient, lower, upper)
        square = first[:, :, 0] + 2.0 * (gradient * steps).sum(axis=2)
        values = steps * unit
        # If the errors' changes by two members cancel, only the fault prior determines the members.
        bound = matrix + (slab_curvature(values) * unit**2)[..., None] * np.eye(m)
        _, log_matrix = np.linalg.slogdet(bound)
        return _Steps(
            factors=steps,
            values=values,
            deviations=np.sqrt(np.einsum("koii->koi", np.linalg.inv(bound))) * np.abs(unit),
            square=square + np.einsum("koi,koij,koj->ko", steps, matrix, steps),
            log=0.5 * m * np.log(2.0 * np.pi)
            - 0.5 * log_matrix
            + np.log(np.abs(unit)).sum()
            + log_fault(u, np.array([q for q, _ in members], dtype=int), values).sum(axis=2),
        )

    def additions(self, score: Score) -> list[tuple[float, Member]]:
        """Ranks parameters to add to a set by the first-order gain of log evidence, best first.

        The gain is the largest at the score's model-error scale or any smaller one, because a model
        error that is estimated while an effect is missing has the effect's shape and hides it.
        """
        u = self.unknowns
        on = set(score.unknowns)
        there = u.names(on)
        both: list[Member] = [(q, j) for j, (q, _) in enumerate(self.columns.jumps)]
        both += [(q, None) for q in range(len(u))]
        also = [m for m in both if u.nameable[m[0]] and m[0] not in on]
        if not also:
            return []
        index, unit, lower, upper = self._columns_of(also)
        inside, _, _, _ = self._columns_of(score.members)
        own = self.whole
        best: dict[Member, float] = {}
        here = self.places.index(score.size)
        for k in range(here + 1):
            inner = own.every(k, score.spread)
            first = inner[:, 0]
            first = first + (inner[:, inside] @ score.coefficients if inside.size else 0.0)
            slope, curve = first[index], inner[index, index].copy()
            if inside.size:
                block = inner[np.ix_(inside, inside)]
                block = block + 1e-9 * np.diag(np.diag(block) + 1e-12)
                cross = inner[np.ix_(inside, index)]
                turned = np.linalg.solve(block, cross)
                curve -= (cross * turned).sum(axis=0)
                if k != here:
                    slope = slope - turned.T @ first[inside]
            safe = np.maximum(curve, 1e-12)
            step = np.clip(-slope / safe, lower, upper)
            gain = -slope * step - 0.5 * safe * step**2
            which = np.array([q for q, _ in also])
            held = safe + slab_curvature(step * unit) * unit**2
            gain = gain + 0.5 * np.log(2.0 * np.pi / held) + np.log(np.abs(unit))
            gain = gain + log_fault(u, which, step * unit)
            known = np.array([u.keys[q] in there for q in which.tolist()])
            gain = gain + np.where(known, np.log(FAULT_ODDS), np.log(FAULT_ODDS / max(u.sites, 1)))
            gain = np.where(curve <= 1e-9, -np.inf, gain)
            for member, value in zip(also, gain.tolist(), strict=True):
                best[member] = max(best.get(member, -np.inf), value)
        return sorted(((g, m) for m, g in best.items() if np.isfinite(g)), key=lambda e: -e[0])

    def likeness(self, score: Score) -> np.ndarray:
        """Returns the reduced products (see `_Reduced`) of jumps at a score's scale and spread."""
        inner = self.whole.every(self.places.index(score.size), score.spread)
        first = 1 + len(self.unknowns)
        return inner[first:, first:]

    def left(self, score: Score) -> np.ndarray:
        """Predicts the errors at the optimum of a score, to first order, (windows, rows)."""
        columns, n = self.columns, self.unknowns.single
        errors = columns.errors + columns.tangents[:, :, :n] @ score.shift
        for (q, jump), step in zip(score.members, score.coefficients, strict=True):
            moved = columns.tangents[:, :, q] if jump is None else columns.changes[:, :, jump]
            errors = errors + step * moved
        return errors

    def telling(self, score: Score) -> np.ndarray:
        """Tests for which single unknowns the data's information exceeds a tenth of the prior's.

        The information is not multiplied by `kappa`, because `kappa` grows while a fit improves.
        """
        k, n = self.places.index(score.size), self.unknowns.single
        precision, _ = self.priors.precision(self.unknowns, self.priors.spreads[score.spread])
        data = np.diag(self.gram[k])[1 : 1 + n]
        return np.asarray(data * np.diag(np.linalg.inv(precision)) > SMALL)

    def visible(self, score: Score) -> np.ndarray:
        """Computes steps of single unknowns that change whitened errors by an RMS of 1, (single,).

        Over longer steps, a tangent's prediction may err by more than the scatter of the errors.
        """
        k, n = self.places.index(score.size), self.unknowns.single
        rows = float(self.weight.sum()) * self.columns.errors.shape[1]
        return np.sqrt(rows / np.maximum(np.diag(self.gram[k])[1 : 1 + n], ROUNDING))

    def _free(self, score: Score) -> np.ndarray:
        """Tests which single unknowns may move: parameters of the set, and all in `telling`."""
        free = self.telling(score)
        free[[i for q in score.unknowns for i in self.unknowns.singles(q)]] = True
        return free

    def posterior(self, score: Score) -> np.ndarray:
        """Computes the posterior covariance, (single, single), under wide priors of members."""
        u, k, n = self.unknowns, self.places.index(score.size), self.unknowns.single
        precision, _ = self.priors.precision(u, self.priors.spreads[score.spread])
        free = [i for q in score.unknowns for i in u.singles(q)]
        precision[free] = precision[:, free] = 0.0
        precision[free, free] = (u.upper - u.lower)[free].clip(1.0) ** -2.0
        gram = self.gram[k][1 : 1 + n, 1 : 1 + n]
        return np.asarray(np.linalg.inv(self.kappa * gram + precision))

    def step(
        self, score: Score, values: np.ndarray, damping: float, beyond: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Computes the most probable values of members and single unknowns within their bounds.

        The model-error scale and spread are the score's; members move along tangents. Unknowns
        outside of `_free` stay, since each gains less than half a nat and makes replays slower.

        Args:
            score: The set.
            values: Departures of the members at the linearisation, (members,).
            damping: Share added to each unknown's curvature, so that unknowns that compensate each
                other hardly move where errors are nonlinear (Marquardt 1963).
            beyond: Errors of a replay less those by tangents, (windows, rows); None for 0.

        Returns:
            Departures of the members, (members,), and of the single unknowns, (single,).
        """
        u, n = self.unknowns, self.unknowns.single
        k = self.places.index(score.size)
        index, _, low, high = self._columns_of([(q, None) for q in score.unknowns])
        use = np.concatenate([1 + np.arange(n), index])
        gram = self.kappa * self.gram[k]
        precision, _ = self.priors.precision(u, self.priors.spreads[score.spread])
        matrix, gradient = gram[np.ix_(use, use)], gram[use, 0].copy()
        matrix[:n, :n] += precision
        # A normal prior with its weight at this magnitude replaces a fault's Cauchy prior.
        now = self.columns.x[:n]
        size = np.array([now[list(u.singles(q))].mean() for q in score.unknowns])
        matrix[range(n, n + index.size), range(n, n + index.size)] += slab_curvature(size)
        gradient[:n] += precision @ now
        if beyond is not None:
            gradient += self.kappa * self._against(beyond, score)[use - 1]
        lower = np.concatenate([u.lower[:n] - now, low])
        upper = np.concatenate([u.upper[:n] - now, high])
        parts = [i for q in score.unknowns for i in u.singles(q)]
        lower[parts], upper[parts] = -np.inf, np.inf
        begin = np.concatenate([np.zeros(n), values])
        for q, value in zip(score.unknowns, values, strict=True):
            begin[list(u.singles(q))] -= value
        gradient, lower, upper = gradient + matrix @ begin, lower - begin, upper - begin
        matrix[np.diag_indices_from(matrix)] *= 1.0 + ROUNDING + damping
        free = np.concatenate([self._free(score), np.ones(index.size, dtype=bool)])
        begin[free] += _bounded(
            matrix[np.ix_(free, free)], gradient[free], lower[free], upper[free]
        )
        return begin[n:], now + begin[:n]

    def departures(self, score: Score) -> dict[int, float]:
        """Returns the changes of unknowns from the linearisation to the optimum of a score."""
        shift = np.where(self._free(score), score.shift, 0.0)
        moved = {i: float(d) for i, d in enumerate(shift) if d != 0.0}
        for (q, _), value in zip(score.members, score.values, strict=True):
            moved[q] = moved.get(q, 0.0) + float(value)
        return moved

    def design_effect(self, score: Score) -> float:
        """Computes the design effect: the number of errors per independent error.

        It is the variance of the gradients g_r of R parts of the recordings over the variance for
        independent errors: R/(R-1) sum_r (v'(g_r - mean g))^2/(v'Hv), averaged over the
        eigenvectors v of H = J'C^-1 J that the data determine (Ribatet, Cooley and Davison 2012).
        """
        k, n = self.places.index(score.size), self.unknowns.single
        index, _, _, _ = self._columns_of(score.members)
        use = np.concatenate([1 + np.arange(n), index])
        full = np.zeros(self.gram.shape[1])
        full[0] = 1.0
        full[1 : 1 + n] += score.shift
        np.add.at(full, index, score.coefficients)
        white, _ = next(self._white([k], np.ones(self.part.size, dtype=bool)))
        slope = np.einsum("wrc,wr->wc", white[:, :, use], white @ full)
        count = int(self.part.max()) + 1
        if count < 2:
            return 1.0
        slopes = np.stack([slope[self.part == r].sum(axis=0) for r in range(count)])
        curvature = self.gram[k][np.ix_(use, use)]
        root = np.sqrt(np.diag(curvature) + 1e-12)
        values, vectors = np.linalg.eigh(curvature / np.outer(root, root))
        keep = values > NEGLIGIBLE * values.max()
        turned = (vectors[:, keep] / np.sqrt(values[keep])) / root[:, None]
        z = (slopes - slopes.mean(axis=0)) @ turned
        return float((z**2).sum() * count / (count - 1) / keep.sum())


def _held(
    data: np.ndarray, precision: np.ndarray, now: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> np.ndarray:
    """Selects the single unknowns whose optimum lies beyond a bound, where they are to be fixed.

    An example is friction at zero. Unknowns far from their prior were fitted as faults and stay
    free. `data` are inner products of errors and tangents, bounds are relative to `now`.
    """
    near = np.minimum(-lower, upper) < FINE[0]
    if not near.any():
        return near
    free = now**2 * np.diag(precision) > CERTAIN**2
    own = np.where(free[:, None] | free, 0.0, precision)
    matrix, slope = data[1:, 1:] + own, data[1:, 0] + own @ now
    matrix[np.diag_indices_from(matrix)] *= 1.0 + ROUNDING
    matrix[np.diag_indices_from(matrix)] += ROUNDING
    step = _bounded(matrix, slope, lower, upper)
    return near & ~free & ((step <= lower) | (step >= upper))


def _bounded(
    matrix: np.ndarray, gradient: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> np.ndarray:
    """Minimises x'Mx/2 + g'x within bounds, (..., m), by fixing coordinates that pass a bound."""
    m = gradient.shape[-1]
    x = -np.linalg.solve(matrix, gradient[..., None])[..., 0]
    held = np.zeros(x.shape, dtype=bool)
    for _ in range(m + 1):
        out = ~held & ((x < lower - 1e-12) | (x > upper + 1e-12))
        if not out.any():
            break
        held |= out
        x = np.where(held, np.clip(x, lower, upper), 0.0)
        right = -(gradient + np.einsum("...ij,...j->...i", matrix, x))
        free = (~held).astype(float)
        system = matrix * free[..., None, :] * free[..., :, None]
        system = system + (1.0 - free)[..., None] * np.eye(m)
        x = x + free * np.linalg.solve(system, (right * free)[..., None])[..., 0]
    return np.clip(x, lower, upper)
