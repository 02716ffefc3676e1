"""Learns the inverse map while the machine moves, and gives the feed-forward from it, safely."""

from dataclasses import dataclass

import numpy as np

from leglab._native.identification import Feedforward
from leglab.control import Measurement, ReferencePoint
from leglab.control.feedforward.inverse_map import ACCELERATION, JERK, InverseMap
from leglab.control.feedforward.motion import smoothing_kernel
from leglab.control.feedforward.valve_table import ValveTable
from leglab.identification import SplineNarx

# What a period reports, in the order of the core's rows behind the command.
_REPORTED = ("feedforward", "feedback", "model_error", "fallback")

# Tracking errors below this [rad] are no reason to distrust the model.
_NOISE = 0.2e-3

# Readings that bend more [rad/s^2] are no motion: some fifteen times the walking stride's knee.
_GREATEST_ACCELERATION = 1000.0


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
        forward: Whether the learner says what speed a flow gives, which is then solved for the
            flow, instead of what flow a speed takes.
        supervised: Whether the calibrated map takes over where it would track better.
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
    forward: bool
    supervised: bool
    trust_time: float = 0.5
    margin: float = 1.05


class AdaptiveFeedforward:
    """Feed-forward of all joints beside PD: the calibrated valve map at the flow that is learned.

    A sample is the motion in the middle of the smoothing window and the flow there: the speed that
    the calibrated valve map gives for the command sent, smoothed alike. What the learner takes for
    its output is the difference of that flow and the motion's own speed: what leaks, what is
    compressed, what load and oil take away. The reference drives the learner with the same shift in
    time, so whatever delay valve and oil have beyond it is learned as a dependence on the
    derivatives. The core is C++ (`csrc/feedforward`); the tests say the same in NumPy.

    Args:
        inverse_map: Structure of the learner.
        table: Calibrated valve maps: where learning starts.
        position_gain: Of the feedback [1/rad], (joints,); how fast it forgets an error.
        velocity_gain: Of the feedback [s/rad], (joints,).
        settings: See `AdaptationSettings`.

    Attributes:
        report: What the last period gave, by name, each (joints,): `feedforward` and `feedback`
            [valve command], `model_error` of the last sample [share of full speed], and `fallback`,
            1 where the calibrated map stands in. The arrays change with the next period.
    """

    def __init__(
        self,
        inverse_map: InverseMap,
        table: ValveTable,
        position_gain: np.ndarray,
        velocity_gain: np.ndarray,
        settings: AdaptationSettings,
    ) -> None:
        self._map = inverse_map
        ranges, period = inverse_map.ranges, settings.control_period
        width = ranges.upper - ranges.lower
        # Speed per command of the calibrated valve at half of its range.
        low, high = np.searchsorted(table.share, [-0.5, 0.5])
        middle = table.command[:, table.command.shape[1] // 2]
        rise = np.abs(middle[:, high] - middle[:, low]) / (table.share[high] - table.share[low])
        self._core = Feedforward(
            {
                "control_period": period,
                "interval": settings.interval,
                "stop_time": settings.stop_time,
                "limit": settings.limit,
                "rate_limit": settings.rate_limit,
                "least_speed": settings.least_speed,
                "saturation": settings.limit,
                "greatest_acceleration": _GREATEST_ACCELERATION,
                "forward": settings.forward,
                "supervised": settings.supervised,
                "trust_time": settings.trust_time,
                "margin": settings.margin,
                "noise": _NOISE,
                "centre": (ranges.lower + ranges.upper) / 2,
                "half_range": width / 2,
                "full_speed": ranges.speed,
                "acceleration": ACCELERATION,
                "jerk": JERK,
                "products": inverse_map.products,
                "kernel": smoothing_kernel(settings.window, 4, period),
                "lead": period - settings.latency,
                "position_delay": settings.latency,
                "velocity_delay": settings.velocity_delay,
                "start": table.start,
                "spacing": table.spacing,
                "shares": table.share,
                "commands": np.ascontiguousarray(table.command),
                # Calibrated positions end a little before the stops.
                "learn_lower": ranges.lower - 0.02 * width,
                "learn_upper": ranges.upper + 0.02 * width,
                "bandwidth": np.abs(position_gain) * table.full_speed / rise,
                "position_gain": position_gain,
                "velocity_gain": velocity_gain,
            }
        )
        self._out = np.zeros((1 + len(_REPORTED), inverse_map.joints))
        self._command = self._out[0]
        self.report = dict(zip(_REPORTED, self._out[1:], strict=True))
        self.reset()

    def reset(self) -> None:
        """Forgets everything learned: the feed-forward is the calibration's."""
        self._learner = self._map.learner()
        self._core.reset(self._learner.bank)
        self._out[:] = 0.0

    @property
    def learner(self) -> SplineNarx:
        """What has been learned."""
        return self._learner

    def step(self, measurement: Measurement, reference: ReferencePoint) -> np.ndarray:
        """Learns from a measurement and gives the valve commands; call it once a period.

        Feedback holds the reference against the measurement at the time it was taken. Where a
        measurement is NaN the command is the feed-forward alone. What is sent counts as clipped to
        [-1, 1].

        Args:
            measurement: Of now.
            reference: Of now.

        Returns:
            Shape (joints,); the array changes with the next period.
        """
        time, position, velocity, *_ = measurement
        self._core.step(time, position, velocity, *reference, self._out)
        return self._command

    def sent(self, command: np.ndarray) -> None:
        """Takes the commands (joints,) that were sent, where they are not what `step` gave."""
        self._core.sent(command)
