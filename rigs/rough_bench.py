"""Knee benches that differ from their model everywhere a little, with hidden faults.

The simulator is `rigs/csrc/rough_bench.h`: equations of its own, integrated by RK4. A specimen
draws its parameters, the laws of friction, orifice, edges, oil, valve and spring, and its sensors.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from leglab.base.errors import SettingsError
from leglab.base.recording import Recording
from rigs._native import rough_bench as native
from rigs.bench import NULL_SHIFT, TOLERANCES, HiddenValue, references

SAMPLING_PERIOD = 1e-3  # s
STEPS = 40  # of the integrator in a sampling period
# Contact at the play of a rod of 1.5 kg asks for shorter steps.
_STEPS_WITH_PLAY = 100
NOMINAL: Mapping[str, float] = native.nominal()
SIZES = ("gross", "visible")


@dataclass(frozen=True, kw_only=True)
class RoughBench:
    """One specimen."""

    #: Parameters of the simulator that are not nominal, by name; SI units.
    values: Mapping[str, float] = field(default_factory=dict)
    position_noise: float = 2e-5  #: rad rms
    pressure_noise: float = 1.5e4  #: Pa rms

    def __getitem__(self, name: str) -> float:
        return self.values.get(name, NOMINAL[name])

    def changed(self, **values: float) -> "RoughBench":
        """The bench with other parameters."""
        return replace(self, values={**self.values, **values})

    def follow(self, reference: np.ndarray, rng: np.random.Generator) -> Recording:
        """Follows a reference, shape (n,) at the sampling period, and records it."""
        count = reference.size
        q, u, a, b = native.follow(
            dict(self.values),
            np.ascontiguousarray(reference, dtype=float),
            self.position_noise * rng.standard_normal(count),
            self.pressure_noise * rng.standard_normal(count),
            self.pressure_noise * rng.standard_normal(count),
            SAMPLING_PERIOD,
            _STEPS_WITH_PLAY if self["play"] > 0.0 else STEPS,
        )
        return Recording(
            time=SAMPLING_PERIOD * np.arange(count),
            columns={
                "knee_position": q,
                "knee_valve_command": u,
                "knee_pressure_a": a,
                "knee_pressure_b": b,
            },
        )


# Standard deviations of factors, log-normal, cut at two of them.
_FACTORS = {
    "internal_leakage": 0.25,
    "entrained_air": 0.25,
    "bulk_modulus": 0.04,
    "rated_flow": 0.03,
    "viscous": 0.12,
    "coulomb": 0.12,
    "static_friction": 0.12,
    "sigma_0": 0.25,
    "sigma_1": 0.25,
    "stribeck_velocity": 0.35,
    "k1": 0.04,
    "k2": 0.10,
    "d1": 0.20,
    "mass": 0.015,
    "centre": 0.01,
    "inertia": 0.025,
    "thigh_x": 0.005,
    "thigh_z": 0.003,
    "shank_x": 0.005,
    "shank_z": 0.02,
    "dead_volume_a": 0.06,
    "dead_volume_b": 0.06,
    "supply_pressure": 0.012,
    "bandwidth_hz": 0.08,
    "damping_ratio": 0.08,
    "edge_rounding": 0.12,
    "transition_pressure": 0.4,
}
# Standard deviations of shifts, normal, cut at two of them.
_SHIFTS = {
    "tilt": 0.004,
    "rest_position": 0.008,
    "null_bias": 0.0012,
    "encoder_offset": 0.002,
    "force_offset": 0.15,
    "hose_stiffness": 0.3,
    "leakage_growth": 3e-9,
    "friction_asymmetry": 0.03,
    "viscous_asymmetry": 0.03,
    "port_curvature": 0.05,
    "pressure_offset_a": 3e4,
    "pressure_offset_b": 3e4,
}


def specimen(seed: int) -> RoughBench:
    """Draws a healthy specimen; the same seed gives the same one."""
    rng = np.random.default_rng([seed, 20])

    def normal() -> float:
        return float(np.clip(rng.standard_normal(), -2.0, 2.0))

    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    values = {name: NOMINAL[name] * float(np.exp(s * normal())) for name, s in _FACTORS.items()}
    values |= {name: NOMINAL[name] + s * normal() for name, s in _SHIFTS.items()}
    values["mid_length"] = NOMINAL["mid_length"] + 3e-4 * normal()
    values["edge_law"] = int(rng.integers(3))
    lap = NOMINAL["lap_pa"] * float(np.exp(0.1 * normal()))
    if values["edge_law"] == 1:
        lap *= 0.75  # a sharp edge of this lap passes about as much as a rounded one
    for edge in ("lap_pa", "lap_at", "lap_pb", "lap_bt"):
        values[edge] = lap + 0.0005 * normal()

    law = int(rng.integers(4))
    values |= {"friction_law": law, "viscous_exponent": between(0.9, 1.1)}
    values["stribeck_exponent"] = between(0.5, 2.0)
    values["static_friction"] = max(values["static_friction"], 1.05 * values["coulomb"])
    values["tanh_speed"] = between(0.001, 0.003)
    if law == 2:  # Dahl's friction has no peak
        values["static_friction"] = values["coulomb"]
    values["valve_law"] = int(rng.integers(2))
    if values["valve_law"] == 1:
        values["bandwidth_hz"] *= 0.75  # of the same lag at low frequencies
    values["slew"] = 1.0 / between(0.004, 0.012)
    if values["edge_law"] == 1:
        values["edge_clearance"] = between(0.004, 0.007)
    values["orifice_law"] = int(rng.integers(3))
    values["flow_exponent"] = between(0.47, 0.53)
    values["oil_law"] = int(rng.integers(4))
    values["oil_start"] = between(0.55, 0.8)
    values["oil_reach"] = between(8e6, 2e7) if values["oil_law"] == 2 else between(2e6, 5e6)
    values["spring_law"] = int(rng.integers(2))
    values["joint_speed"] = between(0.005, 0.02)
    values |= {"droop": between(3e8, 2e9), "gas_volume": between(2e-5, 8e-5)}
    values |= {"ripple": between(0.0, 3e4), "ripple_hz": between(25.0, 80.0)}
    values["tank_pressure"] = between(0.0, 2e5)
    values["cogging"] = between(0.03, 0.25)
    values["cogging_period"] = between(0.15, 0.8)
    values["cogging_phase"] = between(0.0, 2.0 * np.pi)
    values["command_delay"] = between(0.3e-3, 1.5e-3)
    values["hysteresis"] = between(0.001, 0.004)
    values["encoder_counts"] = 65536
    return RoughBench(
        values={name: float(value) for name, value in values.items()},
        position_noise=float(np.exp(between(np.log(3e-5), np.log(1.2e-4)))),
        pressure_noise=between(4e4, 8e4),
    )


def exact_specimen(seed: int) -> RoughBench:
    """Draws a specimen of the model's own laws, off by the tolerances of good machines alone."""
    rng = np.random.default_rng([seed, 30])
    values = {}
    for name, tolerance in TOLERANCES.items():
        shift = float(np.clip(rng.standard_normal(), -2.0, 2.0))
        values[name] = NOMINAL[name] * (1.0 + tolerance * shift)
    values["static_friction"] = NOMINAL["static_friction"] + values["coulomb"] - NOMINAL["coulomb"]
    values["null_bias"] = NULL_SHIFT * float(np.clip(rng.standard_normal(), -2.0, 2.0))
    return RoughBench(values=values)


Changed = tuple[RoughBench, HiddenValue]
Change = Callable[[RoughBench, float, np.random.Generator], Changed]


@dataclass(frozen=True)
class RoughFault:
    """A fault of the bench, of a size that is drawn log-uniform."""

    visible: float  #: Size that is just visible on a rough specimen
    low: float  #: From here on gross
    high: float  #: Largest; smaller than the others where a smaller value is worse
    change: Change  #: The bench with it, and its true value as the diagnosis would call it
    signed: bool = False  #: Whether either sign is drawn
    effect: str = ""  #: What the diagnosis calls it, where that is not the fault's own name

    def draw(self, rng: np.random.Generator, sizes: str) -> float:
        """A size; `sizes` is "gross", or "visible" for everything from just visible on."""
        low, high = sorted((self.visible if sizes == "visible" else self.low, self.high))
        value = float(np.exp(rng.uniform(np.log(low), np.log(high))))
        return value * float(rng.choice((-1.0, 1.0))) if self.signed else value


def _scaled(name: str, *, by_sign: bool = False) -> Change:
    """Multiplies a parameter by the size; with `by_sign` by 1 + size."""

    def change(bench: RoughBench, size: float, rng: np.random.Generator) -> Changed:
        value = bench[name] * (1.0 + size if by_sign else size)
        return bench.changed(**{name: value}), HiddenValue(parameter=name, value=value)

    return change


def _shifted(parameter: str, *names: str) -> Change:
    """Adds the size to parameters of the simulator; the first one's value is told.

    Args:
        parameter: What the diagnosis calls it.
        names: What the simulator calls them, where that is another name.
    """
    names = names or (parameter,)

    def change(bench: RoughBench, size: float, rng: np.random.Generator) -> Changed:
        values = {name: bench[name] + size for name in names}
        return bench.changed(**values), HiddenValue(parameter=parameter, value=values[names[0]])

    return change


def _external(bench: RoughBench, size: float, rng: np.random.Generator) -> Changed:
    name = f"external_leakage_{rng.choice(('a', 'b'))}"
    return bench.changed(**{name: size}), HiddenValue(parameter=name, value=size)


def _viscosity(temperature: float) -> float:
    """Of VG 46 over that at 40 C, by Vogel's law (docs/concepts/physics.md)."""
    # ln nu = a + b / (T + c) through (0, 577), (40, 46), (100, 6.8): c from the two slopes.
    first, second = np.log(577.0 / 46.0), np.log(46.0 / 6.8)
    ratio = first / second * 60.0 / 40.0  # (100 + c) / c
    c = 100.0 / (ratio - 1.0)
    b = first * c * (40.0 + c) / 40.0
    return float(np.exp(b / (temperature + c) - b / (40.0 + c)))


def _temperature(bench: RoughBench, size: float, rng: np.random.Generator) -> Changed:
    temperature = 40.0 + size
    factor = _viscosity(temperature)
    changed = bench.changed(
        viscous=bench["viscous"] * factor, internal_leakage=bench["internal_leakage"] / factor
    )
    return changed, HiddenValue(parameter="oil_temperature", value=temperature)


def _air(bench: RoughBench, size: float, rng: np.random.Generator) -> Changed:
    added = (size - 1.0) * NOMINAL["entrained_air"]
    value = size * NOMINAL["entrained_air"]
    return bench.changed(added_air=added), HiddenValue(parameter="entrained_air", value=value)


def _droop(bench: RoughBench, size: float, rng: np.random.Generator) -> Changed:
    volume = float(rng.uniform(2e-5, 8e-5))
    hidden = HiddenValue(parameter="droop", value=size)
    return bench.changed(droop=bench["droop"] + size, gas_volume=volume), hidden


def _gains(bench: RoughBench, size: float, rng: np.random.Generator) -> Changed:
    changed = bench.changed(gain_positive=1.0 + size, gain_negative=1.0 - size)
    return changed, HiddenValue(parameter="flow_asymmetry", value=size)


def _asymmetric(bench: RoughBench, size: float, rng: np.random.Generator) -> Changed:
    name = "joint_forward" if size > 0.0 else "joint_backward"
    return bench.changed(**{name: abs(size)}), HiddenValue(parameter="", value=size)


def _asymmetric_seal(bench: RoughBench, size: float, rng: np.random.Generator) -> Changed:
    side = "extending" if size > 0.0 else "retracting"
    viscous = float(rng.uniform(0.0, 5.0)) * abs(size)
    changed = bench.changed(**{f"coulomb_{side}": abs(size), f"viscous_{side}": viscous})
    value = bench["coulomb"] + abs(size)
    return changed, HiddenValue(parameter=f"coulomb_{side}", value=value)


def _rounded(bench: RoughBench, size: float, rng: np.random.Generator) -> Changed:
    value = size * bench["edge_rounding"]
    changed = {"edge_rounding": value}
    if bench["edge_law"] == 1.0:  # a sharp edge has its clearance instead
        changed = {"edge_clearance": size * bench["edge_clearance"]}
    return bench.changed(**changed), HiddenValue(parameter="edge_rounding", value=value)


def _one_gain(bench: RoughBench, size: float, rng: np.random.Generator) -> Changed:
    name = f"gain_{rng.choice(('positive', 'negative'))}"
    return bench.changed(**{name: 1.0 + size}), HiddenValue(parameter=name, value=1.0 + size)


def _sensor_of_a_chamber(kind: str, neutral: float) -> Change:
    """Shifts zero or gain of one pressure sensor."""

    def change(bench: RoughBench, size: float, rng: np.random.Generator) -> Changed:
        side = rng.choice(("a", "b"))
        name = f"pressure_{kind}_{side}"
        hidden = HiddenValue(parameter=f"{kind}_{side}", value=neutral + size)
        return bench.changed(**{name: bench[name] + size}), hidden

    return change


def _loss(bench: RoughBench, size: float, rng: np.random.Generator) -> Changed:
    braking = size * float(rng.uniform(0.5, 1.5))
    changed = bench.changed(load_loss_driving=size, load_loss_braking=braking)
    return changed, HiddenValue(parameter="", value=size)


def _ripple(bench: RoughBench, size: float, rng: np.random.Generator) -> Changed:
    period = float(np.exp(rng.uniform(np.log(0.12), np.log(0.7))))
    changed = bench.changed(
        wave=size,
        wave_second=float(rng.uniform(0.0, 0.4)),
        wave_period=period,
        wave_phase=float(rng.uniform(0.0, 2.0 * np.pi)),
    )
    return changed, HiddenValue(parameter="period", value=period)


def _payload(bench: RoughBench, size: float, rng: np.random.Generator) -> Changed:
    distance = float(rng.uniform(0.25, 0.5))
    moment = bench["mass"] * bench["centre"] + size * distance
    mass = bench["mass"] + size
    changed = bench.changed(
        mass=mass, centre=moment / mass, inertia=bench["inertia"] + size * distance**2
    )
    return changed, HiddenValue(parameter="mass", value=size)


_LAPS = ("lap_pa", "lap_at", "lap_pb", "lap_bt")
FAULTS: dict[str, RoughFault] = {
    "internal_leakage": RoughFault(1.6, 3.0, 40.0, _scaled("internal_leakage")),
    "external_leakage": RoughFault(1.2e-13, 3e-13, 4e-12, _external),
    "oil_viscosity": RoughFault(5.0, 12.0, 35.0, _temperature, signed=True),
    "entrained_air": RoughFault(2.0, 3.0, 12.0, _air),
    "supply_droop": RoughFault(8e9, 2e10, 3e11, _droop),
    "supply_pressure": RoughFault(
        0.03, 0.07, 0.28, _scaled("supply_pressure", by_sign=True), signed=True
    ),
    "valve_deadband": RoughFault(0.005, 0.012, 0.07, _shifted("lap", *_LAPS)),
    "valve_bias": RoughFault(0.006, 0.012, 0.05, _shifted("null_bias"), signed=True),
    "valve_gain": RoughFault(0.06, 0.12, 0.4, _scaled("rated_flow", by_sign=True), signed=True),
    "valve_gain_asymmetry": RoughFault(0.03, 0.06, 0.25, _gains, signed=True),
    "valve_hysteresis": RoughFault(0.004, 0.01, 0.06, _shifted("hysteresis")),
    "valve_null_leakage": RoughFault(1.5, 2.5, 6.0, _rounded),
    "valve_bandwidth": RoughFault(0.5, 0.3, 0.05, _scaled("bandwidth_hz")),
    "command_delay": RoughFault(1.5e-3, 3e-3, 2e-2, _shifted("delay", "command_delay")),
    "viscous_friction": RoughFault(1.3, 1.6, 6.0, _scaled("viscous")),
    "coulomb_friction": RoughFault(
        30.0, 60.0, 300.0, _shifted("coulomb", "coulomb", "static_friction")
    ),
    "stiction": RoughFault(45.0, 90.0, 450.0, _shifted("static", "static_friction")),
    "asymmetric_friction": RoughFault(1.2, 3.0, 12.0, _asymmetric, signed=True),
    "pressure_dependent_friction": RoughFault(1.5e-6, 3e-6, 3e-5, _shifted("pressure_coefficient")),
    "load_dependent_friction": RoughFault(0.03, 0.06, 0.3, _shifted("", "load_friction")),
    "spring_stiffness": RoughFault(0.13, 0.3, 0.75, _scaled("k1", by_sign=True), signed=True),
    "spring_hardening": RoughFault(1.8, 3.0, 8.0, _scaled("k2")),
    "spring_offset": RoughFault(0.035, 0.08, 0.4, _shifted("rest_position"), signed=True),
    "quadratic_damping": RoughFault(0.35, 0.8, 6.0, _shifted("quadratic_damping")),
    "payload": RoughFault(0.2, 0.5, 3.0, _payload),
    "armature": RoughFault(0.03, 0.08, 0.4, _shifted("", "inertia")),
    "base_tilt": RoughFault(0.025, 0.06, 0.3, _shifted("", "tilt"), signed=True),
    "encoder_offset": RoughFault(
        0.007, 0.015, 0.1, _shifted("offset", "encoder_offset"), signed=True
    ),
    "encoder_scale": RoughFault(0.01, 0.02, 0.12, _shifted("scale", "encoder_scale"), signed=True),
    "sensor_delay": RoughFault(1.5e-3, 3e-3, 2e-2, _shifted("delay", "encoder_delay")),
    "force_offset": RoughFault(0.9, 2.0, 15.0, _shifted("", "force_offset"), signed=True),
    "asymmetric_seal_friction": RoughFault(
        30.0, 60.0, 300.0, _asymmetric_seal, signed=True, effect="asymmetric_friction"
    ),
    "one_sided_valve_gain": RoughFault(
        0.06, 0.12, 0.4, _one_gain, signed=True, effect="valve_gain_asymmetry"
    ),
    "pressure_sensor_offset": RoughFault(
        1e5, 2e5, 1e6, _sensor_of_a_chamber("offset", 0.0), signed=True
    ),
    "pressure_sensor_scale": RoughFault(
        0.012, 0.03, 0.15, _sensor_of_a_chamber("scale", 1.0), signed=True
    ),
    # Load-dependent friction whose share differs where the load drives and where it brakes.
    "torque_loss": RoughFault(0.03, 0.06, 0.3, _loss, effect="load_dependent_friction"),
    "cylinder_play": RoughFault(5e-5, 1.5e-4, 1e-3, _shifted("", "play"), effect="backlash"),
    # A torque that repeats with the position, of a drawn period.
    "position_torque": RoughFault(0.8, 2.0, 8.0, _ripple, effect="cogging"),
}


def effect_of(fault: str) -> str:
    """Effect by which a diagnosis names a fault."""
    return FAULTS[fault].effect or fault


def with_fault(
    bench: RoughBench, name: str, rng: np.random.Generator, *, sizes: str = "gross"
) -> tuple[RoughBench, HiddenValue]:
    """The bench with a fault of drawn size.

    Args:
        bench: Stays as it is.
        name: Of the fault.
        rng: Of its size.
        sizes: "gross", or "visible" for everything from just visible to gross.

    Raises:
        LeglabError: The fault or the word for sizes does not exist.
    """
    if name not in FAULTS:
        raise SettingsError.unknown("fault of the rough bench", name, FAULTS)
    if sizes not in SIZES:
        raise SettingsError.unknown("range of sizes", sizes, SIZES)
    fault = FAULTS[name]
    return fault.change(bench, fault.draw(rng, sizes), rng)


def record(
    bench: RoughBench,
    faults: str | Iterable[str] | None,
    motions: Mapping[str, np.ndarray],
    rng: np.random.Generator,
) -> dict[str, Recording]:
    """Recordings of a specimen with gross faults of drawn sizes.

    Args:
        bench: Healthy.
        faults: Name, names, or None for nothing.
        motions: References [rad] at the sampling period by name.
        rng: Of sizes and noise.

    Raises:
        LeglabError: As `with_fault`.
    """
    names = (faults,) if isinstance(faults, str) else tuple(faults or ())
    for name in names:
        bench, _ = with_fault(bench, name, rng)
    return {name: bench.follow(reference, rng) for name, reference in motions.items()}


@dataclass(frozen=True, kw_only=True)
class RoughCase:
    """Recordings of one specimen before and with its faults."""

    recordings: dict[str, Recording]  #: With the faults
    healthy: dict[str, Recording]  #: Before; of other references
    severities: tuple[HiddenValue, ...]  #: True sizes of the faults


def rough_case(
    seed: int,
    faults: Iterable[str] = (),
    *,
    sizes: str = "gross",
    duration: float = 12.0,
    healthy: bool = True,
    exact: bool = False,
) -> RoughCase:
    """Draws a specimen and records it; everything follows from the seed.

    Args:
        seed: Of specimen, sizes, references and noise.
        faults: Names.
        sizes: As in `with_fault`.
        exact: Takes an exact specimen instead of a rough one.
        duration: Of each recording [s].
        healthy: Whether to record the healthy specimen too; the faulty ones are the same.

    Raises:
        LeglabError: As `with_fault`.
    """
    bench = exact_specimen(seed) if exact else specimen(seed)
    rng = np.random.default_rng([seed, 21])
    faulty, severities = bench, []
    for name in faults:
        faulty, hidden = with_fault(faulty, name, rng, sizes=sizes)
        severities.append(hidden)
    rng = np.random.default_rng([seed, 22])
    recordings = record(faulty, None, references(rng, duration), rng)
    before: dict[str, Recording] = {}
    if healthy:
        rng = np.random.default_rng([seed, 23])
        before = record(bench, None, references(rng, duration), rng)
    return RoughCase(recordings=recordings, healthy=before, severities=tuple(severities))
