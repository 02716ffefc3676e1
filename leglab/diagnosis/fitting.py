"""Nonlinear fits of effects and nuisance parameters to whitened replay errors."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leglab.diagnosis.hypothesis import Hypothesis, Key
from leglab.diagnosis.residual import Nuisance, Problem, robust_cost, robust_weight

_REWEIGHTINGS = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class Sums:
    """What a step needs of the residuals r and tangents J of windows.

    Attributes:
        matrices: J'J of each window, shape (windows, unknowns, unknowns).
        gradients: J'r, (windows, unknowns).
        squares: r'r, (windows,).
        size: Numbers in a window.
    """

    matrices: np.ndarray
    gradients: np.ndarray
    squares: np.ndarray
    size: int

    @classmethod
    def of(cls, residual: np.ndarray, jacobian: np.ndarray) -> "Sums":
        """Sums of residuals, shape (windows, size), and tangents, (windows, size, unknowns)."""
        across = jacobian.transpose(0, 2, 1)
        return cls(
            matrices=across @ jacobian,
            gradients=(across @ residual[:, :, None])[:, :, 0],
            squares=np.einsum("wn,wn->w", residual, residual),
            size=residual.shape[1],
        )

    def only(self, unknowns: Sequence[int]) -> "Sums":
        """The same for some of the unknowns."""
        index = np.asarray(unknowns, dtype=int)
        return Sums(
            matrices=self.matrices[:, index[:, None], index],
            gradients=self.gradients[:, index],
            squares=self.squares,
            size=self.size,
        )

    def mean_squares(self, x: np.ndarray) -> np.ndarray:
        """Mean squares of windows after a step, (windows,)."""
        bent = np.einsum("i,wij,j->w", x, self.matrices, x)
        return np.maximum(self.squares + 2.0 * self.gradients @ x + bent, 0.0) / self.size

    def cost(self, x: np.ndarray) -> float:
        """Robust chi-square after a step."""
        return float(self.size * robust_cost(self.mean_squares(x)).sum())

    def step(
        self,
        prior_now: np.ndarray,
        prior_weight: np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
        damping: float = 0.0,
    ) -> np.ndarray:
        """Robust least-squares step within bounds, shape (unknowns,); see `solve_step`."""
        count = prior_now.size
        x = np.zeros(count)
        for _ in range(_REWEIGHTINGS):
            weight = robust_weight(self.mean_squares(x))
            matrix = np.einsum("w,wij->ij", weight, self.matrices)
            matrix[np.diag_indices(count)] *= 1.0 + damping
            ridge = 1e-12 * np.trace(matrix) / max(count, 1)
            matrix[np.diag_indices(count)] += prior_weight + ridge
            right = -(weight @ self.gradients + prior_weight * prior_now)
            x = _bounded(matrix, right, lower, upper)
        return x


def solve_step(
    residual: np.ndarray,
    jacobian: np.ndarray,
    prior_now: np.ndarray,
    prior_weight: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    damping: float = 0.0,
) -> np.ndarray:
    """Robust least-squares step within bounds, shape (unknowns,).

    Minimises sum_w rho(|r_w + J_w x|^2) + sum prior_weight (prior_now + x)^2 by iteratively
    reweighted least squares (Holland and Welsch 1977); unknowns that hit a bound are fixed there.

    Args:
        residual: Shape (windows, size).
        jacobian: Shape (windows, size, unknowns).
        prior_now: Present departures from the priors' means, in tolerances, (unknowns,).
        prior_weight: 1 for an unknown under a prior, 0 for a free one, (unknowns,).
        lower: Smallest step, (unknowns,).
        upper: Largest step, (unknowns,).
        damping: Levenberg-Marquardt damping, relative to the diagonal.
    """
    return Sums.of(residual, jacobian).step(prior_now, prior_weight, lower, upper, damping)


def _bounded(
    matrix: np.ndarray, right: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> np.ndarray:
    """Minimises x'Mx/2 - right'x with bounds: whoever leaves them is fixed at the bound."""
    x = np.zeros(right.size)
    fixed = np.zeros(right.size, dtype=bool)
    for _ in range(right.size + 1):
        free = ~fixed
        if not free.any():
            break
        rest = right[free] - matrix[np.ix_(free, fixed)] @ x[fixed]
        x[free] = np.linalg.solve(matrix[np.ix_(free, free)], rest)
        outside = free & ((x < lower) | (x > upper))
        if not outside.any():
            break
        x[outside] = np.clip(x[outside], lower[outside], upper[outside])
        fixed |= outside
    return np.clip(x, lower, upper)


# A nuisance parameter stays within this many tolerances: beyond, it is an effect.
BOX = 4.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """A fitted hypothesis.

    Attributes:
        hypothesis: Values of effects and nuisances.
        free: Effects whose parameters were free.
        cost: Robust chi-square plus the priors' at the fit.
        residual: Whitened errors of the chosen windows, shape (chosen windows, size).
        tangents: d(residual)/d(nuisance in tolerances) that was used, same windows.
    """

    hypothesis: Hypothesis
    free: frozenset[Key]
    cost: float
    residual: np.ndarray
    tangents: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class FreeTangents:
    """d(residual)/d(parameters of free effects), in steps of their scales.

    Attributes:
        columns: Shape (chosen windows, size, parameters).
        lower: Largest step down that the bounds allow, (parameters,).
        upper: Largest step up, (parameters,).
    """

    columns: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


def free_tangents(
    problem: Problem,
    hypothesis: Hypothesis,
    free: frozenset[Key],
    residual: np.ndarray,
    chosen: np.ndarray,
    fine: float = 1.0,
) -> FreeTangents:
    """Tangents of the parameters of free effects, by finite differences of relevant size.

    Near the end of a fit a `fine` below 1 makes differences that much smaller.
    """
    columns, lower, upper = [], [], []
    for key in sorted(free):
        site = problem.library.sites[key]
        values = hypothesis.get(key, site.nominal)
        for i, p in enumerate(site.parameters):
            step = fine * max(0.1 * p.scale, 0.03 * abs(values[i] - p.nominal))
            if values[i] + step > p.upper:
                step = -step
            moved = values.copy()
            moved[i] += step
            other = problem.residual(hypothesis.with_values(key, moved), chosen)
            columns.append((other - residual) * (p.scale / step))
            lower.append((p.lower - values[i]) / p.scale)
            upper.append((p.upper - values[i]) / p.scale)
    stacked = np.stack(columns, axis=2) if columns else np.zeros((*residual.shape, 0))
    return FreeTangents(columns=stacked, lower=np.array(lower), upper=np.array(upper))


def profiled(
    problem: Problem,
    hypothesis: Hypothesis,
    residual: np.ndarray,
    tangents: np.ndarray,
    nuisances: Sequence[Nuisance],
    own: FreeTangents,
) -> float:
    """Cost after nuisances and free parameters have done, to first order, what they can."""
    count = own.columns.shape[2]
    jacobian = np.concatenate([own.columns, tangents], axis=2)
    step = _first_order(problem, hypothesis, residual, jacobian, nuisances, own)
    now = departures(problem, hypothesis, nuisances)
    moved = residual + jacobian @ step
    return problem.cost(moved, float(((now + step[count:]) ** 2).sum()))


def profiled_step(
    problem: Problem,
    hypothesis: Hypothesis,
    residual: np.ndarray,
    tangents: np.ndarray,
    nuisances: Sequence[Nuisance],
    own: FreeTangents,
) -> np.ndarray:
    """Steps of the free parameters to first order, nuisances following, (parameters,)."""
    jacobian = np.concatenate([own.columns, tangents], axis=2)
    step = _first_order(problem, hypothesis, residual, jacobian, nuisances, own)
    return step[: own.columns.shape[2]]


def _first_order(
    problem: Problem,
    hypothesis: Hypothesis,
    residual: np.ndarray,
    jacobian: np.ndarray,
    nuisances: Sequence[Nuisance],
    own: FreeTangents,
) -> np.ndarray:
    now = departures(problem, hypothesis, nuisances)
    count = own.columns.shape[2]
    return solve_step(
        residual,
        jacobian,
        np.concatenate([np.zeros(count), now]),
        np.concatenate([np.zeros(count), np.ones(now.size)]),
        np.concatenate([own.lower, -BOX - now]),
        np.concatenate([own.upper, BOX - now]),
    )


def departures(
    problem: Problem, hypothesis: Hypothesis, nuisances: Sequence[Nuisance]
) -> np.ndarray:
    """Departures of the nuisances from their expected values, in tolerances, (nuisances,)."""
    values = problem.nuisance_values(hypothesis, nuisances)
    return np.array([(v - n.nominal) / n.tolerance for v, n in zip(values, nuisances, strict=True)])


def refit(
    problem: Problem,
    start: Hypothesis,
    free: frozenset[Key],
    chosen: np.ndarray,
    tangents: np.ndarray,
    nuisances: Sequence[Nuisance],
    *,
    iterations: int = 5,
    residual: np.ndarray | None = None,
    tolerance: float = 2e-3,
    fine: float = 1.0,
) -> Fit:
    """Levenberg-Marquardt over the parameters of free effects and the nuisances.

    Args:
        problem: What is fitted.
        start: Where the fit starts.
        free: Effects whose parameters are free.
        chosen: Mask of windows.
        tangents: Of the nuisances, shape (chosen windows, size, nuisances); they are kept.
        nuisances: Those that belong to the columns; ones of free effects are left alone.
        iterations: Largest number of accepted steps.
        residual: At the start, where known.
        fine: Factor on the finite differences.
        tolerance: Stops when a step gains less than this share of the cost.
    """
    keep = [i for i, n in enumerate(nuisances) if n.key not in free]
    nuisances = [nuisances[i] for i in keep]
    tangents = tangents[:, :, keep]
    keys = sorted(free)
    sites = [problem.library.sites[k] for k in keys]
    scale = _joined([np.array([p.scale for p in site.parameters]) for site in sites])

    def unpack(theta: np.ndarray, eta: np.ndarray, base: Hypothesis) -> Hypothesis:
        at = 0
        for key, site in zip(keys, sites, strict=True):
            base = base.with_values(key, theta[at : at + len(site.parameters)])
            at += len(site.parameters)
        values = np.array(
            [n.nominal + e * n.tolerance for n, e in zip(nuisances, eta, strict=True)]
        )
        return problem.moved(base, nuisances, values)

    theta = _joined([start.get(k, s.nominal) for k, s in zip(keys, sites, strict=True)])
    eta = departures(problem, start, nuisances)
    hypothesis = unpack(theta, eta, start)
    if residual is None:
        residual = problem.residual(hypothesis, chosen)
    cost = problem.cost(residual, float((eta**2).sum()))
    damping = 1e-3
    for _ in range(iterations):
        own = free_tangents(problem, hypothesis, free, residual, chosen, fine)
        jacobian = np.concatenate([own.columns, tangents], axis=2)
        weight = np.concatenate([np.zeros(theta.size), np.ones(eta.size)])
        now = np.concatenate([np.zeros(theta.size), eta])
        lower = np.concatenate([own.lower, -BOX - eta])
        upper = np.concatenate([own.upper, BOX - eta])
        better = False
        for _ in range(4):
            step = solve_step(residual, jacobian, now, weight, lower, upper, damping)
            new_theta = theta + step[: theta.size] * scale
            new_eta = eta + step[theta.size :]
            trial = unpack(new_theta, new_eta, hypothesis)
            other = problem.residual(trial, chosen)
            new_cost = problem.cost(other, float((new_eta**2).sum()))
            if new_cost < cost:
                better = True
                break
            damping = max(damping, 1e-2) * 10.0
        if not better:
            break
        gained = cost - new_cost
        theta, eta, hypothesis, residual, cost = new_theta, new_eta, trial, other, new_cost
        damping *= 0.1
        if gained < tolerance * cost:
            break
    return Fit(hypothesis=hypothesis, free=free, cost=cost, residual=residual, tangents=tangents)


def _joined(parts: list[np.ndarray]) -> np.ndarray:
    return np.concatenate(parts) if parts else np.zeros(0)
