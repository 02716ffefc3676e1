"""Proportional-derivative control, joint by joint: the feedback of most other controllers."""

import numpy as np
from pydantic import Field

from leglab.base.settings import Configuration
from leglab.control import ControllerSetup, Measurement, ReferencePoint, register_controller


class PdConfiguration(Configuration):
    """Settings of `pd`.

    Attributes:
        position_gain: Valve command per position error [1/rad], one a joint; None for the tuned
            gains of the model (`leglab tune`).
        velocity_gain: Valve command per velocity error [s/rad], one a joint; None as above.
    """

    position_gain: tuple[float, ...] | None = Field(default=None)
    velocity_gain: tuple[float, ...] | None = Field(default=None)


@register_controller(
    "pd",
    summary="acts on position and velocity error alone, with gains tuned on the linearised machine",
    configuration=PdConfiguration,
)
class Pd:
    """u = s (K_p (r - q) + K_v (r' - q')); s: sign of the velocity that a positive command gives.

    For drives with an internal position or velocity loop, `command` adds the setpoint by which the
    loop follows the reference; `correct` does not.

    Attributes:
        position_gain: s K_p [1/rad], (joints,).
        velocity_gain: s K_v [s/rad], (joints,).
        feedback: The last commands, (joints,).
    """

    joint_wise = True

    def __init__(self, setup: ControllerSetup, config: PdConfiguration) -> None:
        direction = np.asarray(setup.machine.direction, dtype=float)
        gains = []
        for name in ("position_gain", "velocity_gain"):
            values = getattr(config, name)
            if values is None:
                values = getattr(setup.machine, name)
            if len(values) != len(setup.joints):
                raise setup.wrong_length(name, values, "pd")
            gains.append(direction * np.asarray(values, dtype=float))
        self.position_gain, self.velocity_gain = gains
        self._setpoint = setup.machine.setpoint
        self.feedback = np.zeros(len(setup.joints))

    def reset(self, measurement: Measurement) -> None:
        """Starts a run; does nothing, because the control law has no memory."""

    def command(self, measurement: Measurement, reference: ReferencePoint) -> np.ndarray:
        """Computes the commands before clipping to [-1, 1], (joints,)."""
        feedback = self.correct(measurement, reference)
        if self._setpoint is None:
            return feedback
        rest, per_position, per_velocity = self._setpoint
        return (
            feedback
            + rest
            + per_position * reference.position
            + (per_velocity * reference.velocity)
        )

    def correct(self, measurement: Measurement, reference: ReferencePoint) -> np.ndarray:
        """Computes the feedback alone, (joints,), for controllers with their own feed-forward."""
        wanted, wanted_velocity, _ = reference
        feedback = self.position_gain * (wanted - measurement.position)
        feedback += self.velocity_gain * (wanted_velocity - measurement.velocity)
        self.feedback = feedback
        return feedback

    def diagnostics(self) -> dict[str, np.ndarray]:
        """Returns the feedback part of the command, (joints,)."""
        return {"feedback": self.feedback}
