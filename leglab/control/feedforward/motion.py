"""Smoothed derivatives of measured positions, and time shifts of the reference."""

import math

import numpy as np
from numpy.typing import ArrayLike

from leglab.control import ReferencePoint


def smoothing_kernel(window: int, timestep: float) -> np.ndarray:
    """Computes weights for the value and three derivatives in the middle of a window of samples.

    The coefficients of a least-squares polynomial, of order 4, are linear in the samples (Savitzky
    and Golay 1964, Anal. Chem. 36(8), 1627).

    Args:
        window: Number of samples, odd, more than 4.
        timestep: Time between samples [s].

    Returns:
        Rows whose products with the samples, oldest first, are x, x', x'' and x''', (4, window).
    """
    half = window // 2
    offsets = np.arange(-half, half + 1) / half
    powers = np.linalg.pinv(np.vander(offsets, 5, increasing=True))
    unit = half * timestep
    return np.stack([math.factorial(d) * powers[d] / unit**d for d in range(4)])


class SmoothingWindow:
    """Recent samples of several signals, and their smoothed values in the window's middle.

    Args:
        signals: Number of signals.
        window: Number of samples, odd.
        timestep: Time between samples [s].
        derivatives: Number of derivatives of every signal, at most 3.
    """

    def __init__(self, signals: int, window: int, timestep: float, *, derivatives: int = 3) -> None:
        self._window = window
        self._kernel = smoothing_kernel(window, timestep)[: derivatives + 1]
        # Every sample is written twice, `window` rows apart, so the last samples are one slice.
        self._rows = np.zeros((2 * window, signals))
        self.clear()

    def clear(self) -> None:
        """Forgets all samples."""
        self._next = self._filled = 0

    @property
    def full(self) -> bool:
        """True once there are samples for a whole window."""
        return self._filled >= self._window

    def push(self, *parts: ArrayLike) -> None:
        """Adds one sample of all signals; `parts` are arrays to be joined, (signals,) in all."""
        row = self._rows[self._next]
        np.concatenate(parts, out=row)
        self._rows[self._next + self._window] = row
        self._next = (self._next + 1) % self._window
        self._filled += 1

    @property
    def samples(self) -> np.ndarray:
        """The samples, oldest first, (window, signals)."""
        return self._rows[self._next : self._next + self._window]

    def middle(self) -> np.ndarray:
        """Computes values and derivatives in the window's middle, (1 + derivatives, signals)."""
        return np.dot(self._kernel, self.samples)


class ReferenceMotion:
    """Reference shifted in time by Taylor series, ahead by a lead and back by the sensors' delays.

    Args:
        joints: Number of joints.
        timestep: Time between calls of `take` [s]; the jerk is the difference quotient over it.
        lead: Time ahead of the present for which the motion is computed [s].
        position_delay: Age of a position measured now [s].
        velocity_delay: Age of a velocity estimated now [s].
    """

    def __init__(
        self,
        joints: int,
        timestep: float,
        *,
        lead: float,
        position_delay: float,
        velocity_delay: float,
    ) -> None:
        self._rate = 1.0 / timestep
        self._derivatives = np.zeros((4, joints))
        seen_position, seen_velocity = _taylor(-position_delay)[0], _taylor(-velocity_delay)[1]
        self._taylor = np.vstack([_taylor(lead), seen_position, seen_velocity])
        self._started = False

    def clear(self) -> None:
        """Forgets the last acceleration."""
        self._started = False

    def take(self, reference: ReferencePoint) -> tuple[np.ndarray, ReferencePoint]:
        """Shifts the reference of this period.

        Returns:
            Motion `lead` ahead, (4, joints), and the reference at the time of the sensor readings.
        """
        now = self._derivatives
        if not self._started:
            now[2], self._started = reference.acceleration, True
        now[3] = self._rate * (reference.acceleration - now[2])
        now[0], now[1], now[2] = reference
        out = np.dot(self._taylor, now)
        return out[:4], ReferencePoint(out[4], out[5], reference.acceleration)


def _taylor(by: float) -> np.ndarray:
    """Returns the matrix (4, 4) that shifts position and three derivatives by a time [s]."""
    rows = np.eye(4)
    for row in range(4):
        for column in range(row, 4):
            rows[row, column] = by ** (column - row) / math.factorial(column - row)
    return rows
