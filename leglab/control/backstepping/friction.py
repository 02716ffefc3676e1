"""Bristle friction of the seals along a known motion."""

import numpy as np

from leglab.control.backstepping.data import NominalCylinders


class Bristles:
    """LuGre bristles of all seals, in units of their nominal Coulomb friction.

    z' = v - sigma_0 |v| z/g(v), solved exactly for a speed held over a step (Canudas de Wit et al.
    1995, IEEE Trans. Autom. Control 40(3), 419). Model-based compensation of hydraulic actuators
    with it: Yao, Deng and Jiao 2015, IEEE Trans. Ind. Electron. 62(10), 6469. After a reversal the
    force builds up over some tens of micrometres, which a function of speed cannot tell.

    Args:
        data: Nominal cylinders.
    """

    def __init__(self, data: NominalCylinders) -> None:
        # Without dry friction the shape does not matter: what it is multiplied by is zero.
        coulomb = np.maximum(data.coulomb, 1e-6)
        self._excess = np.maximum(data.static / coulomb, 1.0) - 1.0
        self._stiffness = data.sigma_0 / coulomb
        self._speed = data.stribeck_velocity
        self.reset()

    def reset(self) -> None:
        """Unloads all bristles."""
        self._force = np.zeros_like(self._speed)

    def advance(self, speed: np.ndarray, time: float) -> np.ndarray:
        """Moves all pistons on; returns sigma_0 z/F_c, (joints,).

        Args:
            speed: [m/s], (joints,).
            time: Over which it holds [s].
        """
        level = 1.0 + self._excess * np.exp(-((speed / self._speed) ** 2))
        steady = np.copysign(level, speed)
        decay = np.exp(-self._stiffness * time * np.abs(speed) / level)
        self._force = steady + (self._force - steady) * decay
        return self._force
