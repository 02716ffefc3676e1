"""Active disturbance rejection: a linear extended state observer and the law that uses it.

As in Gao 2003, "Scaling and bandwidth-parameterization based controller tuning", American Control
Conference, all poles of the observer have one bandwidth, all poles of the law another. The
discrete observer is the "current" observer of Miklosovic, Radke and Gao 2006, American Control
Conference. It observes the tracking error, as in Michalek 2016, American Control Conference, so
that any feed-forward of the reference can be added, for example by a calibrated valve map.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


@dataclass(frozen=True, kw_only=True)
class DisturbanceGains:
    """Tuning of `DisturbanceRejection`, one value per joint."""

    control_bandwidth: np.ndarray  #: omega_c, rate at which an error decays [rad/s], (joints,)
    observer_bandwidth: np.ndarray  #: omega_o, of all poles of the observer [rad/s], (joints,)
    #: b_0, gain of the calibrated joint, (joints,): speed per command [rad/s] for order 1,
    #: acceleration per command [rad/s^2] for order 2.
    plant_gain: np.ndarray
    #: Number of integrations from command to position, (joints,): 1 for a valve, which sets a flow,
    #: 2 for a native actuator, which sets a force.
    order: np.ndarray


class LinearLaw(NamedTuple):
    """Control law of one joint: x[k+1] = a x[k] + b e[k], u[k] = c x[k] + d e[k]."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: float


class DisturbanceRejection:
    """u = (omega_c e + f)/b_0, with e and f estimated from e' = f - b_0 u, joint by joint.

    With order 2, u = (omega_c^2 e + 2 omega_c e' + f)/b_0 and e'' = f - b_0 u. e is the tracking
    error; the disturbance f [rad/s or rad/s^2] is everything but the command that changes e:
    leakage, load, calibration errors. The observer has all poles at exp(-omega_o T). An error is
    measured `latency` before its command takes effect. Until then earlier commands act, with which
    the observer predicts the estimate to the time when the new command takes effect.

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
        # Changes of the error between two measurements per unit of the disturbance, of the last
        # command, and of the command before it, which acts for `latency` after a measurement.
        held, late = period - latency, latency
        self._drift_moves = np.where(second, 0.5 * period**2, period)
        self._last_moves = np.where(second, 0.5 * held**2, held)
        self._before_moves = np.where(second, late * (period - 0.5 * late), late)
        self._late_moves = np.where(second, 0.5 * late**2, late)
        self.reset()

    def reset(self) -> None:
        """Sets error, disturbance and past commands to zero."""
        self._state = np.zeros((5, len(self._rate)))

    @property
    def disturbance(self) -> np.ndarray:
        """Estimate of f [rad/s with order 1, rad/s^2 with order 2], (joints,)."""
        return self._state[2]

    def __call__(self, error: np.ndarray) -> np.ndarray:
        """Computes commands, (joints,), from measured errors [rad], (joints,), NaN if missing."""
        self._state = self._next(self._state, error)
        return self._state[3]

    def sent(self, command: np.ndarray) -> None:
        """Records the part of the sent, clipped commands that is due to this law, (joints,)."""
        self._state[3] = command

    def linear(self, joint: int) -> LinearLaw:
        """Returns the law of a joint as a linear system.

        States: e, e' (zero with order 1), f, the last command, the command before the last.
        """
        unit, ones = np.eye(len(self._state)), np.ones_like(self._rate)
        columns = [self._next(np.outer(state, ones), 0 * ones)[:, joint] for state in unit]
        a = np.stack(columns, axis=1)
        b = self._next(np.zeros_like(self._state), ones)[:, joint]
        return LinearLaw(a, b, a[3], float(b[3]))

    def _next(self, state: np.ndarray, measured: np.ndarray) -> np.ndarray:
        """Computes estimates and commands of the next period, which are linear in the arguments."""
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
