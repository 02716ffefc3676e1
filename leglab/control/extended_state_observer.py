"""Active disturbance rejection: a linear extended state observer and the law that uses it.

Gao 2003, "Scaling and bandwidth-parameterization based controller tuning", American Control
Conference: all poles of the observer at one bandwidth, all poles of the law at another. The
discrete observer is the current one of Miklosovic, Radke and Gao 2006, American Control Conference;
that it observes the tracking error follows Michalek 2016, American Control Conference, so that the
feed-forward of the reference can be whatever the machine's calibration gives.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


@dataclass(frozen=True, kw_only=True)
class DisturbanceGains:
    """Tuning of `DisturbanceRejection`, one value a joint.

    Attributes:
        control_bandwidth: omega_c, with which an error decays [rad/s], (joints,).
        observer_bandwidth: omega_o, of both poles of the observer [rad/s], (joints,).
        speed_per_command: b_0, speed that a command gives the calibrated joint [rad/s], (joints,).
    """

    control_bandwidth: np.ndarray
    observer_bandwidth: np.ndarray
    speed_per_command: np.ndarray


class LinearLaw(NamedTuple):
    """A law of one joint as x[k+1] = a x[k] + b e[k], u[k] = c x[k] + d e[k]."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: float


class DisturbanceRejection:
    """u = (omega_c e + f)/b_0, e and f estimated of e' = f - b_0 u, both of the joints alone.

    e is the tracking error and f [rad/s] everything that moves it besides the command: what leaks,
    what load takes, what a wrong calibration leaves. An observer has both poles at exp(-omega_o T).
    Errors come `latency` late: the observer knows which commands they contain, and moves the
    estimate on to the time of the command.

    Args:
        gains: Bandwidths.
        direction: Sign of the joint velocity that a positive command gives, (joints,).
        period: Control period T [s].
        latency: Age of an error when its command takes effect [s], at most a period.
    """

    def __init__(
        self, gains: DisturbanceGains, direction: np.ndarray, *, period: float, latency: float
    ) -> None:
        pole = np.exp(-gains.observer_bandwidth * period)
        self._error_gain, self._drift_gain = 1 - pole**2, (1 - pole) ** 2 / period
        self._bandwidth = gains.control_bandwidth
        self._rate = np.asarray(direction) * gains.speed_per_command
        self._period, self._latency = period, latency
        self.reset()

    def reset(self) -> None:
        """Starts without error, disturbance and past commands."""
        self._state = np.zeros((4, len(self._rate)))

    @property
    def disturbance(self) -> np.ndarray:
        """Estimate of f [rad/s], (joints,)."""
        return self._state[1]

    def __call__(self, error: np.ndarray) -> np.ndarray:
        """Commands, (joints,), for measured errors [rad], (joints,); NaN where none is measured."""
        self._state = self._next(self._state, error)
        return self._state[2]

    def sent(self, command: np.ndarray) -> None:
        """Takes the part of the commands (joints,) that was sent, where a limit has cut it."""
        self._state[2] = command

    def linear(self, joint: int) -> LinearLaw:
        """The law of one joint as a linear system of (e, f, last command, the one before)."""
        a, b = np.empty((4, 4)), np.empty(4)
        ones = np.ones_like(self._rate)
        for column in range(4):
            state = np.outer(np.eye(4)[column], ones)
            a[:, column] = self._next(state, 0 * ones)[:, joint]
        b[:] = self._next(np.zeros((4, len(ones))), ones)[:, joint]
        return LinearLaw(a, b, a[2], float(b[2]))

    def _next(self, state: np.ndarray, measured: np.ndarray) -> np.ndarray:
        """Estimates and commands one period on; linear in both arguments."""
        error, drift, last, before = state
        # From one measurement to the next, the command before the last still holds for `latency`.
        late = self._latency
        moved = self._rate * ((self._period - late) * last + late * before)
        predicted = error + self._period * drift - moved
        miss = measured - predicted
        if not math.isfinite(miss.dot(miss)):
            miss = np.where(np.isfinite(miss), miss, 0.0)
        error = predicted + self._error_gain * miss
        drift = drift + self._drift_gain * miss
        now = error + late * (drift - self._rate * last)
        command = (self._bandwidth * now + drift) / self._rate
        return np.stack([error, drift, command, last])
