"""Gains of `adaptive_backstepping` from the linearised plant, within a bound on sensitivity."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import differential_evolution

from leglab.backstepping.cylinder import CylinderModel
from leglab.backstepping.data import (
    FORCE_CUTOFF,
    PRESSURE_CUTOFF,
    BacksteppingGains,
    NominalCylinders,
)
from leglab.backstepping.feedback import Feedback, no_load_speed
from leglab.backstepping_plant import OperatingPoint, operating_points
from leglab.measurement import SensorConfiguration, position_uncertainty
from leglab.nominal import nominal_cylinders
from leglab.simulation import Simulation

# Largest sensitivity |1/(1 + L)|: 2 leaves a gain margin of 6 dB and a phase margin of 29 degrees.
SENSITIVITY = 2.0
# The same with valves of this share of their bandwidth, which the controller does not know.
VALVE_SHARE, SLOW_SENSITIVITY = 0.5, 3.0
# Steps that the gains are judged by: so much of the no-load speed and of the piston's force.
_STEP = 0.05
# Bounds of the search, decades of (position_gain, force_drift, flow_drift) and force_damping.
_BOUNDS = ((0.5, 2.2), (-3.0, 0.0), (-3.5, -0.3), (0.0, 1.0))


@dataclass(frozen=True, kw_only=True)
class LinearController:
    """The controller of one joint between measured (x, p_A, p_B) and the spool, linear.

    Attributes:
        a: State matrix: observer, past speeds, slow force, filtered pressures.
        b: Of (x, p_A, p_B), three columns.
        c: One row.
        d: (1, 3).
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray


def linear_controller(
    law: Feedback, area: np.ndarray, point: OperatingPoint, period: float
) -> LinearController:
    """Writes `adaptive_backstepping` of one joint as a linear system.

    Args:
        law: Feedback of that joint alone.
        area: Piston areas, (2,) [m^2].
        point: Operating point, for the valve's inverse.
        period: Control period [s].
    """
    smoothing = -math.expm1(-PRESSURE_CUTOFF * period)
    slowly = -math.expm1(-FORCE_CUTOFF * period)
    a0, old, new, gain, ahead, ahead_input = law.observer.matrices(0)
    weights = law.weights[0]
    past = law.observer.past
    measure = np.zeros((2, 5))
    measure[0, 0] = measure[1, 2] = 1.0
    y = np.zeros((2, 3))
    y[0, 0] = -1.0
    y[1, 1:] = np.array([area[0], -area[1]]) / law.stiffness[0]
    keep = np.eye(5) - gain @ measure
    size = 5 + past + 2 + 3
    a, b = np.zeros((size, size)), np.zeros((size, 3))
    a[:5, :5] = keep @ a0
    a[:5, 5 + past] += keep @ new
    a[:5, 6 + past] += keep @ old
    b[:5] = gain @ y
    speed, speed_b = weights @ ahead @ a[:5], weights @ ahead @ b[:5]
    speed[5] += weights @ ahead_input
    a[5], b[5] = speed, speed_b
    for i in range(6, 7 + past):
        a[i, i - 1] = 1.0
    # phi on its slow way into the expected pressures.
    a[-3], b[-3] = slowly * a[3], slowly * b[3]
    a[-3, -3] = 1.0 - slowly
    for chamber in range(2):
        row = size - 2 + chamber
        a[row, row] = 1.0 - smoothing
        b[row, 1 + chamber] = smoothing
    c = point.spool_per_speed * speed + point.spool_per_force * a[-3]
    d = point.spool_per_speed * speed_b + point.spool_per_force * b[-3]
    c = c + point.spool_per_sum @ a[-2:]
    d = d + point.spool_per_sum @ b[-2:]
    return LinearController(a=a, b=b, c=c[None], d=d[None])


class Loop:
    """Frequency responses of one joint's plants, to judge gains by.

    Args:
        points: Operating points.
        data: Data of the joint alone.
        sensors: Sensors and timing.
    """

    def __init__(
        self,
        points: Sequence[OperatingPoint],
        data: NominalCylinders,
        sensors: SensorConfiguration,
    ) -> None:
        self._points, self._model, self._sensors = points, CylinderModel(data), sensors
        self._speed = float(no_load_speed(data)[0])
        nyquist = math.pi / sensors.control_period
        self._frequencies = np.geomspace(0.5, 0.999 * nyquist, 120)
        self._z = np.exp(1j * self._frequencies * sensors.control_period)[:, None, None]
        self._plants = [
            p.c @ np.linalg.solve(self._z * np.eye(len(p.a)) - p.a, np.hstack([p.b, p.disturbance]))
            for p in points
        ]

    def law(self, gains: BacksteppingGains) -> Feedback:
        """Feedback with these gains."""
        return Feedback(
            self._model,
            gains,
            position_noise=position_uncertainty(self._sensors),
            pressure_noise=self._sensors.pressure_noise,
            period=self._sensors.control_period,
            latency=self._sensors.latency,
        )

    def judge(self, gains: BacksteppingGains) -> tuple[float, float]:
        """Worst response to steps of unknown flow and force, and largest sensitivity.

        Returns:
            Root of the integrated squares of the piston's errors after both steps [m s^(1/2)],
            and max |1/(1 + L)|; where a loop is unstable, infinity and its largest eigenvalue.
        """
        law, worst, peak, radius = self.law(gains), 0.0, 0.0, 0.0
        period = self._sensors.control_period
        area, w = self._model.data.area[:, 0], self._frequencies
        for point, plant in zip(self._points, self._plants, strict=True):
            k = linear_controller(law, area, point, period)
            closed = np.block(
                [[point.a + point.b @ k.d @ point.c, point.b @ k.c], [k.b @ point.c, k.a]]
            )
            radius = max(radius, float(np.abs(np.linalg.eigvals(closed)).max()))
            if radius >= 1.0:
                continue
            answer = (k.c @ np.linalg.solve(self._z * np.eye(len(k.a)) - k.a, k.b))[:, 0] + k.d
            sensitivity = 1.0 / (1.0 - (answer * plant[:, :, 0]).sum(axis=1))
            peak = max(peak, float(np.abs(sensitivity).max()))
            by_flow = plant[:, 0, 0] * point.spool_per_speed * sensitivity * self._speed
            spool = (answer * plant[:, :, 1]).sum(axis=1) * sensitivity
            by_force = plant[:, 0, 1] + plant[:, 0, 0] * spool
            square = (np.abs(by_flow) ** 2 + np.abs(by_force) ** 2) / w**2
            worst = max(worst, _STEP * math.sqrt(np.trapezoid(square, w) / math.pi))
        if radius >= 1.0:
            return math.inf, radius
        return worst, peak


def joint_loop(
    simulation: Simulation, joint: int, sensors: SensorConfiguration, *, valve_share: float = 1.0
) -> Loop:
    """Prepares the judgement of one joint's gains on the nominal machine in its rest pose.

    Args:
        simulation: The machine; it is left as it was.
        joint: Index of the joint.
        sensors: Sensors and timing.
        valve_share: Bandwidth of the valve, as a share of the one that the controller knows.
    """
    data = nominal_cylinders(simulation).joint(joint)
    actuator = simulation.actuators[joint]
    bandwidth = simulation.parameter(actuator, "bandwidth_hz")
    simulation.set_parameter(actuator, "bandwidth_hz", valve_share * bandwidth)
    points = operating_points(
        simulation, joint, data, period=sensors.control_period, latency=sensors.latency
    )
    simulation.set_parameter(actuator, "bandwidth_hz", bandwidth)
    return Loop(points, data, sensors)


def tuned_gains(
    simulation: Simulation, joint: int, sensors: SensorConfiguration
) -> BacksteppingGains:
    """Gains of one joint: the quickest within `SENSITIVITY`, slowed down for a slower valve."""
    gains = tune_joint(joint_loop(simulation, joint, sensors))[0]
    slower = joint_loop(simulation, joint, sensors, valve_share=VALVE_SHARE)
    return derated(gains, slower)


def derated(gains: BacksteppingGains, loop: Loop) -> BacksteppingGains:
    """Scales position gain and drifts down until `SLOW_SENSITIVITY` is kept; a tenth at least."""
    for factor in np.geomspace(1.0, 0.1, 19):
        slower = replace(
            gains,
            position_gain=factor * gains.position_gain,
            force_drift=factor * gains.force_drift,
            flow_drift=factor * gains.flow_drift,
        )
        response, peak = loop.judge(slower)
        if math.isfinite(response) and peak <= SLOW_SENSITIVITY:
            break
    return slower


def gains_of(values: Sequence[float] | np.ndarray) -> BacksteppingGains:
    """Gains of one joint from the variables of the search."""
    return BacksteppingGains(
        position_gain=np.array([10.0 ** values[0]]),
        force_drift=np.array([10.0 ** values[1]]),
        flow_drift=np.array([10.0 ** values[2]]),
        force_damping=np.array([values[3]]),
    )


def tune_joint(loop: Loop) -> tuple[BacksteppingGains, float, float]:
    """Gains with the smallest response to unknown flow and force that keep `SENSITIVITY`.

    Returns:
        The gains, the response and the largest sensitivity, as `Loop.judge` gives them.
    """

    def cost(values: np.ndarray) -> float:
        worst, peak = loop.judge(gains_of(values))
        if not math.isfinite(worst):
            return 1e2 * peak
        return math.log(worst) + 20.0 * max(0.0, peak / SENSITIVITY - 1.0)

    result = differential_evolution(
        cost, _BOUNDS, seed=0, popsize=8, maxiter=18, tol=1e-4, polish=False
    )
    gains = gains_of(result.x)
    return gains, *loop.judge(gains)
