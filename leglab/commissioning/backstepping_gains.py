"""Tuning of `adaptive_backstepping` on the linearised plant, within a bound on sensitivity.

Gains of the shipped models are stored in `backstepping_gains.toml`, which
`python -m leglab.commissioning.backstepping_gains` rewrites (some minutes).
"""

import math
from dataclasses import asdict, dataclass, fields, replace
from itertools import product
from pathlib import Path

import numpy as np

from leglab.base.errors import LeglabError
from leglab.commissioning.gains_file import GAINS, ControllerGains, Row
from leglab.commissioning.nominal import nominal_cylinders
from leglab.commissioning.pd_gains import SPEEDS, joint_plant, operating_poses, sampled_plant
from leglab.control.backstepping.cylinder import CylinderModel
from leglab.control.backstepping.data import FORCE_CUTOFF, PRESSURE_CUTOFF, BacksteppingGains
from leglab.control.backstepping.feedback import Feedback, no_load_speed
from leglab.machine.cylinder import Cylinder
from leglab.machine.sensors import SensorConfiguration, position_uncertainty
from leglab.machine.simulation import Simulation


@dataclass(frozen=True, kw_only=True)
class OperatingPoint:
    """Sampled plant of one joint, linearised at a pose and a piston speed."""

    a: np.ndarray  #: State matrix; three states are the delayed measurements, (9, 9)
    b: np.ndarray  #: Input matrix of the spool command, (9, 1)
    #: Input matrix of a force on the piston against extension, as a share of the force at supply
    #: pressure, (9, 1).
    disturbance: np.ndarray
    c: np.ndarray  #: Output matrix: piston position and both pressures, as measured, (3, 9)
    spool_per_speed: float  #: Slope of the commanded spool position over piston speed [s/m]
    spool_per_force: float  #: Slope of the spool position over phi, which sets pressures [1/m]
    #: Slope of the spool position over both pressures, due to their common mode, (2,) [1/Pa].
    spool_per_sum: np.ndarray


def _point(
    simulation: Simulation,
    joint: int,
    speed: float,
    held: bool,
    model: CylinderModel,
    sensors: SensorConfiguration,
) -> OperatingPoint:
    """Linearises the plant in the present pose, at a piston speed, other joints held or free."""
    import control  # takes a second

    lever = float(simulation.levers()[joint])
    plant = joint_plant(simulation, joint, speed, held=held)
    # States: piston velocity, both pressures, spool and its velocity, joint position.
    c = np.zeros((3, 6))
    c[0, 5], c[1, 1], c[2, 2] = lever, 1.0, 1.0
    # Input matrix of a force on the piston, from the entry area/mass in the column of pressure A.
    push = np.zeros((6, 1))
    push[0] = -plant.A[0, 1] * model.data.supply_pressure
    plant = control.ss(plant.A, np.hstack([plant.B, push]), c, 0)
    sampled = sampled_plant(plant, sensors.control_period, sensors.latency)

    values = simulation.cylinder_parameters(simulation.actuators[joint])
    values.update(coulomb=0.0, static=0.0, sigma_0=0.0, sigma_1=0.0)
    force = float(simulation.data.qfrc_bias[simulation.dof_index[joint]]) / lever
    steady = Cylinder(values).steady_state(speed, force)
    pressure = np.array([[steady.pressure_a], [steady.pressure_b]])
    supply = model.data.supply_pressure
    piston = model.geometry(simulation.position()[joint : joint + 1])[1]
    leakage = np.array([model.data.internal_leakage, [0.0], [0.0]])
    lap = model.data.lap

    def spool(change: np.ndarray | float = 0.0, faster: float = 0.0) -> float:
        shifted = pressure + change
        chambers = model.chambers(shifted, supply, piston)
        rate = model.rate_for(np.array([speed + faster]), shifted, leakage, chambers)
        return float(model.spool_for(rate, chambers, lap)[0])

    weight = model.chambers(pressure, supply, piston).weight
    area, stiffness = model.data.area, float((model.data.area * weight).sum())
    by_force = np.array([weight[0], -weight[1]])
    by_sum = area[::-1] / stiffness
    step, scale = 1e-6, 1e3  # m, of phi; Pa
    per_sum = []
    for other in weight[::-1]:
        pressures = by_sum * (other * scale)
        per_sum.append((spool(pressures) - spool(-pressures)) / (2 * scale))
    return OperatingPoint(
        a=sampled.A,
        b=sampled.B[:, :1],
        disturbance=sampled.B[:, 1:],
        c=sampled.C,
        spool_per_speed=(spool(0.0, 1e-5) - spool(0.0, -1e-5)) / 2e-5,
        spool_per_force=(spool(step * by_force) - spool(-step * by_force)) / (2 * step),
        spool_per_sum=np.array(per_sum),
    )


# Largest allowed sensitivity |1/(1 + L)|; 2 guarantees margins of 6 dB and 29 degrees.
SENSITIVITY = 2.0
# `VALVE_SHARE`: bandwidth of slow valves over the assumed one. `SLOW_SENSITIVITY`: bound with them.
VALVE_SHARE, SLOW_SENSITIVITY = 0.5, 3.0
# Steps by which gains are rated: unknown flow over no-load flow, and force over piston force.
_STEP = 0.05
# Search bounds: log10 of position_gain, force_drift and flow_drift, then force_damping.
_BOUNDS = ((0.5, 2.2), (-3.0, 0.0), (-3.5, -0.3), (0.0, 1.0))


def _linear_controller(
    law: Feedback, area: np.ndarray, point: OperatingPoint, period: float
) -> tuple[np.ndarray, ...]:
    """Linearises `adaptive_backstepping` of one joint from (x, p_A, p_B) to spool: (a, b, c, d).

    States: the observer's, past speeds, the low-pass filtered force, both filtered pressures.
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
    # phi, low-pass filtered, for the expected pressures.
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
    return a, b, c[None], d[None]


class JointLoop:
    """Frequency responses of one joint's plants, for the evaluation of gains.

    Poses and speeds are as in the tuning of `pd`, each once with the other joints free, once held.

    Args:
        simulation: The nominal machine in its rest pose; its state is restored.
        joint: Index of the joint.
        sensors: Sensors and timing.
        valve_share: Bandwidth of the valve over the bandwidth that the controller assumes.
    """

    def __init__(
        self,
        simulation: Simulation,
        joint: int,
        sensors: SensorConfiguration,
        *,
        valve_share: float = 1.0,
    ) -> None:
        data = nominal_cylinders(simulation).joints([joint])
        self._model, self._sensors = CylinderModel(data), sensors
        self._speed = float(no_load_speed(data)[0])
        actuator = simulation.actuators[joint]
        bandwidth = simulation.parameter(actuator, "bandwidth_hz")
        simulation.set_parameter(actuator, "bandwidth_hz", valve_share * bandwidth)
        self._points = []
        for _ in operating_poses(simulation, joint):
            for speed, held in product(SPEEDS, (False, True)):
                try:
                    point = _point(simulation, joint, speed, held, self._model, sensors)
                except LeglabError:
                    continue  # the cylinder cannot run at this speed under this load
                self._points.append(point)
        simulation.set_parameter(actuator, "bandwidth_hz", bandwidth)
        nyquist = math.pi / sensors.control_period
        self._frequencies = np.geomspace(0.5, 0.999 * nyquist, 120)
        self._z = np.exp(1j * self._frequencies * sensors.control_period)[:, None, None]
        self._plants = [
            p.c @ np.linalg.solve(self._z * np.eye(len(p.a)) - p.a, np.hstack([p.b, p.disturbance]))
            for p in self._points
        ]

    def judge(self, gains: BacksteppingGains) -> tuple[float, float]:
        """Computes the worst response to steps of unknown flow and force, and largest sensitivity.

        Returns:
            Root of the integrated squared errors of the piston after both steps [m s^(1/2)], and
            max |1/(1 + L)|; for an unstable loop infinity and the largest |eigenvalue|.
        """
        period, worst, peak, radius = self._sensors.control_period, 0.0, 0.0, 0.0
        law = Feedback(
            self._model,
            gains,
            position_noise=position_uncertainty(self._sensors),
            pressure_noise=self._sensors.pressure_noise,
            period=period,
            latency=self._sensors.latency,
        )
        area, w = self._model.data.area[:, 0], self._frequencies
        for point, plant in zip(self._points, self._plants, strict=True):
            a, b, c, d = _linear_controller(law, area, point, period)
            closed = np.block([[point.a + point.b @ d @ point.c, point.b @ c], [b @ point.c, a]])
            radius = max(radius, float(np.abs(np.linalg.eigvals(closed)).max()))
            if radius >= 1.0:
                continue
            answer = (c @ np.linalg.solve(self._z * np.eye(len(a)) - a, b))[:, 0] + d
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


def _derated(gains: BacksteppingGains, loop: JointLoop) -> BacksteppingGains:
    """Lowers position gain and drifts, at most to a tenth, until `SLOW_SENSITIVITY` is met."""
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


def _quickest(loop: JointLoop) -> BacksteppingGains:
    """Finds gains with the smallest response to unknown flow and force within `SENSITIVITY`."""
    from scipy.optimize import differential_evolution  # slow to import, seldom needed

    def gains_of(values: np.ndarray) -> BacksteppingGains:
        return BacksteppingGains(
            position_gain=np.array([10.0 ** values[0]]),
            force_drift=np.array([10.0 ** values[1]]),
            flow_drift=np.array([10.0 ** values[2]]),
            force_damping=np.array([values[3]]),
        )

    def cost(values: np.ndarray) -> float:
        worst, peak = loop.judge(gains_of(values))
        if not math.isfinite(worst):
            return 1e2 * peak
        return math.log(worst) + 20.0 * max(0.0, peak / SENSITIVITY - 1.0)

    result = differential_evolution(
        cost, _BOUNDS, seed=0, popsize=8, maxiter=18, tol=1e-4, polish=False
    )
    return gains_of(result.x)


def _rows(model: str, simulation: Simulation, sensors: SensorConfiguration) -> list[Row]:
    rows = []
    for joint in range(len(simulation.joints)):
        loop = JointLoop(simulation, joint, sensors)
        slower = JointLoop(simulation, joint, sensors, valve_share=VALVE_SHARE)
        gains = _derated(_quickest(loop), slower)
        response, peak = loop.judge(gains)
        row = {name: float(values[0]) for name, values in asdict(gains).items()}
        rows.append({**row, "response": response, "sensitivity": peak})
    return rows


BACKSTEPPING = ControllerGains(
    path=Path(__file__).with_name("backstepping_gains.toml"),
    head=(
        "Gains by `python -m leglab.commissioning.backstepping_gains`: the smallest",
        f"response to unknown flow and force with a sensitivity of at most {SENSITIVITY:g}",
        "at every pose and piston speed of the linearised nominal plant, slowed down for",
        f"{SLOW_SENSITIVITY:g} at {VALVE_SHARE:g} times the valves' bandwidth. Not to be edited.",
    ),
    timing=("control_period", "latency"),
    formats={
        **{field.name: ".4g" for field in fields(BacksteppingGains)},
        "response": ".3g",
        "sensitivity": ".3f",
    },
    kind=BacksteppingGains,
    tune=_rows,
)
GAINS.add("adaptive_backstepping", BACKSTEPPING, _rows)

if __name__ == "__main__":
    BACKSTEPPING.write()
