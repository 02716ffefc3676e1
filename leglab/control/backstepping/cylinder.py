"""Equations of all nominal cylinders at once: flow, pressure, inverse valve, and seal friction.

Chamber quantities have shape (2, joints): cap side (A) first, rod side (B) second. See
docs/concepts/physics.md for equations and symbols.
"""

from typing import NamedTuple

import numpy as np

from leglab.control.backstepping.data import NominalCylinders

_ATMOSPHERE = 101325.0  # Pa
# Lower bound of the pressure drop over a metering edge, as a share of the supply pressure, because
# the flow equation cannot be inverted at a drop of zero.
_LEAST_DROP = 0.02
# Bound of the spool position in Newton's method; the spool's mechanical stops are at 1.
_FULL = 1.5


class Chambers(NamedTuple):
    """Hydraulic quantities of both chambers at a piston position and pressures.

    Attributes:
        edge: Flow per opening of the metering edges [m^3/s], (2, 2, joints). First axis: edges to
            supply and to tank; second axis: chambers A and B.
        compliance: V/beta [m^3/Pa], (2, joints).
        weight: A beta/V, force rate per flow into a chamber [N/m^3], (2, joints).
        stiffness: Stiffness of the oil spring [N/m], (joints,).
    """

    edge: np.ndarray
    compliance: np.ndarray
    weight: np.ndarray
    stiffness: np.ndarray


class CylinderModel:
    """Hydraulic equations of all joints with the values of their data sheets."""

    def __init__(self, data: NominalCylinders) -> None:
        self.data = data
        joints = len(data.stroke)
        self.joints = joints
        # Pressure drop: p_s - p over the edge to the supply, p - p_t over the edge to the tank.
        self._sign = np.array([-1.0, 1.0])[:, None, None]
        self._transition = np.broadcast_to(
            data.laminar_transition_pressure**2, (2, 2, joints)
        ).copy()
        self._least = _LEAST_DROP * data.supply_pressure
        self._inverse_index = 1.0 / data.polytropic_index
        self._ends = np.zeros((2, 1, joints))
        self._ends[1, 0] = data.tank_pressure
        self._quarter = data.edge_rounding**2 / 4
        self._chamber_sign = np.array([1.0, -1.0])[:, None]
        self._start = data.position[:, 0]
        self._per_step = 1.0 / (data.position[:, 1] - data.position[:, 0])
        self._columns = data.position.shape[1]
        self._table = np.stack([data.lever, data.piston]).reshape(2, -1)
        self._offset = np.arange(joints) * self._columns

    def geometry(self, position: np.ndarray) -> np.ndarray:
        """Interpolates levers [m/rad] and piston positions [m], (2, joints), at positions [rad]."""
        at = (position - self._start) * self._per_step
        at = np.minimum(np.maximum(at, 0.0), self._columns - 1.0)
        column = np.minimum(at.astype(np.intp), self._columns - 2)
        at -= column
        column += self._offset
        low = self._table.take(column, axis=1)
        column += 1
        return low + at * (self._table.take(column, axis=1) - low)

    def chambers(
        self, pressure: np.ndarray, supply_pressure: np.ndarray | float, piston: np.ndarray
    ) -> Chambers:
        """Computes edge flows, compliance and stiffness from pressures and piston positions.

        Args:
            pressure: Gauge pressures of the chambers [Pa], (2, joints).
            supply_pressure: Gauge pressure of the supply [Pa].
            piston: Piston positions [m], (joints,).
        """
        data = self.data
        self._ends[0, 0] = supply_pressure
        drop = self._sign * (pressure - self._ends)
        drop = np.maximum(drop, self._least)
        edge = data.orifice_gain * drop / np.sqrt(np.sqrt(drop * drop + self._transition))
        volume = np.empty_like(pressure)
        volume[0] = piston
        volume[1] = data.stroke - piston
        volume *= data.area
        volume += data.dead_volume
        compliance = volume / self.bulk_modulus(pressure)
        weight = data.area / compliance
        return Chambers(edge, compliance, weight, (data.area * weight).sum(axis=0))

    def bulk_modulus(self, pressure: np.ndarray) -> np.ndarray:
        """Computes the effective bulk modulus [Pa] of oil with air at gauge pressures [Pa].

        beta = (g + l)/(g/(n p) + l/beta_l), g = x_0 (p_0/p)^(1/n), l about 1 - x_0.
        """
        data = self.data
        absolute = np.maximum(pressure + _ATMOSPHERE, 0.1 * _ATMOSPHERE)
        gas = data.entrained_air * (_ATMOSPHERE / absolute) ** self._inverse_index
        oil = 1.0 - data.entrained_air
        return (gas + oil) / (gas * self._inverse_index / absolute + oil / data.bulk_modulus)

    def openings(self, spool: np.ndarray, lap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Computes edge openings for positive and negative spool, and slopes, (2, joints) each."""
        d = self._chamber_sign * spool - lap
        root = np.sqrt(d * d + 4 * self._quarter)
        return 0.5 * (d + root), 0.5 * (1.0 + d / root)

    def rate_for(
        self, speed: np.ndarray, pressure: np.ndarray, leakage: np.ndarray, chambers: Chambers
    ) -> np.ndarray:
        """Computes the force rate [N/s] that the valve flow must cause, given speed and leakage.

        Args:
            speed: Piston speeds [m/s], (joints,).
            pressure: Chamber pressures [Pa], (2, joints).
            leakage: Coefficients of internal leakage, and of external leakage of chambers A and B
                [m^3/s/Pa], (3, joints).
            chambers: Chambers at these pressures.
        """
        across = leakage[0] * (pressure[0] - pressure[1])
        outside = leakage[1:] * pressure
        lost_a, lost_b = chambers.weight[0] * (across + outside[0]), outside[1] - across
        return chambers.stiffness * speed + lost_a - chambers.weight[1] * lost_b

    def spool_for(self, rate: np.ndarray, chambers: Chambers, lap: np.ndarray) -> np.ndarray:
        """Computes the spool positions at which valve flow changes the force at a rate, (joints,).

        Solves w_A Q_A(x) - w_B Q_B(x) = rate, monotone in x, by Newton's method from the solution
        with only the edges of one spool direction open.

        Args:
            rate: Wanted force rate by valve flow alone [N/s], (joints,).
            chambers: Chambers at the present pressures.
            lap: Overlap of the edges, (joints,).
        """
        up, down = _rates(chambers)
        # The opening (d + sqrt(d^2 + eps^2))/2 equals `one` at d = one - eps^2/(4 one).
        one = np.where(rate > 0, rate / up, -rate / down) + 0.3 * self.data.edge_rounding
        spool = np.copysign(np.maximum(lap + one - self._quarter / one, 0.0), rate)
        for _ in range(3):
            opening, slope = self.openings(spool, lap)
            excess = up * opening[0] - down * opening[1] - rate
            spool = spool - excess / (up * slope[0] + down * slope[1])
            spool = np.minimum(np.maximum(spool, -_FULL), _FULL)
        return spool

    def rate_of(self, spool: np.ndarray, chambers: Chambers, lap: np.ndarray) -> np.ndarray:
        """Computes the force rate by valve flow [N/s], (joints,); the inverse of `spool_for`."""
        up, down = _rates(chambers)
        opening, _ = self.openings(spool, lap)
        return up * opening[0] - down * opening[1]


def _rates(chambers: Chambers) -> tuple[np.ndarray, np.ndarray]:
    """Computes force rates by valve flow per opening, for positive and for negative spool."""
    (supply_a, supply_b), (tank_a, tank_b) = chambers.edge
    weight_a, weight_b = chambers.weight
    return weight_a * supply_a + weight_b * tank_b, weight_a * tank_a + weight_b * supply_b


class Bristles:
    """LuGre bristles of all seals, in units of their nominal Coulomb friction.

    z' = v - sigma_0 |v| z/g(v), solved exactly for constant speed during a step (Canudas de Wit et
    al. 1995, IEEE Trans. Autom. Control 40(3), 419); for compensation of hydraulic actuators see
    Yao, Deng and Jiao 2015, IEEE Trans. Ind. Electron. 62(10), 6469. After a reversal the friction
    force builds up over some tens of micrometres, which no function of speed can represent.
    """

    def __init__(self, data: NominalCylinders) -> None:
        # The result is multiplied by Coulomb friction, so it is arbitrary if that friction is zero.
        coulomb = np.maximum(data.coulomb, 1e-6)
        self._excess = np.maximum(data.static / coulomb, 1.0) - 1.0
        self._stiffness = data.sigma_0 / coulomb
        self._speed = data.stribeck_velocity
        self.reset()

    def reset(self) -> None:
        """Unloads all bristles."""
        self._force = np.zeros_like(self._speed)

    def advance(self, speed: np.ndarray, time: float) -> np.ndarray:
        """Advances all bristles by a time step; returns sigma_0 z/F_c, (joints,).

        Args:
            speed: Piston speeds during the step [m/s], (joints,).
            time: Duration of the step [s].
        """
        level = 1.0 + self._excess * np.exp(-((speed / self._speed) ** 2))
        steady = np.copysign(level, speed)
        decay = np.exp(-self._stiffness * time * np.abs(speed) / level)
        self._force = steady + (self._force - steady) * decay
        return self._force
