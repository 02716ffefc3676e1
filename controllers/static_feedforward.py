"""Feed-forward by the nominal machine's calibrated valve map, which never changes, added to PD.

It is the baseline for adaptive controllers, because it knows the new machine as exactly as a
calibration on a test bench can measure it, but no later change.
"""

from collections.abc import Sequence

import numpy as np

from leglab._native.identification import ValveMaps
from leglab.control import ControllerSetup, Measurement, ReferencePoint, register_controller
from leglab.control.feedforward.valve_table import ValveTable
from leglab.controllers.pd import Pd, PdConfiguration


class ValveMapTable:
    """Bilinear look-up of calibrated valve maps, all joints at once.

    Args:
        maps: One per joint, with `position` (p,) [rad], `velocity` (v,) [rad/s] and `command`
            (p, v); positions equally spaced, velocities equal up to a factor per joint.
    """

    def __init__(self, maps: Sequence) -> None:
        self._core = ValveMaps(vars(ValveTable.of(maps)))

    def __call__(self, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Interpolates commands (joints,) at positions [rad] and velocities [rad/s], (joints,)."""
        command = np.empty(len(position))
        self._core.command(position, velocity, command)
        return command


@register_controller(
    "static_feedforward",
    summary="adds to pd the valve command that the calibrated map of the healthy machine gives "
    "for the wanted motion, and never learns",
    configuration=PdConfiguration,
)
class StaticFeedforward:
    """u = map(r, r') + PD, with the map calibrated on the nominal machine."""

    joint_wise = True

    def __init__(self, setup: ControllerSetup, config: PdConfiguration) -> None:
        self._pd = Pd(setup, config)
        self._map = ValveMapTable(setup.machine.valve_maps)
        self._feedforward = np.zeros(len(setup.joints))

    def reset(self, measurement: Measurement) -> None:
        """Starts a run; the map does not change."""
        self._pd.reset(measurement)

    def command(self, measurement: Measurement, reference: ReferencePoint) -> np.ndarray:
        """Computes the valve commands, (joints,)."""
        self._feedforward = self._map(reference.position, reference.velocity)
        return self._feedforward + self._pd.correct(measurement, reference)

    def diagnostics(self) -> dict[str, np.ndarray]:
        """Returns feed-forward and feedback parts of the command, each (joints,)."""
        return {"feedforward": self._feedforward, "feedback": self._pd.feedback}
