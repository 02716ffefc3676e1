"""Additive cubic B-splines with a smoothness penalty, and what a recording's blocks say of them."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_lsq_spline

DEGREE = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class Spline:
    """A cubic B-spline of one variable, constant beyond its knots.

    Attributes:
        knots: Increasing, shape (knots,): range of the data.
        coefficients: Shape (knots + 2,).
    """

    knots: np.ndarray
    coefficients: np.ndarray

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Values at inputs of any shape."""
        inside = np.clip(x, self.knots[0], self.knots[-1])
        return BSpline(clamped(self.knots), self.coefficients, DEGREE)(inside)


def clamped(knots: np.ndarray) -> np.ndarray:
    """Knots with the outermost four times."""
    return np.pad(knots, DEGREE, mode="edge")


def basis(knots: np.ndarray, x: np.ndarray) -> np.ndarray:
    """All B-splines at clamped inputs of any shape, (..., knots + 2): their sum is one."""
    inside = np.clip(x.ravel(), knots[0], knots[-1])
    return BSpline.design_matrix(inside, clamped(knots), DEGREE).toarray().reshape(*x.shape, -1)


def roughness(knots: np.ndarray) -> np.ndarray:
    """Penalty matrix of the integrated squared second derivative, scaled to the range.

    Lines cost nothing; a knot's distance and the unit of the input do not matter.
    """
    span = knots[-1] - knots[0]
    points, weights = np.polynomial.legendre.leggauss(2)  # exact: a product of lines
    left, right = knots[:-1, None], knots[1:, None]
    x = (0.5 * (left + right) + 0.5 * (right - left) * points).ravel()
    w = (0.5 * (right - left) * weights).ravel()
    bend = BSpline(clamped(knots), np.eye(knots.size + 2), DEGREE).derivative(2)(x)
    return np.asarray(span**3 * (bend * w[:, None]).T @ bend)


def nearest(knots: np.ndarray, x: np.ndarray, functions: np.ndarray) -> np.ndarray:
    """Coefficients nearest to functions given at increasing places, (n,) or (n, functions)."""
    return np.asarray(make_lsq_spline(x, functions, clamped(knots), DEGREE).c)


class Blocks:
    """Weighted least squares by blocks of neighbouring samples, for cross-validation.

    Of a design (n, p), with target, weight and number of the block of each sample, each (n,).
    """

    def __init__(
        self, design: np.ndarray, target: np.ndarray, weight: np.ndarray, block: np.ndarray
    ) -> None:
        rows = [np.flatnonzero(block == k) for k in np.unique(block)]
        weighted = design * weight[:, None]
        # X'WX, X'Wy and y'Wy of each block.
        self._matrices = np.stack([weighted[r].T @ design[r] for r in rows])
        self._rights = np.stack([weighted[r].T @ target[r] for r in rows])
        self._squares = np.array([weight[r] @ target[r] ** 2 for r in rows])

    def solve(self, penalty: np.ndarray, keep: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Penalised coefficients, (p,), from all blocks or those of a mask."""
        matrix = self._matrices[keep].sum(axis=0) + penalty
        ridge = 1e-10 * np.trace(matrix) / max(len(matrix), 1) + 1e-300
        matrix = matrix + ridge * np.eye(len(matrix))
        return np.linalg.solve(matrix, self._rights[keep].sum(axis=0))

    def validated(self, penalty: np.ndarray) -> np.ndarray:
        """Squared errors of every block under a fit to the other four fifths, (blocks,)."""
        fold = np.arange(self._squares.size) % 5
        out = self._squares.copy()
        for k in range(5):
            own = fold == k
            x = self.solve(penalty, ~own)
            bent = np.einsum("i,bij,j->b", x, self._matrices[own], x)
            out[own] += bent - 2.0 * self._rights[own] @ x
        return np.maximum(out, 0.0)
