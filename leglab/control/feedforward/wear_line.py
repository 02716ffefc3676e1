"""Straight line through a fault's sizes (magnitudes) over time, and when it reaches a size.

The interval of that time is by Fieller 1954, Journal of the Royal Statistical Society B 16, 175.
"""

from dataclasses import dataclass

import numpy as np

from leglab.control.feedforward.thresholds import FEWEST, MANY, NINETY, OUTSIDE


@dataclass(frozen=True, kw_only=True)
class Line:
    """Straight line through the sizes of a fault over time, from the onset of wear on."""

    onset: float  #: Time at which the size begins to depart from the healthy size [s]
    end: float  #: Time of the last size [s]
    value: float  #: Value of the line at the end
    rate: float  #: Slope [1/s]
    covariance: np.ndarray  #: Covariance of value and rate, (2, 2)
    freedom: int  #: Degrees of freedom of the residuals

    @property
    def quantile(self) -> float:
        """Quantile of Student's t distribution for the ends of a 90 % interval."""
        from scipy.special import stdtrit

        return float(stdtrit(self.freedom, 1 - OUTSIDE / 2))

    def reaches(self, level: float, scale: float) -> tuple[float | None, float, float | None]:
        """Computes when the line reaches a level: best estimate and ends of its 90 % interval.

        The ends are the times at which the level lies on the confidence bounds of the line with
        value v and rate r (Fieller): roots of (v + r t - level)^2 = q^2 var(v + r t) + var(level).

        Args:
            level: Size of the fault to be reached.
            scale: Standard deviation of `level`, for an unknown factor common to all sizes.

        Returns:
            Times after the line's `end` [s]: estimate, None if the line moves away from the level;
            earliest time; latest time, None if the interval of the slope contains zero.
        """
        gap, q2 = level - self.value, self.quantile**2
        best = gap / self.rate if gap * self.rate > 0 else (0.0 if gap == 0 else None)
        (vv, vr), (_, rr) = self.covariance.tolist()
        spread = q2 * vv + (NINETY * scale) ** 2
        a, b, c = self.rate**2 - q2 * rr, -(gap * self.rate + q2 * vr), gap**2 - spread
        ends = sorted(root.real for root in np.roots([a, 2 * b, c]) if root.imag == 0.0)
        if a <= 0 or not ends:  # the slope may be zero
            return best, 0.0 if c <= 0 else min((e for e in ends if e > 0), default=0.0), None
        return best, max(ends[0], 0.0), max(ends[1], 0.0)


def line_of(time: np.ndarray, size: np.ndarray, healthy: float) -> Line | None:
    """Fits a line to the sizes of a fault since the onset of its wear.

    The onset is the corner of the best-fitting broken line: constant at `healthy`, then sloped. A
    new line is fitted to the sizes after the onset; its covariance allows for AR(1) residuals.

    Args:
        time: Time of each size, increasing [s], (n,).
        size: Sizes, (n,).
        healthy: Size of the healthy machine.

    Returns:
        The line; None for fewer than four sizes.
    """
    count = len(time)
    if count < FEWEST:
        return None
    rise = size - healthy
    behind = np.maximum(time[None, :] - time[: count - FEWEST + 1, None], 0.0)
    square = np.einsum("ij,ij->i", behind, behind)
    slope = behind @ rise / square
    cost = np.sum((rise - slope[:, None] * behind) ** 2, axis=1)
    first = int(np.argmin(cost))
    onset, number = float(time[first]), count - first
    if number >= MANY:
        first += number // 2
        number = count - first
    t, y = time[first:] - time[-1], size[first:]
    design = np.column_stack([np.ones(number), t])
    inverse = np.linalg.inv(design.T @ design)
    value, rate = inverse @ (design.T @ y)
    left = y - value - rate * t
    freedom = number - 2
    power = float(left @ left)
    alike = float(np.clip(left[1:] @ left[:-1] / max(power, 1e-300), 0.0, 0.9))
    variance = power / freedom * (1 + alike) / (1 - alike)
    return Line(
        onset=onset,
        end=float(time[-1]),
        value=float(value),
        rate=float(rate),
        covariance=variance * inverse,
        freedom=freedom,
    )
