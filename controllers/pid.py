"""PD with an integral part, the industrial standard for a machine that changes."""

import numpy as np
from pydantic import Field

from leglab.control import ControllerSetup, Measurement, ReferencePoint, register_controller
from leglab.controllers.pd import Pd, PdConfiguration


class PidConfiguration(PdConfiguration):
    """Settings of `pid`: those of `pd`, and the integral.

    Attributes:
        integral_time: T_i [s]: K_i = K_p/T_i. It costs atan(1/(w T_i)) of phase at the crossover
            w: 6 degrees at the slowest one, 10 rad/s.
        limit: Largest integral part [valve command].
    """

    integral_time: float = Field(default=1.0, gt=0)
    limit: float = Field(default=0.3, gt=0, le=1)


@register_controller(
    "pid",
    summary="is pd with an integral of the position error, which takes away what lasts",
    configuration=PidConfiguration,
)
class Pid:
    """u = PD + integral of s K_p (r - q)/T_i; limited, and not increased during saturation."""

    def __init__(self, setup: ControllerSetup, config: PidConfiguration) -> None:
        self._pd = Pd(setup, config)
        self._step = setup.control_period / config.integral_time * self._pd.position_gain
        self._limit = config.limit
        self._integral = np.zeros(len(setup.joints))

    def reset(self, measurement: Measurement) -> None:
        """Starts a run with an empty integral."""
        self._pd.reset(measurement)
        self._integral = np.zeros_like(self._integral)

    def command(self, measurement: Measurement, reference: ReferencePoint) -> np.ndarray:
        """Computes the valve commands, (joints,)."""
        command = self._pd.command(measurement, reference) + self._integral
        step = self._step * (reference.position - measurement.position)
        # Conditional integration (Astrom and Hagglund 2006, Advanced PID Control, ch. 3.5).
        grows = (np.abs(command) >= 1.0) & (step * command > 0)
        wish = self._integral + np.where(grows, 0.0, step)
        self._integral = np.minimum(np.maximum(wish, -self._limit), self._limit)
        return command

    def diagnostics(self) -> dict[str, np.ndarray]:
        """Returns proportional-derivative and integral parts of the command, each (joints,)."""
        return {**self._pd.diagnostics(), "integral": self._integral}
