"""The nominal machine's steady valve map, inverted and frozen, beside PD.

The honest baseline for everything that adapts: it knows the new machine as well as a bench
calibration can, and nothing of what happens to it later.
"""

from collections.abc import Sequence

import numpy as np

from leglab.control import ControllerSetup, Measurement, ReferencePoint, register_controller
from leglab.controllers.pd import Pd, PdConfiguration


class ValveMapTable:
    """Bilinear look-up of calibrated valve maps, all joints at once.

    Args:
        maps: One a joint, with `position` (p,) [rad], `velocity` (v,) [rad/s] and `command`
            (p, v); equally long, positions equally spaced, velocities alike but for their scale.
    """

    def __init__(self, maps: Sequence) -> None:
        self._start = np.array([m.position[0] for m in maps])
        self._spacing = np.array([m.position[1] - m.position[0] for m in maps])
        self._speed = np.array([m.velocity[-1] for m in maps])
        self._fractions = maps[0].velocity / maps[0].velocity[-1]
        table = np.stack([m.command for m in maps])
        self._rows, self._columns = table.shape[1:]
        self._flat = table.ravel()
        self._offset = np.arange(len(maps)) * self._rows * self._columns

    def __call__(self, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Valve commands (joints,) at joint positions [rad] and velocities [rad/s], (joints,)."""
        a = ((position - self._start) / self._spacing).clip(0.0, self._rows - 1.0)
        row = a.astype(np.intp)
        np.minimum(row, self._rows - 2, out=row)
        a -= row
        speed = (velocity / self._speed).clip(-1.0, 1.0)
        column = self._fractions.searchsorted(speed, "right") - 1
        np.minimum(column, self._columns - 2, out=column)
        left = self._fractions[column]
        b = (speed - left) / (self._fractions[column + 1] - left)
        at = self._offset + row * self._columns + column
        flat = self._flat
        low = flat[at] + b * (flat[at + 1] - flat[at])
        at += self._columns
        high = flat[at] + b * (flat[at + 1] - flat[at])
        return low + a * (high - low)


@register_controller(
    "static_feedforward",
    summary="inverse of the nominal steady valve map, frozen, beside PD",
    configuration=PdConfiguration,
)
class StaticFeedforward:
    """u = map(r, r') + PD, with the map calibrated on the nominal machine."""

    def __init__(self, setup: ControllerSetup, config: PdConfiguration) -> None:
        self._pd = Pd(setup, config)
        self._map = ValveMapTable(setup.require("valve_maps", "static_feedforward"))
        self._feedforward = np.zeros(len(setup.joints))

    def reset(self, measurement: Measurement) -> None:
        """Starts a run; nothing is learned."""
        self._pd.reset(measurement)

    def command(self, measurement: Measurement, reference: ReferencePoint) -> np.ndarray:
        """Valve commands, (joints,)."""
        self._feedforward = self._map(reference.position, reference.velocity)
        return self._feedforward + self._pd.command(measurement, reference)

    def diagnostics(self) -> dict[str, np.ndarray]:
        """Feed-forward and feedback parts of the command, each (joints,)."""
        return {"feedforward": self._feedforward, **self._pd.diagnostics()}
