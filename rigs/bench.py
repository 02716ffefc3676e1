"""The knee bench with hidden faults, run in closed loop and recorded by noisy sensors.

The faults are written apart from the effect classes of the diagnosis.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np

import leglab.models
from leglab.base.recording import Recording
from leglab.machine import plugin

SAMPLING_PERIOD = 1e-3  # s
# Neither the replay's step nor half of it, which corrects the replay.
TIMESTEP = 0.2e-3  # s
ENCODER_STEP = 2.0 * np.pi / 131072.0  # rad, docs/concepts/knee_bench.md
POSITION_NOISE = 2e-5  # rad rms
PRESSURE_NOISE = 1.5e4  # Pa rms
_LOOP_GAIN = 0.5  # valve command per rad
_FEEDFORWARD = 0.031  # valve command per rad/s: 1/(27 rad/s at full opening), 16 bar drop margin
VALVE, SPRING = "knee_valve", "knee_spring"

# Generalised force on the knee from its velocity and the actuator force on it.
Torque = Callable[[float, float], float]
# The same from its position.
Field = Callable[[float], float]


def bench(pump: Mapping[str, float] | None = None) -> mujoco.MjModel:
    """The nominal bench with the fine step; `pump` are parameters of a pump unit that feeds it."""
    plugin.load_plugin()
    spec = mujoco.MjSpec.from_file(f"{leglab.models.__path__[0]}/knee_bench.xml")
    spec.option.timestep = TIMESTEP
    spec.compiler.discardvisual = True
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
    if pump is not None:
        spec.activate_plugin("leglab.supply")
        unit = spec.add_plugin(name="pump", plugin_name="leglab.supply")
        unit.config = {key: repr(value) for key, value in pump.items()}
        valve = spec.actuator(VALVE).plugin
        valve.config = {**valve.config, "supply": "pump"}
    return spec.compile()


@dataclass(kw_only=True)
class FaultyBench:
    """The knee bench with the faults that are written here."""

    #: Compiled with the fine step; faults may change it.
    model: mujoco.MjModel = field(default_factory=bench)
    #: Plugin parameters of this good machine, by element and name.
    tuning: dict[tuple[str, str], float] = field(default_factory=dict)
    #: Plugin parameters that faults set, likewise.
    parameters: dict[tuple[str, str], float] = field(default_factory=dict)
    torques: list[Torque] = field(default_factory=list)  #: Further generalised forces on the knee
    fields: list[Field] = field(default_factory=list)  #: The same, by position
    command_delay: float = 0.0  #: s
    encoder_scale: float = 1.0  #: Gain of the position sensor
    encoder_offset: float = 0.0  #: Of the position sensor [rad]
    encoder_delay: float = 0.0  #: Of the position sensor [s]
    #: Gains of the pressure sensors of chambers A and B.
    pressure_scale: tuple[float, float] = (1.0, 1.0)
    pressure_offset: tuple[float, float] = (0.0, 0.0)  #: Of the same [Pa]
    onset: float = 0.0  #: Time at which parameters, torques and command delay set in [s]

    def record(self, reference: np.ndarray, rng: np.random.Generator) -> Recording:
        """Follows a reference, shape (n,) at the sampling period, and records it."""
        model, data = self.model, mujoco.MjData(self.model)
        places = plugin.elements(model)

        def put(values: dict[tuple[str, str], float]) -> None:
            for (element, name), value in values.items():
                start, table = places[element]
                data.plugin_state[start + table.entry(name).offset] = value

        start, table = places[VALVE]
        slots = [start + table.entry(n).offset for n in ("pressure_a", "pressure_b")]
        put(self.tuning)
        if self.onset <= 0.0:
            put(self.parameters)
        data.qpos[0] = reference[0]
        _settle(model, data)
        count = reference.size
        true, command = np.empty((count, 3)), np.empty(count)
        rate = np.gradient(reference, SAMPLING_PERIOD)
        scale, offset, late = self.encoder_scale, self.encoder_offset, self.encoder_delay
        lag = round(self.command_delay / TIMESTEP)
        queue = np.zeros(lag + 1)
        seen_late = round(late / SAMPLING_PERIOD)
        active = self.onset <= 0.0
        for k in range(count):
            true[k] = data.qpos[0], data.plugin_state[slots[0]], data.plugin_state[slots[1]]
            seen = scale * true[max(k - seen_late, 0), 0] + offset
            seen += POSITION_NOISE * rng.standard_normal()
            u = -_LOOP_GAIN * (reference[k] - seen) - _FEEDFORWARD * rate[k]
            command[k] = np.clip(u, -1.0, 1.0)
            if not active and k * SAMPLING_PERIOD >= self.onset:
                put(self.parameters)
                active = True
            for _ in range(round(SAMPLING_PERIOD / TIMESTEP)):
                queue[1:] = queue[:-1]
                queue[0] = command[k]
                data.ctrl[0] = queue[lag] if active else command[k]
                if active and (self.torques or self.fields):
                    load, v = float(data.qfrc_actuator[0]), float(data.qvel[0])
                    forces = [torque(v, load) for torque in self.torques]
                    forces += [force(float(data.qpos[0])) for force in self.fields]
                    data.qfrc_applied[0] = sum(forces)
                mujoco.mj_step(model, data)
        time = SAMPLING_PERIOD * np.arange(count)
        position = scale * np.interp(time - late, time, true[:, 0]) + offset
        position = position + POSITION_NOISE * rng.standard_normal(count)
        noise = PRESSURE_NOISE * rng.standard_normal((count, 2))
        pressure = np.array(self.pressure_scale) * true[:, 1:] + self.pressure_offset + noise
        return Recording(
            time=time,
            columns={
                "knee_position": np.round(position / ENCODER_STEP) * ENCODER_STEP,
                "knee_valve_command": command,
                "knee_pressure_a": pressure[:, 0],
                "knee_pressure_b": pressure[:, 1],
            },
        )


def _settle(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Runs a simple position loop for a second, so that recordings start from rest."""
    target = float(data.qpos[0])
    for _ in range(round(1.0 / TIMESTEP)):
        data.ctrl[0] = -_LOOP_GAIN * (target - data.qpos[0])
        mujoco.mj_step(model, data)
    data.time = 0.0


_MIDDLE = 0.9  # rad


def references(rng: np.random.Generator, duration: float = 12.0) -> dict[str, np.ndarray]:
    """Knee references [rad] at the sampling period, each (n,), by name."""
    time = SAMPLING_PERIOD * np.arange(round(duration / SAMPLING_PERIOD))
    frequencies = np.array([0.17, 0.25, 0.5, 0.92, 1.58, 2.3])
    amplitudes = np.array([0.12, 0.1, 0.13, 0.07, 0.035, 0.015])
    phases = rng.uniform(0.0, 2.0 * np.pi, frequencies.size)
    angles = 2.0 * np.pi * np.outer(frequencies, time) + phases[:, None]
    multisine = _MIDDLE + amplitudes @ np.sin(angles)
    period = rng.uniform(7.0, 10.0)
    slow = _MIDDLE + 0.38 * (2.0 / np.pi) * np.arcsin(np.sin(2.0 * np.pi * time / period))
    steps = np.full(time.size, _MIDDLE)
    now = 0.5
    while now < duration:
        steps[time >= now] = rng.uniform(0.62, 1.27)
        now += rng.uniform(0.6, 1.2)
    beat = 2.0 * np.pi * rng.uniform(0.85, 1.05) * time
    shift = rng.uniform(0.0, 2.0 * np.pi)
    walk = 0.78 + 0.36 * np.sin(beat + shift) + 0.18 * np.sin(2.0 * beat + shift + 1.0)
    found = {"multisine": multisine, "slow": slow, "steps": steps, "walk": walk}
    # Every motion begins gently from rest.
    fade = np.minimum(time / 0.5, 1.0)
    for name in ("multisine", "slow", "walk"):
        found[name] = _MIDDLE + fade * (found[name] - _MIDDLE)
    return found


# Nominal values that the faults start from, docs/concepts/knee_bench.md.
NOMINAL = {
    "internal_leakage": 1.7e-13,
    "entrained_air": 0.005,
    "supply_pressure": 16e6,
    "lap": 0.02,
    "edge_rounding": 0.0216,
    "null_bias": 0.0,
    "rated_flow": 1.25e-4,
    "flow_asymmetry": 0.0,
    "hysteresis": 0.0,
    "bandwidth_hz": 250.0,
    "viscous": 700.0,
    "coulomb": 100.0,
    "static": 150.0,
    "pressure_coefficient": 0.0,
    "oil_temperature": 40.0,
    "k1": 25.0,
    "k2": 60.0,
    "rest_position": 0.9,
    "d1": 0.6,
    "quadratic_damping": 0.0,
}
# Spread of good machines: standard deviations, of the nominal value.
TOLERANCES = {
    "internal_leakage": 0.15,
    "entrained_air": 0.2,
    "supply_pressure": 0.01,
    "rated_flow": 0.02,
    "viscous": 0.06,
    "coulomb": 0.06,
    "k1": 0.025,
    "k2": 0.05,
}
NULL_SHIFT = 0.002  # standard deviation of the valve's null, of full command


@dataclass(frozen=True, kw_only=True)
class HiddenValue:
    """The drawn size of a fault."""

    parameter: str  #: Of the effect, as the diagnosis calls it; empty where it has another form
    value: float  #: True value of the parameter


Fault = Callable[[FaultyBench, np.random.Generator], HiddenValue]
_SPRING_PARAMETERS = frozenset({"k1", "k2", "rest_position", "d1", "quadratic_damping"})


def _signed(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.choice((-1.0, 1.0)) * rng.uniform(low, high))


def _set(attribute: str, parameter: str, draw: Callable[[np.random.Generator], float]) -> Fault:
    """Sets an attribute of the bench to a drawn value."""

    def apply(plant: FaultyBench, rng: np.random.Generator) -> HiddenValue:
        value = draw(rng)
        setattr(plant, attribute, value)
        return HiddenValue(parameter=parameter, value=value)

    return apply


def _scaled(name: str, *ranges: tuple[float, float]) -> Fault:
    """Multiplies a plugin parameter by a factor, log-uniform in one of the ranges."""

    def apply(plant: FaultyBench, rng: np.random.Generator) -> HiddenValue:
        low, high = ranges[rng.integers(len(ranges))]
        factor = float(np.exp(rng.uniform(np.log(low), np.log(high))))
        return _put(plant, name, factor * _present(plant, name))

    return apply


def _shifted(name: str, low: float, high: float, *, signed: bool) -> Fault:
    """Adds to a plugin parameter, uniform in a range, of either sign where `signed`."""

    def apply(plant: FaultyBench, rng: np.random.Generator) -> HiddenValue:
        shift = _signed(rng, low, high) if signed else float(rng.uniform(low, high))
        return _put(plant, name, _present(plant, name) + shift)

    return apply


def _element(name: str) -> str:
    return SPRING if name in _SPRING_PARAMETERS else VALVE


def _present(plant: FaultyBench, name: str) -> float:
    key = _element(name), name
    return plant.parameters.get(key, plant.tuning.get(key, NOMINAL[name]))


def _put(plant: FaultyBench, name: str, value: float) -> HiddenValue:
    plant.parameters[_element(name), name] = value
    return HiddenValue(parameter=name, value=value)


def _coulomb(plant: FaultyBench, rng: np.random.Generator) -> HiddenValue:
    rise = float(rng.uniform(60.0, 300.0))
    _put(plant, "static", _present(plant, "static") + rise)
    return _put(plant, "coulomb", _present(plant, "coulomb") + rise)


def _stiction(plant: FaultyBench, rng: np.random.Generator) -> HiddenValue:
    rise = float(rng.uniform(90.0, 450.0))
    _put(plant, "static", _present(plant, "static") + rise)
    # The share of the Coulomb friction, a tolerance, counts there.
    return HiddenValue(parameter="static", value=NOMINAL["static"] + rise)


def _payload(plant: FaultyBench, rng: np.random.Generator) -> HiddenValue:
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
    return HiddenValue(parameter="mass", value=mass)


def _armature(plant: FaultyBench, rng: np.random.Generator) -> HiddenValue:
    value = float(rng.uniform(0.05, 0.4))
    plant.model.dof_armature[0] += value
    mujoco.mj_setConst(plant.model, mujoco.MjData(plant.model))
    return HiddenValue(parameter="armature", value=value)


def _tilt(plant: FaultyBench, rng: np.random.Generator) -> HiddenValue:
    angle = _signed(rng, 0.05, 0.3)
    # The base turned by `angle` about +y: gravity turns by -angle in its frame.
    plant.model.opt.gravity[:] = 9.81 * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    return HiddenValue(parameter="", value=angle)


def _asymmetric(plant: FaultyBench, rng: np.random.Generator) -> HiddenValue:
    level = float(rng.uniform(3.0, 12.0)) * rng.choice((-1.0, 1.0))
    sign = np.sign(level)

    def torque(velocity: float, load: float) -> float:
        # Coulomb friction in one direction of motion only.
        return -abs(level) * np.tanh(velocity / 0.01) if sign * velocity > 0 else 0.0

    plant.torques.append(torque)
    return HiddenValue(parameter="", value=float(level))


def _asymmetric_seal(plant: FaultyBench, rng: np.random.Generator) -> HiddenValue:
    """A seal lip grips in one direction of the piston only: more friction there."""
    side = float(rng.choice((-1.0, 1.0)))
    coulomb, viscous = float(rng.uniform(60.0, 300.0)), float(rng.uniform(0.0, 1500.0))
    _put(plant, "static", _present(plant, "static") + 0.5 * coulomb)
    gripping = _present(plant, "coulomb") + coulomb
    _put(plant, "coulomb", gripping - 0.5 * coulomb)
    _put(plant, "viscous", _present(plant, "viscous") + 0.5 * viscous)
    plant.parameters[VALVE, "coulomb_difference"] = side * coulomb
    plant.parameters[VALVE, "viscous_difference"] = side * viscous
    name = "coulomb_extending" if side > 0 else "coulomb_retracting"
    return HiddenValue(parameter=name, value=gripping)


def _either(*faults: Fault) -> Fault:
    """One of several faults that go by the same name."""
    return lambda plant, rng: faults[rng.integers(len(faults))](plant, rng)


def _both_gains(plant: FaultyBench, rng: np.random.Generator) -> HiddenValue:
    """One direction of the spool gains what the other one loses."""
    shift = _signed(rng, 0.05, 0.25)
    _put(plant, "flow_asymmetry", shift)
    flow = _present(plant, "rated_flow") / NOMINAL["rated_flow"]
    return HiddenValue(parameter="gain_positive", value=flow * (1.0 + shift))


def _one_gain(plant: FaultyBench, rng: np.random.Generator) -> HiddenValue:
    """The flow of one direction of the spool changes: gains g and 1 are f (1 + a) and f (1 - a)."""
    positive = bool(rng.integers(2))
    gain = 1.0 + _signed(rng, 0.12, 0.4)
    flow = _present(plant, "rated_flow")
    _put(plant, "rated_flow", 0.5 * (gain + 1.0) * flow)
    _put(plant, "flow_asymmetry", (1.0 if positive else -1.0) * (gain - 1.0) / (gain + 1.0))
    name = "gain_positive" if positive else "gain_negative"
    return HiddenValue(parameter=name, value=gain * flow / NOMINAL["rated_flow"])


def _pressure_sensor(kind: str, neutral: float, low: float, high: float) -> Fault:
    """Shifts zero or gain of one pressure sensor."""

    def apply(plant: FaultyBench, rng: np.random.Generator) -> HiddenValue:
        chamber, value = int(rng.integers(2)), neutral + _signed(rng, low, high)
        values = (value, neutral) if chamber == 0 else (neutral, value)
        setattr(plant, f"pressure_{kind}", values)
        return HiddenValue(parameter=f"{kind}_{'ab'[chamber]}", value=value)

    return apply


def _load_dependent(plant: FaultyBench, rng: np.random.Generator) -> HiddenValue:
    coefficient = float(rng.uniform(0.06, 0.3))
    plant.torques.append(lambda velocity, load: -coefficient * abs(load) * np.tanh(velocity / 0.01))
    return HiddenValue(parameter="", value=coefficient)


def _cogging(plant: FaultyBench, rng: np.random.Generator) -> HiddenValue:
    period = float(np.exp(rng.uniform(np.log(0.08), np.log(0.5))))
    size, phase = float(rng.uniform(2.0, 10.0)), float(rng.uniform(0.0, 2.0 * np.pi))
    plant.fields.append(lambda q: size * np.sin(2.0 * np.pi * q / period + phase))
    return HiddenValue(parameter="period", value=period)


def _force(plant: FaultyBench, rng: np.random.Generator) -> HiddenValue:
    value = _signed(rng, 2.0, 15.0)
    plant.torques.append(lambda velocity, load: value)
    return HiddenValue(parameter="", value=value)


def _external(plant: FaultyBench, rng: np.random.Generator) -> HiddenValue:
    chamber = rng.choice(("a", "b"))
    value = float(np.exp(rng.uniform(np.log(3e-13), np.log(4e-12))))
    return _put(plant, f"external_leakage_{chamber}", value)


def _droop(plant: FaultyBench, rng: np.random.Generator) -> HiddenValue:
    droop = float(np.exp(rng.uniform(np.log(2e10), np.log(3e11))))
    pressure = plant.tuning.get((VALVE, "supply_pressure"), NOMINAL["supply_pressure"])
    pump = {"supply_pressure": pressure, "accumulator_volume": float(rng.uniform(2e-5, 8e-5))}
    plant.model = bench({**pump, "compensator_gain": 1.0 / droop, "pump_flow": 0.1})
    return HiddenValue(parameter="droop", value=droop)


def _temperature(plant: FaultyBench, rng: np.random.Generator) -> HiddenValue:
    choice = rng.uniform(5.0, 30.0), rng.uniform(52.0, 80.0)
    return _put(plant, "oil_temperature", float(rng.choice(choice)))


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
    "valve_gain_asymmetry": _either(_both_gains, _one_gain),
    "valve_hysteresis": _shifted("hysteresis", 0.008, 0.06, signed=False),
    "valve_null_leakage": _scaled("edge_rounding", (2.5, 6.0)),
    "valve_bandwidth": _scaled("bandwidth_hz", (0.05, 0.3)),
    "command_delay": _set(
        "command_delay", "delay", lambda rng: TIMESTEP * round(rng.uniform(0.003, 0.02) / TIMESTEP)
    ),
    "viscous_friction": _scaled("viscous", (1.5, 6.0)),
    "coulomb_friction": _coulomb,
    "stiction": _stiction,
    "asymmetric_friction": _either(_asymmetric, _asymmetric_seal),
    "pressure_dependent_friction": _shifted("pressure_coefficient", 3e-6, 3e-5, signed=False),
    "load_dependent_friction": _load_dependent,
    "spring_stiffness": _scaled("k1", (0.3, 0.75), (1.3, 3.0)),
    "spring_hardening": _scaled("k2", (2.0, 8.0)),
    "spring_offset": _shifted("rest_position", 0.08, 0.4, signed=True),
    "quadratic_damping": _shifted("quadratic_damping", 0.8, 6.0, signed=False),
    "payload": _payload,
    "armature": _armature,
    "base_tilt": _tilt,
    "encoder_offset": _set("encoder_offset", "offset", lambda rng: _signed(rng, 0.015, 0.1)),
    "encoder_scale": _set("encoder_scale", "scale", lambda rng: 1.0 + _signed(rng, 0.02, 0.12)),
    "sensor_delay": _set("encoder_delay", "delay", lambda rng: float(rng.uniform(0.003, 0.02))),
    "pressure_sensor_offset": _pressure_sensor("offset", 0.0, 2e5, 1e6),
    "pressure_sensor_scale": _pressure_sensor("scale", 1.0, 0.03, 0.15),
    "force_offset": _force,
    "cogging": _cogging,
}

_NOT_SUDDEN = {"supply_droop", "payload", "armature", "base_tilt"}
_NOT_SUDDEN |= {"encoder_offset", "encoder_scale", "sensor_delay"}
_NOT_SUDDEN |= {"pressure_sensor_offset", "pressure_sensor_scale"}
# Faults that can set in while a recording runs.
SUDDEN = tuple(sorted(FAULTS.keys() - _NOT_SUDDEN))


def detuned(plant: FaultyBench, rng: np.random.Generator) -> None:
    """Moves the nuisance parameters by their tolerance, at most two standard deviations."""

    def draw() -> float:
        return float(np.clip(rng.standard_normal(), -2.0, 2.0))

    for name, tolerance in TOLERANCES.items():
        plant.tuning[_element(name), name] = NOMINAL[name] * (1.0 + tolerance * draw())
    shift = _present(plant, "coulomb") - NOMINAL["coulomb"]
    plant.tuning[VALVE, "static"] = NOMINAL["static"] + shift
    plant.tuning[VALVE, "null_bias"] = NULL_SHIFT * draw()
