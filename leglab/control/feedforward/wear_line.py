"""The straight line of a size that wears, and when it reaches a level.

The interval of that time is Fieller's (1954, Journal of the Royal Statistical Society B 16, 175).
"""

from dataclasses import dataclass

import numpy as np

from leglab.control.feedforward.thresholds import FEWEST, MANY, NINETY, OUTSIDE


@dataclass(frozen=True, kw_only=True)
class Line:
    """A straight line through sizes over time, from its onset on."""

    onset: float  #: When the sizes leave the healthy one [s]
    end: float  #: Time of the last size [s]
    value: float  #: On the line at the end
    rate: float  #: Slope [1/s]
    covariance: np.ndarray  #: Of value and rate, (2, 2)
    freedom: int  #: Degrees of freedom of the residuals that it is from

    @property
    def quantile(self) -> float:
        """Of Student's distribution, for the ends of an interval."""
        from scipy.special import stdtrit

        return float(stdtrit(self.freedom, 1 - OUTSIDE / 2))

    def reaches(self, level: float, scale: float) -> tuple[float | None, float, float | None]:
        """When the line is at a level: best estimate and both ends of its 90 % interval.

        The ends are the times at which the level is at the edge of what the line may be there
        (Fieller 1954): the roots of (v + r t - level)^2 = q^2 var(v + r t) + var(level).

        Args:
            level: Size.
            scale: Standard deviation of the level, in which the unknown scale of all sizes is put.

        Returns:
            Times after the end [s], the first None where it goes elsewhere, the last None where
            no slope is as likely.
        """
        gap, q2 = level - self.value, self.quantile**2
        best = gap / self.rate if gap * self.rate > 0 else (0.0 if gap == 0 else None)
        (vv, vr), (_, rr) = self.covariance.tolist()
        spread = q2 * vv + (NINETY * scale) ** 2
        a, b, c = self.rate**2 - q2 * rr, -(gap * self.rate + q2 * vr), gap**2 - spread
        ends = sorted(root.real for root in np.roots([a, 2 * b, c]) if root.imag == 0.0)
        if a <= 0 or not ends:  # the slope may be nil
            return best, 0.0 if c <= 0 else min((e for e in ends if e > 0), default=0.0), None
        return best, max(ends[0], 0.0), max(ends[1], 0.0)


def line_of(time: np.ndarray, size: np.ndarray, healthy: float) -> Line | None:
    """Fits the line of sizes that leave the healthy one at an onset.

    The onset is that of the broken line with the least squares. From it on the line is fitted
    anew; neighbouring residuals that are alike count less (AR(1), by their own correlation).

    Args:
        time: Of each size, increasing [s], (n,).
        size: (n,).
        healthy: Size of the healthy machine.

    Returns:
        None where fewer than four sizes lie behind the onset.
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
