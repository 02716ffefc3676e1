"""Marginal likelihood of sets of effects by the normal equations of one linearisation.

Errors have the covariance N + s^2 D: N of sensors, start states and time step, D of the model error
with an unknown scale s. Parameters outside of a set have the prior of good machines, normal with an
unknown deviation ("spike"), those of the set the prior of faults ("slab"; George and McCulloch
1993). Log likelihoods are divided by the design effect (Pauli, Racugno and Ventura 2011).
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

# An unknown, and the index of its jump in `Columns.jumps`; None for its tangent.
Member = tuple[int, int | None]

# Share of a sum of squares that rounding may take.
ROUNDING = 1e-14
# Fixed unknowns are pinned by this multiple of their curvature, which leaves half of the digits to
# the free ones.
HELD = ROUNDING**-0.5


def parts_of(recording: np.ndarray) -> np.ndarray:
    """Returns each window's part: its recording, or where these are few, a run of windows in it."""
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
    """Evidence of a set."""

    members: tuple[Member, ...]  #: The set
    log: float  #: Log evidence
    fit: float  #: Log evidence without the members' odds, priors and determinant
    size: int  #: Index of the most probable scale of the model error
    spread: int  #: Index of the most probable standard deviation between machines
    values: np.ndarray  #: Departures of the members, (members,)
    deviations: np.ndarray  #: Their standard deviations
    shift: np.ndarray  #: Change of all single unknowns in addition to the members, (single,)
    coefficients: np.ndarray  #: Coefficients of the members' columns

    @property
    def unknowns(self) -> tuple[int, ...]:
        """Unknowns of the members."""
        return tuple(u for u, _ in self.members)


class _Reduced:
    """Inner products of columns with the single unknowns integrated out.

    They are computed from products of all columns, `gram`, (sizes, columns, columns), and log
    determinants of the windows, `log`, (sizes,). `base` is the log evidence of the empty set less
    its quadratic term, (sizes, spreads). `stays` masks single unknowns fixed at a bound.
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
                # Only rounding is added: more would keep unknowns from small deviations.
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
        """Computes products with priors of columns, (held, held), and singles, (single, held)."""
        gram, n = self._kappa * self.gram[k][:, held], self._now.size
        whole, cross = gram[held], gram[1 : 1 + n]
        if held.size and held[0] == 0:
            pulled = self._precisions[o] @ self._now
            whole[0, 0] += self._now @ pulled
            cross[:, 0] += pulled
        return whole, cross

    def inner(self, k: int, o: int, held: np.ndarray) -> np.ndarray:
        """Computes reduced products of sorted columns at a size and spread, (held, held)."""
        whole, cross = self._beside_priors(k, o, held)
        half = dtrtrs(self._roots[k, o].T, cross, lower=0, trans=1)[0]
        return np.asarray(whole - half.T @ half)

    def several(self, held: np.ndarray) -> np.ndarray:
        """Computes reduced products of sorted columns, (sizes, spreads, held, held)."""
        sizes, spreads = self.base.shape
        return np.array([[self.inner(k, o, held) for o in range(spreads)] for k in range(sizes)])

    def every(self, k: int, o: int) -> np.ndarray:
        """Computes reduced products of all columns at a size and spread, (columns, columns)."""
        if (k, o) not in self._every:
            self._every[k, o] = self.inner(k, o, np.arange(self.gram.shape[1]))
        return self._every[k, o]

    def follow(self, k: int, o: int, along: np.ndarray) -> np.ndarray:
        """Computes the response of single unknowns to a step along the columns, (single,)."""
        used = np.flatnonzero(along)
        _, cross = self._beside_priors(k, o, used)
        return np.asarray(-cho_solve((self._roots[k, o], True), cross @ along[used]))


class Evidence:
    """Evidence of any set at one linearisation.

    Args:
        at: Errors in the windows of the fit.
        columns: The linearisation.
        spread: Covariance of the model error.
        weight: Weights of windows, (windows,).
        kappa: Share of the log likelihood that counts, 1/design effect.
        priors: Priors of parameters and of the model error's scale.
        places: Indices of the scales in the priors to use; None for all.
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
        """Yields whitened columns of some windows at each size, and log determinants."""
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
        """Computes products of columns, (sizes, columns, columns), and determinants of windows."""
        gram, logs = [], []
        for white, log in self._white(range(len(self.places)), own):
            flat = white.reshape(-1, white.shape[2])
            gram.append(flat.T @ flat)
            logs.append(log.sum())
        return np.stack(gram), np.array(logs)

    def white(self, errors: np.ndarray, score: Score) -> np.ndarray:
        """Whitens errors at the model-error scale of a score, (windows, rows)."""
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
        """Returns a copy with another `kappa` and without cached products."""
        other = copy(self)
        other.kappa = kappa
        other.__dict__.pop("whole", None)
        return other

    def apart(self, members: Sequence[Member], spread: int | None = None) -> list[Score]:
        """Scores a set without each part of the recordings in turn; `spread` is as in `score`."""
        parts = [self._products(self.part == r) for r in range(int(self.part.max()) + 1)]
        found = []
        for r in range(len(parts)):
            # Sums of the other parts: a difference from the total may lose definiteness.
            gram, log = np.zeros_like(self.gram), np.zeros_like(self.log_covariance)
            for other in parts[:r] + parts[r + 1 :]:
                gram, log = gram + other[0], log + other[1]
            # Unknowns are fixed at bounds once, by all parts of the recordings.
            reduced = _Reduced(self, gram, log, self.whole.stays)
            found.append(self.score(members, reduced, spread))
        return found

    @cached_property
    def whole(self) -> _Reduced:
        """Reduced products of all parts."""
        return _Reduced(self, self.gram, self.log_covariance)

    def _columns_of(
        self, members: Sequence[Member]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Returns members' columns: indices, trials per unit, lower and upper coefficients."""
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
        """Computes log prior odds of a set over the empty set; -inf if it holds two twins."""
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
        """Computes the evidence of a set, by `reduced` products or else those of all parts.

        `spread` is the index of the only deviation between machines to use, `most` the largest
        indices of the model-error scale and of that deviation; None for no restriction.
        """
        members = tuple(members)
        own = reduced or self.whole
        u = self.unknowns
        index, unit, lower, upper = self._columns_of(members)
        held = np.unique([0, *index])
        inner = own.several(held)
        first = inner[:, :, :, 0]
        square = first[:, :, 0]
        m = len(members)
        log_members = np.zeros(square.shape)
        values = np.zeros((*square.shape, m))
        deviations = np.zeros((*square.shape, m))
        steps = np.zeros((*square.shape, m))
        if m:
            place = np.searchsorted(held, index)
            matrix = inner[:, :, place[:, None], place]
            matrix = matrix + (1e-9 * np.einsum("koii->koi", matrix) + 1e-12)[..., None] * np.eye(m)
            gradient = first[:, :, place]
            steps = _bounded(matrix, gradient, lower, upper)
            square = square + 2.0 * (gradient * steps).sum(axis=2)
            square = square + np.einsum("koi,koij,koj->ko", steps, matrix, steps)
            values = steps * unit
            # Members that compensate each other are bounded by the fault prior alone.
            held = matrix + (slab_curvature(values) * unit**2)[..., None] * np.eye(m)
            inverse = np.linalg.inv(held)
            deviations = np.sqrt(np.einsum("koii->koi", inverse)) * np.abs(unit)
            _, log_matrix = np.linalg.slogdet(held)
            log_members = (
                0.5 * m * np.log(2.0 * np.pi)
                - 0.5 * log_matrix
                + np.log(np.abs(unit)).sum()
                + log_fault(u, np.array([q for q, _ in members]), values).sum(axis=2)
            )
        fits = own.base - 0.5 * square
        usual = self.priors.usual(np.abs(values).max(axis=2, initial=0.0))
        if spread is not None:
            usual[:, np.arange(fits.shape[1]) != spread] = False
        if most is not None:
            usual &= np.array(self.places)[:, None] <= most[0]
            usual[:, most[1] + 1 :] = False
        fits[~usual] = -np.inf
        grid = fits + log_members + self.odds([q for q, _ in members])
        k, o = np.unravel_index(int(np.argmax(grid)), grid.shape)
        step = steps[k, o]
        along = np.zeros(self.gram.shape[1])
        along[0] = 1.0
        np.add.at(along, index, step)
        return Score(
            members=members,
            log=float(logsumexp(grid)),
            fit=float(logsumexp(fits)),
            size=self.places[k],
            spread=int(o),
            values=values[k, o],
            deviations=deviations[k, o],
            shift=own.follow(int(k), int(o), along),
            coefficients=step,
        )

    def additions(self, score: Score) -> list[tuple[float, Member]]:
        """Ranks members to add to a set by their first-order gain of log evidence, best first.

        The gain is the largest over the score's model-error scale and all smaller ones: a model
        error that is estimated while an effect is missing has that effect's shape and hides it.
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
        """Computes inner products of jumps with single unknowns integrated out, (jumps, jumps).

        They are taken at the size and spread of a score.
        """
        inner = self.whole.every(self.places.index(score.size), score.spread)
        first = 1 + len(self.unknowns)
        return inner[first:, first:]

    def left(self, score: Score) -> np.ndarray:
        """Computes the errors that the fit of a score leaves, to first order, (windows, rows)."""
        columns, n = self.columns, self.unknowns.single
        errors = columns.errors + columns.tangents[:, :, :n] @ score.shift
        for (q, jump), step in zip(score.members, score.coefficients, strict=True):
            moved = columns.tangents[:, :, q] if jump is None else columns.changes[:, :, jump]
            errors = errors + step * moved
        return errors

    def telling(self, score: Score) -> np.ndarray:
        """Returns a mask of single unknowns with data information over a tenth of the prior's.

        The information is not scaled by `kappa`, which grows as explanations improve.
        """
        k, n = self.places.index(score.size), self.unknowns.single
        precision, _ = self.priors.precision(self.unknowns, self.priors.spreads[score.spread])
        data = np.diag(self.gram[k])[1 : 1 + n]
        return np.asarray(data * np.diag(np.linalg.inv(precision)) > SMALL)

    def visible(self, score: Score) -> np.ndarray:
        """Computes steps of single unknowns that change errors by their own scatter, (single,).

        Over longer steps the error of a tangent may exceed this scatter.
        """
        k, n = self.places.index(score.size), self.unknowns.single
        rows = float(self.weight.sum()) * self.columns.errors.shape[1]
        return np.sqrt(rows / np.maximum(np.diag(self.gram[k])[1 : 1 + n], ROUNDING))

    def _free(self, score: Score) -> np.ndarray:
        """Returns a mask of the single unknowns that move: those of `telling` and of members."""
        free = self.telling(score)
        free[[i for q in score.unknowns for i in self.unknowns.singles(q)]] = True
        return free

    def posterior(self, score: Score) -> np.ndarray:
        """Computes the single unknowns' posterior covariance, members free, (single, single)."""
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
        """Computes the most probable members and other single unknowns within their bounds.

        Size and spread are those of a score; members move along tangents. Unknowns that the data do
        not show stay: they gain less than half a nat, and models with more effects take time.

        Args:
            score: The set.
            values: Departures of the members at the linearisation, (members,).
            damping: Share added to each unknown's curvature, so that unknowns that compensate each
                other hardly move where errors are nonlinear (Marquardt 1963).
            beyond: Errors of a replay less those of the tangents, (windows, rows); None for 0.

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
        # The Cauchy prior of a fault's magnitude, by its weight at the present one.
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
        """Returns the moves of unknowns from the linearisation to the fit of a score."""
        shift = np.where(self._free(score), score.shift, 0.0)
        moved = {i: float(d) for i, d in enumerate(shift) if d != 0.0}
        for (q, _), value in zip(score.members, score.values, strict=True):
            moved[q] = moved.get(q, 0.0) + float(value)
        return moved

    def design_effect(self, score: Score) -> float:
        """Computes the design effect: number of errors over the number of independent ones.

        It is the variance of the gradients g_r of R parts over that of independent errors: the mean
        of R/(R-1) sum_r (v'(g_r - mean g))^2/(v'Hv) over the eigenvectors v of H = J'C^-1 J that
        the data determine (Ribatet, Cooley and Davison 2012).
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
    """Returns a mask of single unknowns at a bound that would pass it, as friction at zero.

    An unknown far from its prior is a member of the set fitted at this point, and stays free.
    `data` are inner products of errors and tangents, `lower` and `upper` bounds relative to `now`.
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
