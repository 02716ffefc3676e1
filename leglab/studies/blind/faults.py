"""Hidden faults: what nature does to the plant. Written apart from the effect classes."""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from leglab.studies.blind.bench import NOMINAL, NULL_SHIFT, SPRING, TOLERANCES, VALVE, bench
from leglab.studies.blind.plant import TIMESTEP, Plant


@dataclass(frozen=True, kw_only=True)
class Severity:
    """A drawn severity.

    Attributes:
        parameter: Of the effect, as the diagnosis calls it; empty where it has another form.
        value: True value of the parameter.
    """

    parameter: str
    value: float


Fault = Callable[[Plant, np.random.Generator], Severity]
_SPRING_PARAMETERS = frozenset({"k1", "k2", "rest_position", "d1", "quadratic_damping"})


def _scaled(name: str, *ranges: tuple[float, float]) -> Fault:
    """Multiplies a plugin parameter by a factor, log-uniform in one of the ranges."""

    def apply(plant: Plant, rng: np.random.Generator) -> Severity:
        low, high = ranges[rng.integers(len(ranges))]
        factor = float(np.exp(rng.uniform(np.log(low), np.log(high))))
        return _put(plant, name, factor * _present(plant, name))

    return apply


def _shifted(name: str, low: float, high: float, *, signed: bool) -> Fault:
    """Adds to a plugin parameter, uniform in a range, of either sign where `signed`."""

    def apply(plant: Plant, rng: np.random.Generator) -> Severity:
        sign = rng.choice((-1.0, 1.0)) if signed else 1.0
        return _put(plant, name, _present(plant, name) + float(sign * rng.uniform(low, high)))

    return apply


def _element(name: str) -> str:
    return SPRING if name in _SPRING_PARAMETERS else VALVE


def _present(plant: Plant, name: str) -> float:
    key = _element(name), name
    return plant.parameters.get(key, plant.tuning.get(key, NOMINAL[name]))


def _put(plant: Plant, name: str, value: float) -> Severity:
    plant.parameters[_element(name), name] = value
    return Severity(parameter=name, value=value)


def _coulomb(plant: Plant, rng: np.random.Generator) -> Severity:
    rise = float(rng.uniform(60.0, 300.0))
    _put(plant, "static", _present(plant, "static") + rise)
    return _put(plant, "coulomb", _present(plant, "coulomb") + rise)


def _stiction(plant: Plant, rng: np.random.Generator) -> Severity:
    rise = float(rng.uniform(90.0, 450.0))
    _put(plant, "static", _present(plant, "static") + rise)
    # The share of the Coulomb friction, a tolerance, counts there.
    return Severity(parameter="static", value=NOMINAL["static"] + rise)


def _delay(plant: Plant, rng: np.random.Generator) -> Severity:
    plant.command_delay = TIMESTEP * round(rng.uniform(0.003, 0.02) / TIMESTEP)
    return Severity(parameter="delay", value=plant.command_delay)


def _payload(plant: Plant, rng: np.random.Generator) -> Severity:
    mass, distance = float(rng.uniform(0.5, 3.0)), float(rng.uniform(0.25, 0.5))
    model = plant.model
    body = model.body("shank").id
    # Parallel-axis theorem, about the common centre of mass on the shank's axis.
    old, place = float(model.body_mass[body]), float(-model.body_ipos[body, 2])
    centre = (old * place + mass * distance) / (old + mass)
    extra = old * (centre - place) ** 2 + mass * (distance - centre) ** 2
    model.body_mass[body] = old + mass
    model.body_ipos[body, 2] = -centre
    model.body_inertia[body, :2] += extra
    # The inertial frame left the body frame's special cases: say so, as the compiler would.
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return Severity(parameter="mass", value=mass)


def _armature(plant: Plant, rng: np.random.Generator) -> Severity:
    value = float(rng.uniform(0.05, 0.4))
    plant.model.dof_armature[0] += value
    mujoco.mj_setConst(plant.model, mujoco.MjData(plant.model))
    return Severity(parameter="armature", value=value)


def _tilt(plant: Plant, rng: np.random.Generator) -> Severity:
    angle = float(rng.choice((-1.0, 1.0)) * rng.uniform(0.05, 0.3))
    # The base turned by `angle` about +y: gravity turns by -angle in its frame.
    plant.model.opt.gravity[:] = 9.81 * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    return Severity(parameter="", value=angle)


def _asymmetric(plant: Plant, rng: np.random.Generator) -> Severity:
    level = float(rng.uniform(3.0, 12.0)) * rng.choice((-1.0, 1.0))
    sign = np.sign(level)

    def torque(time: float, position: float, velocity: float, load: float) -> float:
        del time, position, load
        # Coulomb friction in one direction of motion only.
        return -abs(level) * np.tanh(velocity / 0.01) if sign * velocity > 0 else 0.0

    plant.torques.append(torque)
    return Severity(parameter="", value=float(level))


def _load_dependent(plant: Plant, rng: np.random.Generator) -> Severity:
    coefficient = float(rng.uniform(0.06, 0.3))

    def torque(time: float, position: float, velocity: float, load: float) -> float:
        del time, position
        return -coefficient * abs(load) * np.tanh(velocity / 0.01)

    plant.torques.append(torque)
    return Severity(parameter="", value=coefficient)


def _force(plant: Plant, rng: np.random.Generator) -> Severity:
    value = float(rng.choice((-1.0, 1.0)) * rng.uniform(2.0, 15.0))
    plant.torques.append(lambda time, position, velocity, load: value)
    return Severity(parameter="", value=value)


def _encoder_offset(plant: Plant, rng: np.random.Generator) -> Severity:
    value = float(rng.choice((-1.0, 1.0)) * rng.uniform(0.015, 0.1))
    scale, _, late = plant.encoder
    plant.encoder = (scale, value, late)
    return Severity(parameter="offset", value=value)


def _encoder_scale(plant: Plant, rng: np.random.Generator) -> Severity:
    value = float(1.0 + rng.choice((-1.0, 1.0)) * rng.uniform(0.02, 0.12))
    _, offset, late = plant.encoder
    plant.encoder = (value, offset, late)
    return Severity(parameter="scale", value=value)


def _sensor_delay(plant: Plant, rng: np.random.Generator) -> Severity:
    value = float(rng.uniform(0.003, 0.02))
    scale, offset, _ = plant.encoder
    plant.encoder = (scale, offset, value)
    return Severity(parameter="delay", value=value)


def _external(plant: Plant, rng: np.random.Generator) -> Severity:
    chamber = rng.choice(("a", "b"))
    value = float(np.exp(rng.uniform(np.log(3e-13), np.log(4e-12))))
    name = f"external_leakage_{chamber}"
    plant.parameters[VALVE, name] = value
    return Severity(parameter=name, value=value)


def _droop(plant: Plant, rng: np.random.Generator) -> Severity:
    droop = float(np.exp(rng.uniform(np.log(2e10), np.log(3e11))))
    pressure = plant.tuning.get((VALVE, "supply_pressure"), NOMINAL["supply_pressure"])
    plant.model = bench(
        {
            "supply_pressure": pressure,
            "accumulator_volume": float(rng.uniform(2e-5, 8e-5)),
            "compensator_gain": 1.0 / droop,
            "pump_flow": 0.1,
        }
    )
    return Severity(parameter="droop", value=droop)


def _temperature(plant: Plant, rng: np.random.Generator) -> Severity:
    value = float(rng.choice((rng.uniform(5.0, 30.0), rng.uniform(52.0, 80.0))))
    return _put(plant, "oil_temperature", value)


FAULTS: dict[str, Fault] = {
    "internal_leakage": _scaled("internal_leakage", (3.0, 40.0)),
    "external_leakage": _external,
    "oil_viscosity": _temperature,
    "entrained_air": _scaled("entrained_air", (3.0, 12.0)),
    "supply_droop": _droop,
    "supply_pressure": _scaled("supply_pressure", (0.7, 0.93), (1.07, 1.25)),
    "valve_deadband": _shifted("lap", 0.012, 0.07, signed=False),
    "valve_bias": _shifted("null_bias", 0.012, 0.05, signed=True),
    "valve_gain": _scaled("rated_flow", (0.6, 0.88), (1.12, 1.4)),
    "valve_gain_asymmetry": _shifted("flow_asymmetry", 0.05, 0.25, signed=True),
    "valve_hysteresis": _shifted("hysteresis", 0.008, 0.06, signed=False),
    "valve_bandwidth": _scaled("bandwidth_hz", (0.05, 0.3)),
    "command_delay": _delay,
    "viscous_friction": _scaled("viscous", (1.5, 6.0)),
    "coulomb_friction": _coulomb,
    "stiction": _stiction,
    "asymmetric_friction": _asymmetric,
    "pressure_dependent_friction": _shifted("pressure_coefficient", 3e-6, 3e-5, signed=False),
    "load_dependent_friction": _load_dependent,
    "spring_stiffness": _scaled("k1", (0.3, 0.75), (1.3, 3.0)),
    "spring_hardening": _scaled("k2", (2.0, 8.0)),
    "spring_offset": _shifted("rest_position", 0.08, 0.4, signed=True),
    "quadratic_damping": _shifted("quadratic_damping", 0.8, 6.0, signed=False),
    "payload": _payload,
    "armature": _armature,
    "base_tilt": _tilt,
    "encoder_offset": _encoder_offset,
    "encoder_scale": _encoder_scale,
    "sensor_delay": _sensor_delay,
    "force_offset": _force,
}


# Faults that can set in while a recording runs.
SUDDEN = tuple(
    sorted(
        set(FAULTS)
        - {
            "supply_droop",
            "payload",
            "armature",
            "base_tilt",
            "encoder_offset",
            "encoder_scale",
            "sensor_delay",
        }
    )
)


def detuned(plant: Plant, rng: np.random.Generator) -> None:
    """Moves the nuisance parameters by their tolerance, at most two standard deviations."""

    def draw() -> float:
        return float(np.clip(rng.standard_normal(), -2.0, 2.0))

    for name, tolerance in TOLERANCES.items():
        plant.tuning[_element(name), name] = NOMINAL[name] * (1.0 + tolerance * draw())
    shift = _present(plant, "coulomb") - NOMINAL["coulomb"]
    plant.tuning[VALVE, "static"] = NOMINAL["static"] + shift
    plant.tuning[VALVE, "null_bias"] = NULL_SHIFT * draw()
