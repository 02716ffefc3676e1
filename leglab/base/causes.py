"""One catalogue of causes: each with its names in scenarios, while driving and in a diagnosis."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Cause:
    """A cause that has several names."""

    live: str  #: Its name as a scenario, and while driving
    effect: str  #: Its name in a diagnosis
    attributes: str  #: Attributes of the MJCF elements that it changes
    size: str  #: How a size while driving becomes the values of a diagnosis


CAUSES = tuple(Cause(*row) for row in (
    ("seal_wear", "internal_leakage", "internal_leakage", "ratio to the model's [m^3/s/Pa]"),
    ("external_leak", "external_leakage", "external_leakage_a, external_leakage_b",
     "each [m^3/s/Pa]"),
    ("chamber_leak", "external_leakage", "external_leakage_a or external_leakage_b",
     "of the cap side, negative of the rod side [m^3/s/Pa]"),
    ("friction_rise", "coulomb_friction and viscous_friction", "coulomb, static, viscous",
     "ratio to the model's [N], [N s/m]"),
    ("coulomb_friction", "coulomb_friction", "coulomb, static", "ratio to the model's [N]"),
    ("stiction", "stiction", "static", "ratio to the model's [N]"),
    ("spring_fatigue", "spring_stiffness", "k1, k2", "ratio to the model's [N m/rad]"),
    ("valve_wear", "valve_deadband and valve_hysteresis", "lap, hysteresis",
     "both, of full spool travel"),
    ("valve_deadband", "valve_deadband", "lap", "ratio to the model's"),
    ("valve_hysteresis", "valve_hysteresis", "hysteresis", "of full spool travel"),
    ("valve_null_shift", "valve_bias", "null_bias", "of full command"),
    ("slow_valve", "valve_bandwidth", "bandwidth_hz", "natural frequency [Hz]"),
    ("air_in_oil", "entrained_air", "entrained_air", "volume fraction"),
    ("hot_oil", "oil_viscosity", "oil_temperature", "temperature [°C]"),
    ("cold_oil", "oil_viscosity", "oil_temperature", "temperature [°C]"),
    ("viscosity_change", "oil_viscosity", "viscosity_40",
     "[cSt at 40 °C]; a diagnosis has a temperature"),
    ("supply_drop", "supply_pressure", "supply_pressure", "[bar]; a diagnosis has Pa"),
    ("supply_droop", "supply_droop", "pump_flow, accumulator_volume",
     "share of the pump's flow; a diagnosis has Pa s/m^3"),
    ("payload", "payload", "mass of a body", "added mass [kg]"),
    ("encoder_shift", "encoder_offset", "a sensor's offset", "[rad]"),
))  # fmt: skip
_EFFECTS = {cause.live: cause.effect for cause in CAUSES}


def effect_of(live: str) -> str:
    """The name in a diagnosis of what is called so while driving; empty where it is the same."""
    effect = _EFFECTS.get(live, "")
    return "" if effect == live else effect


def live_of(effect: str) -> tuple[str, ...]:
    """The names while driving of what a diagnosis calls so; none where it is the same."""
    own = tuple(cause.live for cause in CAUSES if cause.effect == effect)
    return () if effect in own else own
