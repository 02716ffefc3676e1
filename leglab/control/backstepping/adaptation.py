"""Recursive estimation of leakage, valve and friction parameters from the machine's equations."""

import math

import numpy as np

from leglab.control.backstepping.cylinder import Bristles, CylinderModel
from leglab.control.backstepping.data import InverseDynamics
from leglab.control.backstepping.least_squares import BoundedLeastSquares
from leglab.control.feedforward.motion import SmoothingWindow

# `_WINDOW`: number of samples in the smoothing window. `_INTERVAL`: control periods per update.
_WINDOW, _INTERVAL = 21, 5
# No update while a command in the window exceeds this, because the spool may be at its stop.
_SATURATED = 0.97
# RMS residuals due to noise and model error. `_FLOW_NOISE`: of the flow balances, over the flow at
# full opening. `_FORCE_NOISE`: of the force balance, over the piston's force at supply pressure.
_FLOW_NOISE, _FORCE_NOISE = 2e-3, 5e-3
# Piston speed below which nothing is learned, as a share of the no-load speed.
_LEAST_SPEED = 3e-3


class Adaptation:
    """Recursive estimator of the physical parameters of all joints from smoothed measurements.

    The flow balances of both chambers give (C_i, C_A, C_B) and, as the flows Q follow the valve
    equation at the spool position by the commands, also the valve's null and lap:

        Q_A - A_A v - V_A/beta p_A' = C_i (p_A - p_B) + C_A p_A
        Q_B + A_B v - V_B/beta p_B' = -C_i (p_A - p_B) + C_B p_B

    The force balance gives (b, F_c, s, d_0, d_1, d_2). tau is the nominal inverse dynamics' torque
    for the measured motion, s its relative error, r the lever, z the bristle force over F_c, q the
    distance from mid-range over half the range; d_0 to d_2 are a missing load, e.g. foot contact:

        p_A A_A - p_B A_B = b v + F_c z + (1 + s) tau/r + d_0 + d_1 q + d_2 q^2

    Args:
        model: The nominal hydraulics.
        torque: Inverse dynamics of the nominal rigid bodies.
        period: Control period [s].
        latency: Age of a measurement when its command is sent [s].
        valve_delay: Delay of the spool behind its command [s].
        speed: No-load speed [m/s], (joints,).
        flow_memory: Forgetting time constant of the flow balances, in time spent learning [s].
        force_memory: Forgetting time constant of the force balance, in time spent learning [s].
        dead_zone: Residuals up to `dead_zone` times the noise are ignored.

    Attributes:
        flow: Estimator of (C_i, C_A, C_B, null, lap): leakage [m^3/s/Pa], shift of the valves'
            nulls and overlap of the metering edges, as shares of full spool travel.
        force: Estimator of (b, F_c, s, d_0, d_1, d_2).
    """

    def __init__(
        self,
        model: CylinderModel,
        torque: InverseDynamics,
        *,
        period: float,
        latency: float,
        valve_delay: float,
        speed: np.ndarray,
        flow_memory: float,
        force_memory: float,
        dead_zone: float,
    ) -> None:
        self._model, self._torque = model, torque
        data, joints = model.data, model.joints
        self._joints, self._bristles = joints, Bristles(data)
        self._step = _INTERVAL * period
        low, high = data.position[:, 0], data.position[:, -1]
        self._middle, self._half = (low + high) / 2, (high - low) / 2
        # Signals in the window: positions, pressures of both chambers, commands, supply pressure.
        self._window = SmoothingWindow(4 * joints + 1, _WINDOW, period, derivatives=2)
        # Time shift from command samples to the spool: half a period of hold, latency, valve delay.
        self._shift = period / 2 - latency - valve_delay
        self._least_speed = _LEAST_SPEED * speed
        ones, zero = np.ones(joints), np.zeros(joints)
        flow = data.orifice_gain * np.sqrt(data.supply_pressure)
        leak = 0.01 * flow / data.supply_pressure
        push = data.area[0] * data.supply_pressure
        self.flow = BoundedLeastSquares(
            start=np.stack([data.internal_leakage, zero, zero, zero, data.lap]),
            scale=np.stack([leak, leak, leak, 0.005 * ones, 0.01 * ones]),
            lower=np.stack([zero, zero, zero, -0.1 * ones, zero]),
            upper=np.stack([100 * leak, 100 * leak, 100 * leak, 0.1 * ones, 0.15 * ones]),
            forgetting_factor=math.exp(-_INTERVAL * period / flow_memory),
            noise=_FLOW_NOISE * flow,
            dead_zone=dead_zone,
        )
        self.force = BoundedLeastSquares(
            start=np.stack([data.viscous, data.coulomb, *[zero] * 4]),
            scale=np.stack([data.viscous, data.coulomb, 0.2 * ones, *[0.2 * push] * 3]),
            lower=np.stack([zero, zero, -0.5 * ones, *[-push] * 3]),
            upper=np.stack([30 * data.viscous, 10 * data.coulomb, 2 * ones, *[push] * 3]),
            forgetting_factor=math.exp(-_INTERVAL * period / force_memory),
            noise=_FORCE_NOISE * push,
            dead_zone=dead_zone,
        )
        self.reset()

    def reset(self) -> None:
        """Forgets everything learned."""
        self.flow.reset()
        self.force.reset()
        self._bristles.reset()
        self._window.clear()
        self._count = 0

    def take(
        self,
        position: np.ndarray,
        pressure: np.ndarray,
        supply_pressure: float,
        command: np.ndarray,
    ) -> None:
        """Takes the measurements of one period; updates the parameters every `_INTERVAL` periods.

        Args:
            position: Measured positions [rad], (joints,).
            pressure: Measured pressures [Pa], (2, joints).
            supply_pressure: Measured supply pressure [Pa].
            command: Valve commands sent before the measurement, in [-1, 1], (joints,).
        """
        self._window.push(position, pressure.ravel(), command, (supply_pressure,))
        self._count += 1
        if self._window.full and self._count % _INTERVAL == 0:
            self._learn()

    def _learn(self) -> None:
        joints, model = self._joints, self._model
        area = model.data.area
        smooth = self._window.middle()
        motion = smooth[:, :joints]
        pressure, change = smooth[:2, joints : 3 * joints].reshape(2, 2, joints)
        supply = float(smooth[0, 4 * joints])
        command, command_rate = smooth[:2, 3 * joints : 4 * joints]
        spool = command + self._shift * command_rate
        lever, piston = model.geometry(motion[0])
        speed = lever * motion[1]
        commands = self._window.samples[:, 3 * joints : 4 * joints]
        usable = np.abs(commands).max(axis=0) < _SATURATED
        usable &= np.abs(speed) > self._least_speed

        before = self.flow.values
        internal, leak_a, leak_b, null, lap = before
        chambers = model.chambers(pressure, supply, piston)
        opening, slope = model.openings(spool + null, lap)
        supplied, drained = chambers.edge
        across = pressure[0] - pressure[1]
        flow = supplied * opening - drained * opening[::-1]
        flow -= chambers.compliance * change
        zero = np.zeros(joints)
        residual = flow[0] - area[0] * speed - internal * across - leak_a * pressure[0]
        gain, drain = supplied[0] * slope[0], drained[0] * slope[1]
        row_a = np.stack([across, pressure[0], zero, -(gain + drain), gain - drain])
        self.flow.update(row_a, residual, usable)
        residual = flow[1] + area[1] * speed + internal * across - leak_b * pressure[1]
        gain, drain = supplied[1] * slope[1], drained[1] * slope[0]
        row_b = np.stack([-across, zero, pressure[1], gain + drain, gain - drain])
        residual -= (row_b * (self.flow.values - before)).sum(axis=0)
        self.flow.update(row_b, residual, usable)

        needed = self._torque(motion[0], motion[1], motion[2]) / lever
        bristles = self._bristles.advance(speed, self._step)
        load = area[0] * pressure[0] - area[1] * pressure[1]
        row = self._force_regressor(motion[0], speed, bristles, needed)
        residual = load - needed - (row * self.force.values).sum(axis=0)
        self.force.update(row, residual, usable)

    def _force_regressor(
        self, position: np.ndarray, speed: np.ndarray, bristles: np.ndarray, needed: np.ndarray
    ) -> np.ndarray:
        place = (position - self._middle) / self._half
        return np.stack([speed, bristles, needed, np.ones_like(place), place, place * place])

    def load_force(
        self, position: np.ndarray, speed: np.ndarray, bristles: np.ndarray, needed: np.ndarray
    ) -> np.ndarray:
        """Computes the load force of a motion by the present parameters [N], (joints,).

        Args:
            position: Joint positions [rad], (joints,).
            speed: Piston speeds [m/s], (joints,).
            bristles: Bristle forces as returned by `Bristles.advance`, (joints,).
            needed: tau/r of the nominal machine for this motion [N], (joints,).
        """
        row = self._force_regressor(position, speed, bristles, needed)
        return needed + (row * self.force.values).sum(axis=0)
