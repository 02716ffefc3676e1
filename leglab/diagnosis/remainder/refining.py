"""Refinement of a remainder by replay: a robust Gauss-Newton fit with the balances as prior."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from leglab.diagnosis.effects.hypothesis import Hypothesis, Key
from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.remainder.forms import Form, diagonal_blocks
from leglab.diagnosis.remainder.part import LearnedLibrary, Part, Period
from leglab.diagnosis.remainder.splines import Spline
from leglab.diagnosis.replay.residual import Problem, robust_cost, robust_weight

# Directions of the unknowns that replays refine, those the balances know least; of all parts.
_DIRECTIONS = 24
# Weights of the balances against the replays that are tried.
_PRIORS = (3e-3, 1e-1, 3.0)
# Finite differences, in standard deviations that the balances leave.
_STEP = 0.5
# The same of what differs between good machines, in tolerances.
_STEP_OF_TOLERANCE = 0.2
# Robust reweightings in a step.
_REWEIGHTINGS = 6
# A wave longer than this share of the position's range is not called periodic.
_LONGEST = 1.25
_FOLDS = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Directions:
    """Values of all forms' unknowns about the balances' estimate, along principal directions.

    Attributes:
        forms: Of all parts.
        directions: Of each form, in standard deviations: (unknowns, directions).
    """

    forms: tuple[Form, ...]
    directions: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, forms: Sequence[Form]) -> "Directions":
        """The directions in which the balances leave most open."""
        each = max(3, _DIRECTIONS // max(len(forms), 1))
        found = []
        for form in forms:
            scale = np.sqrt(np.maximum(np.diag(form.covariance), 1e-300))
            limit = scale.size if form.harmonics else each  # of sines all count
            values, vectors = np.linalg.eigh(form.covariance / np.outer(scale, scale))
            order = np.argsort(-values)[:limit]
            root = np.sqrt(np.maximum(values[order], 0.0))
            found.append(scale[:, None] * vectors[:, order] * root)
        return cls(forms=tuple(forms), directions=tuple(found))

    @property
    def count(self) -> int:
        """Number of directions."""
        return sum(d.shape[1] for d in self.directions)

    def precision(self, weight: float) -> np.ndarray:
        """Inverse prior covariance of z with the balances at a weight, (directions, directions).

        Smoothness keeps its full weight.
        """
        return diagonal_blocks(
            [
                d.T @ (weight * form.information + form.smoothness) @ d
                for form, d in zip(self.forms, self.directions, strict=True)
            ]
        )

    def parts(self, z: np.ndarray, spread: np.ndarray | None = None) -> tuple[Part, ...]:
        """The parts at a place along the directions, (directions,).

        Args:
            z: In standard deviations of the balances' estimates.
            spread: Covariance of z, for the interval of a period.
        """
        out, place = [], 0
        for form, directions in zip(self.forms, self.directions, strict=True):
            own = slice(place, place + directions.shape[1])
            place = own.stop
            values = form.values + directions @ z[own]
            covariance = form.covariance
            if spread is not None:
                covariance = directions @ spread[own, own] @ directions.T
            balance = form.balance
            terms = {
                variable: Spline(knots=form.knots[variable], coefficients=weights)
                for variable, weights in form.coefficients(values).items()
            }
            out.append(
                Part(
                    element=balance.element,
                    joint=balance.joint,
                    actuator=balance.actuator,
                    oil=balance.oil,
                    terms=terms,
                    period=_period(form, values, covariance),
                )
            )
        return tuple(out)


def _period(form: Form, values: np.ndarray, covariance: np.ndarray) -> Period | None:
    place = form.period_place
    if place is None:
        return None
    span = float(np.ptp(form.knots["position"][[0, -1]]))
    if not 0.0 < values[place] < _LONGEST * span:
        return None  # The replays have made a bow of it.
    length, half = float(values[place]), 1.96 * float(np.sqrt(covariance[place, place]))
    pairs = values[place - 2 * form.harmonics : place].reshape(-1, 2)
    return Period(
        length=length,
        interval=(length - half, length + half),
        amplitudes=tuple(np.hypot(*pairs.T).tolist()),
    )


def with_parts(problem: Problem, parts: Sequence[Part]) -> Problem:
    """The same problem, all of whose hypotheses have learned parts."""
    other = copy(problem)
    other.library = LearnedLibrary(problem.library, parts)
    return other


@dataclass(frozen=True, kw_only=True, eq=False)
class Refined:
    """Parts after the refinement.

    Attributes:
        parts: Learned.
        hypothesis: The hypothesis, its nuisances refitted beside them.
    """

    parts: tuple[Part, ...]
    hypothesis: Hypothesis


def refine(
    problem: Problem,
    hypothesis: Hypothesis,
    forms: Sequence[Form],
    chosen: np.ndarray,
    *,
    free: frozenset[Key] = frozenset(),
    iterations: int = 4,
) -> Refined:
    """Fits directions of the forms and nuisances to replays.

    Args:
        problem: With its noise model.
        hypothesis: Where nuisances start.
        forms: First estimates by the balances.
        chosen: Windows to fit, shape (windows,).
        free: Effects whose values stay as they are.
        iterations: Accepted steps at most.
    """
    directions = Directions.of(forms)
    z, base = np.zeros(directions.count), hypothesis
    u = Unknowns.of(problem.library)
    # What differs between good machines follows.
    open_ = [i for i in range(u.single) if u.tolerance[i] > 0.0 and u.keys[i] not in free]
    spread = None
    for iteration in range(iterations):
        now = with_parts(problem, directions.parts(z))
        # The noise model of a base without its parts tells little of start states.
        if iteration < 2:
            noise = now.about(base).noise
        now.noise = noise
        residual = now.residual(base, chosen)
        x = u.departures(base)
        eta = x[open_] / u.tolerance[open_]
        tangents = [
            (now.residual(u.moved(base, {i: h}), chosen) - residual) * (u.tolerance[i] / h)
            for i, h in ((i, _STEP_OF_TOLERANCE * u.tolerance[i]) for i in open_)
        ]
        columns = []
        for k in range(z.size):
            moved = z.copy()
            moved[k] += _STEP
            there = with_parts(problem, directions.parts(moved))
            there.noise = noise
            columns.append((there.residual(base, chosen) - residual) / _STEP)
        linear = Linear(
            residual=residual,
            jacobian=np.stack([*columns, *tangents], axis=2),
            offset=np.concatenate([z, eta]),
            limit=problem.thresholds.robust_limit,
        )
        tried = []
        for weight in _PRIORS:
            precision = diagonal_blocks([directions.precision(weight), np.eye(eta.size)])
            tried.append((linear.validated(precision), weight, precision))
        _, _, precision = min(tried, key=lambda t: t[:2])
        step, matrix, scale = linear.step(precision)
        before = linear.cost(residual, scale) + float(linear.offset @ precision @ linear.offset)
        share = 1.0
        for _ in range(5):
            new_z = z + share * step[: z.size]
            by = share * step[z.size :] * u.tolerance[open_]
            new_base = u.moved(base, dict(zip(open_, by.tolist(), strict=True)))
            there = with_parts(problem, directions.parts(new_z))
            there.noise = noise
            departed = np.concatenate([new_z, u.departures(new_base)[open_] / u.tolerance[open_]])
            after = linear.cost(there.residual(new_base, chosen), scale)
            after += float(departed @ precision @ departed)
            if after < before:
                break
            share *= 0.4
        else:
            break
        z, base = new_z, new_base
        spread = np.linalg.pinv(matrix, hermitian=True)[: z.size, : z.size]
        if before - after < 1e-2 * before:
            break
    return Refined(parts=directions.parts(z, spread), hypothesis=base)


@dataclass(frozen=True, kw_only=True, eq=False)
class Linear:
    """Whitened errors of windows to first order in all unknowns.

    Attributes:
        residual: Shape (windows, size).
        jacobian: Shape (windows, size, unknowns).
        offset: Present departures from the priors' means, (unknowns,).
        limit: Mean square beyond which a window counts by its logarithm.
    """

    residual: np.ndarray
    jacobian: np.ndarray
    offset: np.ndarray
    limit: float

    def cost(self, residual: np.ndarray, scale: float) -> float:
        """Robust chi-square with errors in units of `scale` noise levels."""
        squares = np.mean(residual**2, axis=1) / scale**2
        return float(residual.shape[1] * robust_cost(squares, self.limit).sum())

    def of(self, mask: np.ndarray) -> "Linear":
        """Some of the windows."""
        return replace(self, residual=self.residual[mask], jacobian=self.jacobian[mask])

    def step(self, precision: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Robust step of all unknowns, its normal matrix, and the scale of what is left.

        A model that is wrong elsewhere leaves errors of many noise levels. Their scale, the median
        window after the step, weighs replays against priors (Kennedy and O'Hagan 2001).
        """
        matrices = self.jacobian.transpose(0, 2, 1) @ self.jacobian
        rights = np.einsum("wnk,wn->wk", self.jacobian, self.residual)
        x = np.zeros(self.offset.size)
        matrix, scale = precision, 1.0
        for _ in range(_REWEIGHTINGS):
            squares = np.mean((self.residual + self.jacobian @ x) ** 2, axis=1)
            scale = max(1.0, float(np.sqrt(np.median(squares))))
            weight = robust_weight(squares / scale**2, self.limit) / scale**2
            matrix = np.einsum("w,wij->ij", weight, matrices) + precision
            matrix += 1e-12 * np.trace(matrix) / max(len(matrix), 1) * np.eye(len(matrix))
            x = np.linalg.solve(matrix, -(weight @ rights + precision @ self.offset))
        return x, matrix, scale

    def validated(self, precision: np.ndarray) -> float:
        """Logarithmic misfit of windows under steps that the windows of other folds ask for."""
        total = 0.0
        fold = np.arange(len(self.residual)) * _FOLDS // max(len(self.residual), 1)
        for k in range(_FOLDS):
            own = fold == k
            if own.all() or not own.any():
                continue
            x, _, _ = self.of(~own).step(precision)
            rest = self.residual[own] + self.jacobian[own] @ x
            total += float(np.log(0.1 + np.mean(rest**2, axis=1)).sum())
        return total


def bounded(part: Part, form: Form) -> Part:
    """The part with a bound a little above what it reaches on its data."""
    reach = float(np.max(np.abs(part.at(form.balance.inputs))))
    return replace(part, bound=1.05 * reach) if reach > 0.0 else part
