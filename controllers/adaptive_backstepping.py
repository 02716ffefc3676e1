"""Model-based baseline: adaptive robust control by backstepping, with measured pressures.

The structure follows Yao, Yang and Ma 2014, IEEE/ASME Trans. Mechatronics 19(2), 633: steps from
position error to load force to valve flow, with leakage as an adapted parameter and lumped
disturbances in the force and flow equations. Single-rod cylinder and compensation at the reference
follow Yao, Bu, Reedy and Chiu 2000, IEEE/ASME Trans. Mechatronics 5(1), 79. Equations and assumed
knowledge of the machine: docs/concepts/adaptive_backstepping.md.
"""

import math
from dataclasses import fields

import numpy as np
from pydantic import Field

from leglab.base.errors import ModelError
from leglab.base.settings import Configuration
from leglab.control import ControllerSetup, Measurement, ReferencePoint, register_controller
from leglab.control.backstepping.adaptation import Adaptation
from leglab.control.backstepping.cylinder import Bristles, CylinderModel
from leglab.control.backstepping.data import FORCE_CUTOFF, PRESSURE_CUTOFF, BacksteppingGains
from leglab.control.backstepping.feedback import Feedback, no_load_speed
from leglab.control.feedforward.motion import ReferenceMotion

_NAME = "adaptive_backstepping"
_FLOW = ("internal_leakage", "external_leakage_a", "external_leakage_b", "null", "lap")


class BacksteppingConfiguration(Configuration):
    """Settings of `adaptive_backstepping`.

    Attributes:
        position_gain: k_1 [1/s], one a joint; None for the tuned gains of the model.
        force_damping: Damping ratio wanted of the oil spring, one a joint; None as above.
        force_drift: Random walk of the unknown force, in forces of the piston at supply pressure
            [1/sqrt(s)], one a joint; None as above.
        flow_drift: Random walk of the unknown flow, in flows at the no-load speed [1/sqrt(s)], one
            a joint; None as above.
        adapt: Whether leakage, valve and friction parameters are adapted. The lumped disturbances
            are in any case.
        flow_memory: Time constant with which leakage and valve forget while they learn [s].
        force_memory: The same of friction and load [s].
        dead_zone: Residuals up to so many times the noise teach nothing.
        limit: Largest valve command.
    """

    position_gain: tuple[float, ...] | None = Field(default=None)
    force_damping: tuple[float, ...] | None = Field(default=None)
    force_drift: tuple[float, ...] | None = Field(default=None)
    flow_drift: tuple[float, ...] | None = Field(default=None)
    adapt: bool = Field(default=True)
    flow_memory: float = Field(default=1.0, gt=0)
    force_memory: float = Field(default=2.0, gt=0)
    dead_zone: float = Field(default=0.5, ge=0)
    limit: float = Field(default=1.0, gt=0, le=1)


@register_controller(
    _NAME,
    summary="computes the command from the hydraulic equations with measured pressures, and "
    "adapts the leakage in them",
    configuration=BacksteppingConfiguration,
)
class AdaptiveBackstepping:
    """Controller that inverts the flow equation at the reference and adds error feedback.

    Attributes:
        adaptation: The adapted physical parameters.
    """

    uses_pressures = True

    def __init__(self, setup: ControllerSetup, config: BacksteppingConfiguration) -> None:
        data = setup.machine.cylinders
        latency = setup.machine.latency
        self._torque = setup.machine.inverse_dynamics
        self._model = model = CylinderModel(data)
        self._period = period = setup.control_period
        self._law = Feedback(
            model,
            _gains(setup, config),
            position_noise=setup.machine.position_noise,
            pressure_noise=setup.machine.pressure_noise,
            period=period,
            latency=latency,
        )
        self.adaptation = Adaptation(
            model,
            self._torque,
            period=period,
            latency=latency,
            valve_delay=self._law.valve_delay,
            speed=no_load_speed(data),
            flow_memory=config.flow_memory,
            force_memory=config.force_memory,
            dead_zone=config.dead_zone,
        )
        # A command acts, on average, half a period and the valve's delay later.
        lead = period / 2 + self._law.valve_delay
        self._motion = ReferenceMotion(
            len(setup.joints), period, lead=lead, position_delay=latency, velocity_delay=latency
        )
        # Number of periods from the present measurement to the time when the new command acts.
        self._age = (lead + latency) / period
        self._bristles = Bristles(data)
        self._smoothing = -math.expm1(-PRESSURE_CUTOFF * period)
        self._force_smoothing = -math.expm1(-FORCE_CUTOFF * period)
        self._limit, self._adapts = config.limit, config.adapt
        self._supply = data.supply_pressure
        self._zeros = np.zeros(len(setup.joints))

    def reset(self, measurement: Measurement) -> None:
        """Starts a run with nominal parameters.

        Raises:
            LeglabError: The measurement has no pressures.
        """
        self.adaptation.reset()
        self._adapt = self._adapts
        self._bristles.reset()
        self._motion.clear()
        self._readings = np.nan_to_num(_stacked(measurement))
        self._pressure = self._readings[1:]
        self._sent = self._rate = self._feedback = self._zeros
        self._forces: list[np.ndarray] = []

    def freeze(self) -> None:
        """Stops adapting leakage, valve and friction until the next `reset`.

        The estimation of the lumped disturbances continues, because it is part of the feedback.
        """
        self._adapt = False

    def command(self, measurement: Measurement, reference: ReferencePoint) -> np.ndarray:
        """Computes the valve commands, (joints,)."""
        model, law = self._model, self._law
        position, pressure, supply = self._read(measurement)
        if self._adapt:
            self.adaptation.take(position, pressure, supply, self._sent)
        leakage, (null, lap) = np.split(self.adaptation.flow.values, [3])

        motion, seen = self._motion.take(reference)
        lever, piston = model.geometry(motion[0])
        speed = lever * motion[1]
        force, rate, earlier = self._forces_for(motion, lever, speed)

        error = model.geometry(position)[0] * (seen.position - position)
        area = model.data.area
        load = area[0] * pressure[0] - area[1] * pressure[1]
        force_error = (load - earlier) / law.stiffness
        if len(self._forces) == 1:
            law.observer.start(error, force_error)
            self._unknown_force = law.unknown_force
        wish = law(error, force_error)
        change = law.unknown_force - self._unknown_force
        self._unknown_force = self._unknown_force + self._force_smoothing * change
        expected = self._expected_pressure(force + self._unknown_force, supply, piston)
        chambers = model.chambers(expected, supply, piston)
        known = rate + model.rate_for(speed, expected, leakage, chambers)
        spool = model.spool_for(known + chambers.stiffness * wish, chambers, lap)
        command = spool - null
        self._sent = np.minimum(np.maximum(command, -self._limit), self._limit)
        if (self._sent != command).any():
            # Anti-windup: the observer gets the speed that results from the limited command.
            reached = model.rate_of(self._sent + null, chambers, lap) - known
            wish = np.where(self._sent != command, reached / chambers.stiffness, wish)
        law.observer.sent(wish)
        self._feedback = wish
        return self._sent

    def _read(self, measurement: Measurement) -> tuple[np.ndarray, np.ndarray, float]:
        """Returns positions, pressures (2, joints) and supply pressure; fills in missing values."""
        readings = _stacked(measurement)
        if not np.isfinite(readings).all():
            readings = np.where(np.isfinite(readings), readings, self._readings)
        self._readings = readings
        supply = measurement.supply_pressure
        if supply is None or not math.isfinite(supply):
            supply = float(self._supply.mean())
        self._pressure = self._pressure + self._smoothing * (readings[1:] - self._pressure)
        return readings[0], readings[1:], supply

    def _forces_for(
        self, motion: np.ndarray, lever: np.ndarray, speed: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns the model's force and force rate for `motion`, then its force when measured.

        `motion` is the reference at the time when the new command acts, (4, joints), `lever` and
        `speed` are its levers and piston speeds. The last force is at the measurement's time.
        """
        needed = self._torque(motion[0], motion[1], motion[2]) / lever
        bristles = self._bristles.advance(speed, self._period)
        force = self.adaptation.load_force(motion[0], speed, bristles, needed)
        last = self._forces[0] if self._forces else force
        whole = int(self._age)
        self._forces = [force, *self._forces[: whole + 1]]
        # A difference quotient lags by half a period. Adding half its last change compensates this.
        before, self._rate = self._rate, (force - last) / self._period
        rate = 1.5 * self._rate - 0.5 * before
        newer = self._forces[min(whole, len(self._forces) - 1)]
        older = self._forces[-1]
        return force, rate, newer + (self._age - whole) * (older - newer)

    def _expected_pressure(
        self, force: np.ndarray, supply: float, piston: np.ndarray
    ) -> np.ndarray:
        """Computes the pressures expected when the command acts [Pa], (2, joints).

        They have the wanted load force and the measured common mode w_B p_A + w_A p_B, which piston
        motion does not change. With the measured load force instead, the inverted flow equation
        would cancel, with a delay, the damping of the oil spring by valve and leakage.
        """
        model = self._model
        chambers = model.chambers(self._pressure, supply, piston)
        (weight_a, weight_b), area = chambers.weight, model.data.area
        common = weight_b * self._pressure[0] + weight_a * self._pressure[1]
        expected = np.empty_like(self._pressure)
        expected[0] = area[1] * common + weight_a * force
        expected[1] = area[0] * common - weight_b * force
        expected /= chambers.stiffness
        return np.minimum(np.maximum(expected, 0.0), supply)

    def diagnostics(self) -> dict[str, np.ndarray]:
        """Returns feedback [m/s], lumped disturbances, adapted leakage, lap, null and friction."""
        viscous, coulomb = self.adaptation.force.values[:2]
        return {
            "feedback": self._feedback,
            "unknown_force": self._unknown_force,
            "unknown_flow": self._law.observer.state[:, 4],
            **dict(zip(_FLOW, self.adaptation.flow.values, strict=True)),
            "viscous": viscous,
            "coulomb": coulomb,
        }


def _stacked(measurement: Measurement) -> np.ndarray:
    """Returns positions and both pressures, (3, joints)."""
    if measurement.pressure_a is None or measurement.pressure_b is None:
        raise ModelError(f"controller {_NAME!r} needs measured pressures, there are none")
    return np.stack([measurement.position, measurement.pressure_a, measurement.pressure_b])


def _gains(setup: ControllerSetup, config: BacksteppingConfiguration) -> BacksteppingGains:
    gains = {}
    for name in (field.name for field in fields(BacksteppingGains)):
        values = getattr(config, name)
        if values is None:
            values = getattr(setup.machine.tuned[_NAME], name)
        if len(values) != len(setup.joints):
            raise setup.wrong_length(name, values, _NAME)
        gains[name] = np.asarray(values, dtype=float)
    return BacksteppingGains(**gains)
