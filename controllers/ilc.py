"""Iterative learning control: calibrated valve map, PD, and a correction learned by repetition."""

import math

import numpy as np
from pydantic import Field

from leglab.base.settings import Configuration
from leglab.control import ControllerSetup, Measurement, ReferencePoint, register_controller
from leglab.control.feedforward.motion import ReferenceMotion
from leglab.control.iterative_learning import IterativeLearning
from leglab.controllers.pd import Pd, PdConfiguration
from leglab.controllers.static_feedforward import ValveMapTable

# Minimum duration of a stride for learning, in control periods.
_LEAST_PERIODS = 20


class IlcConfiguration(Configuration):
    """Settings of `ilc`; its feedback has the tuned gains of `pd`, for which it converges.

    Attributes:
        stride: Time after which the reference repeats [s]; None for the reference's own.
        tolerance: Reference positions that differ by less are the same [rad].
    """

    stride: float | None = Field(default=None, gt=0)
    tolerance: float = Field(default=1e-3, gt=0)


@register_controller(
    "ilc",
    summary="adds to static_feedforward what it has learned of the last strides, where the "
    "reference repeats itself",
    configuration=IlcConfiguration,
)
class Ilc:
    """u = map(r, r') + PD + c, with a correction c learned from stride to stride.

    While the reference does not repeat itself, c and the diagnostic `repeats` are zero. The map is
    evaluated at the reference in the middle of the period in which the command acts. The error is
    the reference at the time of the measurement minus the measurement.
    """

    def __init__(self, setup: ControllerSetup, config: IlcConfiguration) -> None:
        machine, period = setup.machine, setup.control_period
        joints = len(setup.joints)
        self._pd = Pd(setup, PdConfiguration())
        self._map = ValveMapTable(machine.valve_maps)
        self._motion = ReferenceMotion(
            joints,
            period,
            lead=period / 2,
            position_delay=machine.latency,
            velocity_delay=machine.latency + machine.velocity_delay,
        )
        stride = setup.reference_period if config.stride is None else config.stride
        self._learning: IterativeLearning | None = None
        if stride is not None and math.isfinite(stride) and stride >= _LEAST_PERIODS * period:
            filters = machine.tuned["ilc"]
            self._learning = IterativeLearning(
                filters,
                np.abs(self._pd.position_gain) * filters.speed_per_command,
                np.asarray(machine.direction, dtype=float),
                stride=stride,
                period=period,
                tolerance=config.tolerance,
            )
        self._nothing = np.zeros(joints)
        self._feedforward = self._correction = self._repeats = self._nothing

    def reset(self, measurement: Measurement) -> None:
        """Starts a run; nothing is learned yet."""
        self._pd.reset(measurement)
        self._motion.clear()
        if self._learning is not None:
            self._learning.reset()

    def freeze(self) -> None:
        """Stops learning until the next `reset`; the correction of the last stride is repeated."""
        if self._learning is not None:
            self._learning.freeze()

    def command(self, measurement: Measurement, reference: ReferencePoint) -> np.ndarray:
        """Computes the valve commands, (joints,)."""
        motion, seen = self._motion.take(reference)
        nominal = self._map(motion[0], motion[1])
        feedback = self._pd.correct(measurement, seen)
        learning, correction = self._learning, self._nothing
        if learning is not None:
            wish = nominal + learning.correction(reference.position)
            # Anti-windup: the part of the command beyond the valve's range is not learned.
            correction = np.minimum(np.maximum(wish, -1.0), 1.0) - nominal
            learning.take(seen.position - measurement.position, correction)
            self._repeats = np.full_like(nominal, learning.repeats)
        self._correction, self._feedforward = correction, nominal + correction
        return self._feedforward + feedback

    def diagnostics(self) -> dict[str, np.ndarray]:
        """Returns feed-forward, its learned part, feedback, and 1 while the reference repeats."""
        return {
            "feedforward": self._feedforward,
            "correction": self._correction,
            "repeats": self._repeats,
            **self._pd.diagnostics(),
        }
