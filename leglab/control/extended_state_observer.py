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
    """Tuning of `DisturbanceRejection`, one value a joint."""

    control_bandwidth: np.ndarray  #: omega_c, with which an error decays [rad/s], (joints,)
    observer_bandwidth: np.ndarray  #: omega_o, of all poles of the observer [rad/s], (joints,)
    #: b_0, what a command gives the calibrated joint, (joints,): speed [rad/s] where the order is
    #: 1, acceleration [rad/s^2] where it is 2.
    plant_gain: np.ndarray
    #: How often a joint integrates its command, (joints,): 1 behind a valve, which gives a flow, 2
    #: behind a native actuator, which gives a force.
    order: np.ndarray


class LinearLaw(NamedTuple):
    """A law of one joint as x[k+1] = a x[k] + b e[k], u[k] = c x[k] + d e[k]."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: float


class DisturbanceRejection:
    """u = (omega_c e + f)/b_0, e and f estimated of e' = f - b_0 u, both of the joints alone.

    Of second order u = (omega_c^2 e + 2 omega_c e' + f)/b_0 and e'' = f - b_0 u. e is the tracking
    error and f [rad/s or rad/s^2] everything that moves it besides the command: what leaks, what
    load takes, what a wrong calibration leaves. An observer has all poles at exp(-omega_o T).
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
        pole, second = np.exp(-gains.observer_bandwidth * period), np.asarray(gains.order) == 2
        self._second = second.astype(float)
        self._error_gain = np.where(second, 1 - pole**3, 1 - pole**2)
        self._speed_gain = self._second * 1.5 * (1 - pole) ** 2 * (1 + pole) / period
        self._drift_gain = np.where(second, (1 - pole) ** 3 / period**2, (1 - pole) ** 2 / period)
        bandwidth = gains.control_bandwidth
        self._stiffness = np.where(second, bandwidth**2, bandwidth)
        self._damping = self._second * 2.0 * bandwidth
        self._rate = np.asarray(direction) * gains.plant_gain
        self._period, self._latency = period, latency
        # What a disturbance, the last command and the one before move from one measurement to the
        # next: the command before the last still holds for `latency`.
        held, late = period - latency, latency
        self._drift_moves = np.where(second, 0.5 * period**2, period)
        self._last_moves = np.where(second, 0.5 * held**2, held)
        self._before_moves = np.where(second, late * (period - 0.5 * late), late)
        self._late_moves = np.where(second, 0.5 * late**2, late)
        self.reset()

    def reset(self) -> None:
        """Starts without error, disturbance and past commands."""
        self._state = np.zeros((5, len(self._rate)))

    @property
    def disturbance(self) -> np.ndarray:
        """Estimate of f [rad/s, or rad/s^2 of second order], (joints,)."""
        return self._state[2]

    def __call__(self, error: np.ndarray) -> np.ndarray:
        """Commands, (joints,), for measured errors [rad], (joints,); NaN where none is measured."""
        self._state = self._next(self._state, error)
        return self._state[3]

    def sent(self, command: np.ndarray) -> None:
        """Takes the part of the commands (joints,) that was sent, where a limit has cut it."""
        self._state[3] = command

    def linear(self, joint: int) -> LinearLaw:
        """The law of one joint as a linear system of (e, e', f, last command, the one before).

        e' does not move where the order is 1.
        """
        unit, ones = np.eye(len(self._state)), np.ones_like(self._rate)
        columns = [self._next(np.outer(state, ones), 0 * ones)[:, joint] for state in unit]
        a = np.stack(columns, axis=1)
        b = self._next(np.zeros_like(self._state), ones)[:, joint]
        return LinearLaw(a, b, a[3], float(b[3]))

    def _next(self, state: np.ndarray, measured: np.ndarray) -> np.ndarray:
        """Estimates and commands one period on; linear in both arguments."""
        error, speed, drift, last, before = state
        period, late, second = self._period, self._latency, self._second
        moved = self._rate * (self._last_moves * last + self._before_moves * before)
        predicted = error + second * period * speed + self._drift_moves * drift - moved
        pushed = self._rate * ((period - late) * last + late * before)
        speed = second * (speed + period * drift - pushed)
        miss = measured - predicted
        if not math.isfinite(miss.dot(miss)):
            miss = np.where(np.isfinite(miss), miss, 0.0)
        error = predicted + self._error_gain * miss
        speed = speed + self._speed_gain * miss
        drift = drift + self._drift_gain * miss
        driven = drift - self._rate * last
        now = error + second * late * speed + self._late_moves * driven
        then = second * (speed + late * driven)
        command = (self._stiffness * now + self._damping * then + drift) / self._rate
        return np.stack([error, speed, drift, command, last])
