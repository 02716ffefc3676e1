"""Additive cubic B-splines with a smoothness penalty."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_lsq_spline

DEGREE = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class CubicSpline:
    """A cubic B-spline of one variable, constant beyond its knots."""

    knots: np.ndarray  #: Increasing over the range of the data, (knots,)
    coefficients: np.ndarray  #: Shape (knots + 2,)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Computes values at inputs of any shape."""
        inside = np.clip(x, self.knots[0], self.knots[-1])
        return BSpline(clamped(self.knots), self.coefficients, DEGREE)(inside)


def clamped(knots: np.ndarray) -> np.ndarray:
    """Returns the knots with the first and the last repeated, so that each occurs four times."""
    return np.pad(knots, DEGREE, mode="edge")


def basis(knots: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Computes all B-splines at inputs clipped to the knots, (..., knots + 2); their sum is 1."""
    inside = np.clip(x.ravel(), knots[0], knots[-1])
    return BSpline.design_matrix(inside, clamped(knots), DEGREE).toarray().reshape(*x.shape, -1)


def roughness(knots: np.ndarray) -> np.ndarray:
    """Computes the matrix of a spline's penalty, the integrated squared second derivative.

    The factor range^3 makes it independent of the input's unit. Straight lines have no penalty.
    """
    span = knots[-1] - knots[0]
    points, weights = np.polynomial.legendre.leggauss(2)  # exact for products of two lines
    left, right = knots[:-1, None], knots[1:, None]
    x = (0.5 * (left + right) + 0.5 * (right - left) * points).ravel()
    w = (0.5 * (right - left) * weights).ravel()
    bend = BSpline(clamped(knots), np.eye(knots.size + 2), DEGREE).derivative(2)(x)
    return np.asarray(span**3 * (bend * w[:, None]).T @ bend)


def nearest(knots: np.ndarray, x: np.ndarray, functions: np.ndarray) -> np.ndarray:
    """Fits spline coefficients to functions, (n,) or (n, functions), sampled at increasing x."""
    return np.asarray(make_lsq_spline(x, functions, clamped(knots), DEGREE).c)
