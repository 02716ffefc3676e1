"""Learns the inverse map while the machine moves, and gives the feed-forward from it, safely."""

from dataclasses import dataclass

import numpy as np

from leglab.control import ReferencePoint
from leglab.feedforward.inverse_map import InverseMap, StaticMap
from leglab.feedforward.motion import ReferenceMotion, SmoothingWindow
from leglab.identification import SplineNarx

# Errors of the model below this [valve command] are noise: no reason to distrust it.
_NOISE = 2e-3


@dataclass(frozen=True, kw_only=True)
class AdaptationSettings:
    """How the map is learned and its use kept safe.

    Attributes:
        control_period: [s].
        latency: Age of a measurement when its command takes effect [s].
        velocity_delay: Age of a velocity estimate then [s].
        window: Samples over which measured motion is smoothed, odd.
        interval: Control periods from one learned sample to the next.
        stop_time: Adaptation stops then [s].
        limit: Largest feed-forward [valve command].
        rate_limit: Fastest change of the feed-forward [1/s].
        least_speed: Nothing is learned while all joints are slower, as a share of their full speed.
        supervised: Whether the calibrated map takes over where it predicts better.
        trust_time: Time constant of the errors by which both maps are judged [s].
        margin: The calibrated map takes over where the learned one's RMS error is so many times
            its own.
    """

    control_period: float
    latency: float
    velocity_delay: float
    window: int
    interval: int
    stop_time: float
    limit: float
    rate_limit: float
    least_speed: float
    supervised: bool
    trust_time: float = 0.5
    margin: float = 1.1


class AdaptiveFeedforward:
    """Feed-forward of all joints from a learned map, with the calibrated map to fall back on.

    A sample is the motion in the middle of the smoothing window and the command sent one period
    before its measurement was taken. The reference drives the learned map with the same shift in
    time, so whatever delay valve and oil have beyond it is learned as a dependence on the
    derivatives.

    Args:
        inverse_map: Structure of the map.
        static_map: Calibrated commands from positions and velocities: where learning starts.
        settings: See `AdaptationSettings`.
    """

    def __init__(
        self, inverse_map: InverseMap, static_map: StaticMap, settings: AdaptationSettings
    ) -> None:
        self._map, self._static_map, self._settings = inverse_map, static_map, settings
        joints, period = inverse_map.joints, settings.control_period
        self._window = SmoothingWindow(joints, settings.window, period)
        self._reference = ReferenceMotion(
            joints,
            period,
            lead=period - settings.latency,
            position_delay=settings.latency,
            velocity_delay=settings.velocity_delay,
        )
        # As arrays: NumPy takes longer for a number than for an array of six.
        self._step = np.full(joints, settings.rate_limit * period)
        self._limit, self._ones = np.full(joints, settings.limit), np.ones(joints)
        self._forget = min(1.0, settings.interval * period / settings.trust_time)
        self._learner = self._calibrated = inverse_map.learner()
        self._zeros = np.zeros(joints)

    def reset(self, position: np.ndarray) -> None:
        """Forgets everything learned.

        Args:
            position: Where the joints are [rad], (joints,).
        """
        self._learner = self._map.learner()
        self._learner.parameters = self._map.fitted_to(self._static_map, position)
        self._calibrated = self._learner.copy()
        self._calibrated.freeze()
        self._window.clear()
        self._reference.clear()
        self._count = 0
        self._sent = self._feedforward = self.error = self._zeros
        self._squares = np.zeros((2, self._map.joints))  # of learned and calibrated map
        self._now = np.zeros_like(self._squares)
        self.fallback = np.zeros(self._map.joints, dtype=bool)
        self._falls_back = False

    @property
    def learner(self) -> SplineNarx:
        """The learned map."""
        return self._learner

    def learn(self, time: float, position: np.ndarray) -> None:
        """Takes the positions measured now [rad] and learns; call it once a period.

        Args:
            time: Of the measurement [s].
            position: (joints,); NaN where there is none.
        """
        settings, window = self._settings, self._window
        window.push(position, self._sent)
        self._count += 1
        if self._count % settings.interval or time >= settings.stop_time or not window.full:
            return
        motion, command = window.middle()
        inputs = self._map.inputs(motion)
        speed = np.abs(inputs[..., 0]).max()
        if not speed >= settings.least_speed:  # false for NaN
            return
        usable = window.largest_command() < settings.limit
        all_usable = bool(usable.all())
        if not all_usable:
            command = np.where(usable, command, np.nan)  # refused by the learner, and counted
        if self._map.joints == 1:
            sample = float(command[0])
            error = np.array([sample - self._learner.update(inputs, sample)])
        else:
            error = command - self._learner.update(inputs, command)
        if not all_usable:
            error = np.where(usable, error, 0.0)
        self.error = error
        if settings.supervised:
            self._supervise(command - self._calibrated.predict(inputs), all_usable)

    def _supervise(self, calibrated: np.ndarray, usable: bool) -> None:
        squares, now = self._squares, self._now
        now[0], now[1] = self.error, calibrated
        if not usable:
            np.nan_to_num(now, copy=False)
        now *= now
        now -= squares
        now *= self._forget
        squares += now
        learned, margin = squares[0], self._settings.margin
        self.fallback = learned > margin * margin * squares[1] + _NOISE * _NOISE
        self._falls_back = bool(self.fallback.any())

    def feedforward(self, reference: ReferencePoint) -> tuple[np.ndarray, ReferencePoint]:
        """Valve commands (joints,) for a reference, and the reference as the sensors show it."""
        motion, seen = self._reference.take(reference)
        inputs = self._map.inputs(motion)
        wish = self._learner.predict(inputs)
        if self._falls_back:
            wish = np.where(self.fallback, self._calibrated.predict(inputs), wish)
        wish = np.minimum(np.maximum(wish, -self._limit), self._limit)
        if self._count > 1:
            last = self._feedforward
            wish = np.minimum(np.maximum(wish, last - self._step), last + self._step)
        self._feedforward = wish
        return wish, seen

    def sent(self, command: np.ndarray) -> None:
        """Takes the command that is sent now, (joints,); values beyond [-1, 1] are clipped."""
        self._sent = np.minimum(np.maximum(command, -self._ones), self._ones)
