"""Robust least-squares steps from sums over windows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leglab.diagnosis.problem import robust_cost, robust_weight

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
