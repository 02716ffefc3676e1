"""Nonlinear fits of effects and nuisance parameters to whitened replay errors."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag, solve_triangular
from scipy.optimize import lsq_linear

from leglab.diagnosis.effects.hypothesis import Hypothesis, Key, Site
from leglab.diagnosis.former.nuisances import departures
from leglab.diagnosis.replay.residual import Linearisation, Problem, robust_cost, robust_weight
from leglab.diagnosis.thresholds import DEFAULT, Thresholds


@dataclass(frozen=True, kw_only=True, eq=False)
class Unknowns:
    """Priors and bounds of a step's unknowns, each of shape (unknowns,).

    Attributes:
        now: Present departures from the priors' means, in tolerances.
        prior: Weight of the squared departure of an unknown under a prior; 0 for a free one.
        lower: Smallest step.
        upper: Largest step.
    """

    now: np.ndarray
    prior: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    @classmethod
    def of(
        cls,
        lower: np.ndarray,
        upper: np.ndarray,
        eta: np.ndarray,
        box: float,
        weight: float = 1.0,
    ) -> "Unknowns":
        """Free unknowns within bounds, then nuisances at departures, which stay within a box.

        `weight` is that of the nuisances' squared departures.
        """
        free = np.zeros(lower.size)
        return cls(
            now=np.concatenate([free, eta]),
            prior=np.concatenate([free, np.full(eta.size, weight)]),
            lower=np.concatenate([lower, -box - eta]),
            upper=np.concatenate([upper, box - eta]),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Sums:
    """Sums over the residuals r and tangents J of windows, which a step needs.

    Attributes:
        matrices: J'J of each window, shape (windows, unknowns, unknowns).
        gradients: J'r, (windows, unknowns).
        squares: r'r, (windows,).
        size: Numbers in a window.
        thresholds: Of the robust cost.
    """

    matrices: np.ndarray
    gradients: np.ndarray
    squares: np.ndarray
    size: int
    thresholds: Thresholds = DEFAULT

    @classmethod
    def of(
        cls, residual: np.ndarray, jacobian: np.ndarray, thresholds: Thresholds = DEFAULT
    ) -> "Sums":
        """Sums of residuals, shape (windows, size), and tangents, (windows, size, unknowns)."""
        across = jacobian.transpose(0, 2, 1)
        return cls(
            matrices=across @ jacobian,
            gradients=(across @ residual[:, :, None])[:, :, 0],
            squares=np.einsum("wn,wn->w", residual, residual),
            size=residual.shape[1],
            thresholds=thresholds,
        )

    def only(self, unknowns: Sequence[int]) -> "Sums":
        """The same for some of the unknowns."""
        index = np.asarray(unknowns, dtype=int)
        matrices = self.matrices[:, index[:, None], index]
        return replace(self, matrices=matrices, gradients=self.gradients[:, index])

    def mean_squares(self, x: np.ndarray) -> np.ndarray:
        """Mean squares of windows after a step, (windows,)."""
        bent = np.einsum("i,wij,j->w", x, self.matrices, x)
        return np.maximum(self.squares + 2.0 * self.gradients @ x + bent, 0.0) / self.size

    def cost(self, x: np.ndarray) -> float:
        """Robust chi-square after a step."""
        costs = robust_cost(self.mean_squares(x), self.thresholds.robust_limit)
        return float(self.size * costs.sum())

    def step(self, unknowns: Unknowns, damping: float = 0.0) -> np.ndarray:
        """Robust least-squares step within bounds, shape (unknowns,).

        Minimises sum_w rho(|r_w + J_w x|^2) + sum prior (now + x)^2 by iteratively reweighted
        least squares (Holland and Welsch 1977), with a Levenberg-Marquardt damping relative to the
        diagonal.
        """
        count = unknowns.now.size
        diagonal = np.diag_indices(count)
        x = np.zeros(count)
        for _ in range(self.thresholds.reweightings):
            weight = robust_weight(self.mean_squares(x), self.thresholds.robust_limit)
            matrix = np.einsum("w,wij->ij", weight, self.matrices)
            matrix[diagonal] *= 1.0 + damping
            ridge = 1e-12 * np.trace(matrix) / max(count, 1)
            matrix[diagonal] += unknowns.prior + ridge
            right = -(weight @ self.gradients + unknowns.prior * unknowns.now)
            x = np.linalg.solve(matrix, right)
            bounds = unknowns.lower, unknowns.upper
            if not ((bounds[0] <= x) & (x <= bounds[1])).all():
                root = np.linalg.cholesky(matrix)
                target = solve_triangular(root, right, lower=True)
                # Stark and Parker 1995; unknowns at a bound may come back beyond it by rounding.
                x = np.clip(lsq_linear(root.T, target, bounds, method="bvls").x, *bounds)
        return x


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """A fitted hypothesis.

    Attributes:
        free: Effects whose parameters were free.
        cost: Robust chi-square plus the priors' at the fit.
        at: Values of effects and nuisances, with the residual there and the tangents used.
    """

    free: frozenset[Key]
    cost: float
    at: Linearisation

    @property
    def hypothesis(self) -> Hypothesis:
        """Values of effects and nuisances."""
        return self.at.base

    def with_hypothesis(self, hypothesis: Hypothesis) -> "Fit":
        """The same under another hypothesis, not fitted anew."""
        return replace(self, at=replace(self.at, base=hypothesis))


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

    def by(self, moves: np.ndarray) -> "FreeTangents":
        """Of unknowns that move parameters together, by a matrix >= 0, (parameters, unknowns)."""
        moved = moves > 0.0
        share = np.divide(1.0, moves, out=np.zeros_like(moves), where=moved)
        return FreeTangents(
            columns=self.columns @ moves,
            lower=np.where(moved, self.lower[:, None] * share, -np.inf).max(
                axis=0, initial=-np.inf
            ),
            upper=np.where(moved, self.upper[:, None] * share, np.inf).min(axis=0, initial=np.inf),
        )


def _moves(site: Site, alike: bool) -> np.ndarray:
    """Parameters of a site, in their scales, by the unknowns of a fit, (parameters, unknowns)."""
    scale = np.array([p.scale for p in site.parameters])
    return scale.min() / scale[:, None] * site.alike if alike else np.eye(scale.size)


def free_tangents(
    problem: Problem, at: Linearisation, free: Collection[Key], fine: float = 1.0
) -> FreeTangents:
    """Tangents of the parameters of free effects, by finite differences of relevant size.

    Near the end of a fit a `fine` below 1 makes differences that much smaller.
    """
    columns, lower, upper = [], [], []
    for key in sorted(free):
        site = problem.library.sites[key]
        values = at.base.get(key, site.nominal)
        for i, p in enumerate(site.parameters):
            step = fine * max(0.1 * p.scale, 0.03 * abs(values[i] - p.nominal))
            if values[i] + step > p.upper:
                step = -step
            moved = values.copy()
            moved[i] += step
            other = problem.residual(at.base.with_values(key, moved), at.chosen)
            columns.append((other - at.residual) * (p.scale / step))
            lower.append((p.lower - values[i]) / p.scale)
            upper.append((p.upper - values[i]) / p.scale)
    stacked = np.stack(columns, axis=2) if columns else np.zeros((*at.residual.shape, 0))
    return FreeTangents(columns=stacked, lower=np.array(lower), upper=np.array(upper))


def profiled(problem: Problem, at: Linearisation, own: FreeTangents) -> tuple[np.ndarray, float]:
    """Best step of free parameters to first order, nuisances following.

    Returns:
        Step of the free parameters, shape (parameters,), and the cost after it.
    """
    count, eta = own.lower.size, departures(at.base, at.nuisances)
    jacobian = np.concatenate([own.columns, at.tangents], axis=2)
    weight = problem.prior_weight(at.chosen)
    unknowns = Unknowns.of(own.lower, own.upper, eta, problem.thresholds.nuisance_box, weight)
    step = Sums.of(at.residual, jacobian, problem.thresholds).step(unknowns)
    prior = weight * float(((eta + step[count:]) ** 2).sum())
    return step[:count], problem.cost(at.residual + jacobian @ step, prior)


def refit(
    problem: Problem,
    at: Linearisation,
    free: frozenset[Key],
    *,
    start: Hypothesis | None = None,
    iterations: int = 5,
    tolerance: float = 2e-3,
    fine: float = 1.0,
    alike: Collection[Key] = (),
) -> Fit:
    """Levenberg-Marquardt over the parameters of free effects and the nuisances.

    Args:
        problem: Recordings and machine.
        at: Tangents of the nuisances, which are kept; those of free effects are left alone.
        free: Effects whose parameters are free.
        start: Where the fit starts; None for where the tangents were taken.
        iterations: Largest number of accepted steps.
        tolerance: Stops when a step gains less than this share of the cost.
        fine: Factor on the finite differences.
        alike: Free effects whose two directions go on from the start by the same amounts.
    """
    at = at.without(free)
    sites = [problem.library.sites[key] for key in sorted(free)]
    ends = np.cumsum([len(site.parameters) for site in sites])[:-1]
    scale = np.array([p.scale for site in sites for p in site.parameters])
    moves = block_diag(np.zeros((0, 0)), *(_moves(site, site.key in alike) for site in sites))
    count = moves.shape[1]

    def placed(theta: np.ndarray, eta: np.ndarray, base: Hypothesis) -> Hypothesis:
        for site, values in zip(sites, np.split(theta, ends) if sites else (), strict=True):
            # A step to a bound ends beyond it by rounding.
            base = base.with_values(site.key, np.clip(values, site.lower, site.upper))
        return problem.moved(base, at.nuisances, eta)

    base = at.base if start is None else start
    theta = np.concatenate([np.zeros(0), *(base.get(site.key, site.nominal) for site in sites)])
    eta = departures(base, at.nuisances)
    base = placed(theta, eta, base)
    residual = at.residual if start is None else problem.residual(base, at.chosen)
    at = replace(at, base=base, residual=residual)
    weight = problem.prior_weight(at.chosen)
    cost = problem.cost(residual, weight * float((eta**2).sum()))
    damping = 1e-3
    for _ in range(iterations):
        own = free_tangents(problem, at, free, fine).by(moves)
        jacobian = np.concatenate([own.columns, at.tangents], axis=2)
        unknowns = Unknowns.of(own.lower, own.upper, eta, problem.thresholds.nuisance_box, weight)
        sums = Sums.of(at.residual, jacobian, problem.thresholds)
        for _ in range(4):
            step = sums.step(unknowns, damping)
            new_theta = theta + moves @ step[:count] * scale
            new_eta = eta + step[count:]
            trial = placed(new_theta, new_eta, at.base)
            residual = problem.residual(trial, at.chosen)
            new_cost = problem.cost(residual, weight * float((new_eta**2).sum()))
            if new_cost < cost:
                break
            damping = max(damping, 1e-2) * 10.0
        else:
            break
        gained = cost - new_cost
        theta, eta, cost = new_theta, new_eta, new_cost
        at = replace(at, base=trial, residual=residual)
        damping *= 0.1
        if gained < tolerance * cost:
            break
    return Fit(free=free, cost=cost, at=at)
