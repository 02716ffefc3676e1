"""Inner force loop: valve commands with which cylinders produce wanted joint torques."""

import numpy as np

from leglab.control.backstepping.cylinder import CylinderModel
from leglab.control.backstepping.data import NominalCylinders
from leglab.control.contract import Measurement

# `_BANDWIDTH`: bandwidth w of the force loop times the control period. `_INTEGRAL`: w_i/w, relative
# rate of the integral part. With hold, latency and valve lag, the phase margin is about 30 degrees.
_BANDWIDTH, _INTEGRAL = 0.4, 0.5


class TorqueLoop:
    """Force loop of all cylinders: flow into the chambers reduces the force error.

    The wanted rate is dF/dt = w (e + integral of w_i e), with the error e = torque/lever - F and
    the measured force F = p_A A_A - p_B A_B. The valve equation at the present speed and leakage
    gives the command for it. The integral compensates the delay of the measured speed; it is halted
    while the valve is fully open. Friction of seals and joints is not compensated.

    Args:
        data: Data sheets of the nominal machine's cylinders.
        control_period: [s].

    Attributes:
        limit: Torque limit [N m, or N for slides], (joints,): supply less tank pressure times the
            smaller piston area (rod side) times the largest lever arm.
    """

    def __init__(self, data: NominalCylinders, control_period: float) -> None:
        self._model, self._bandwidth = CylinderModel(data), _BANDWIDTH / control_period
        self._share = _INTEGRAL * _BANDWIDTH  # share of an error added to the integral per period
        self._integral = np.zeros(len(data.stroke))
        self._leakage = np.zeros((3, len(data.stroke)))
        self._leakage[0] = data.internal_leakage
        drop = data.supply_pressure - data.tank_pressure
        self.limit = drop * data.area.min(axis=0) * np.abs(data.lever).max(axis=1)

    def reset(self, joints: np.ndarray | None = None) -> None:
        """Zeroes the integrals of all joints, or of those marked in `joints`, (joints,) of bool."""
        self._integral[slice(None) if joints is None else joints] = 0.0

    def command(
        self,
        torque: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
        pressure: np.ndarray,
        supply_pressure: np.ndarray | float,
        rests: np.ndarray | bool = False,
    ) -> np.ndarray:
        """Computes the valve commands in [-1, 1], (joints,).

        Args:
            torque: Wanted torques [N m], (joints,).
            position: Measured positions [rad], (joints,).
            velocity: Measured velocities [rad/s], (joints,).
            pressure: Measured pressures on cap and rod side [Pa], (2, joints).
            supply_pressure: Measured supply pressure [Pa], one number or (joints,).
            rests: Mask of joints, (joints,), whose machines rest, so that nothing is integrated.
        """
        data = self._model.data
        lever, piston = self._model.geometry(position)
        chambers = self._model.chambers(pressure, supply_pressure, piston)
        error = torque / lever - (pressure[0] * data.area[0] - pressure[1] * data.area[1])
        rate = self._bandwidth * (error + self._integral)
        rate += self._model.rate_for(lever * velocity, pressure, self._leakage, chambers)
        spool = self._model.spool_for(rate, chambers, data.lap)
        self._integral += np.where(rests | (np.abs(spool) >= 1.0), 0.0, self._share * error)
        return spool.clip(-1.0, 1.0)

    def of(self, torque: np.ndarray, now: Measurement) -> np.ndarray:
        """Computes `command` for a measurement, which must contain pressures."""
        assert now.pressure_a is not None
        assert now.pressure_b is not None
        assert now.supply_pressure is not None
        pressure = np.stack([now.pressure_a, now.pressure_b])
        return self.command(torque, now.position, now.velocity, pressure, now.supply_pressure)
