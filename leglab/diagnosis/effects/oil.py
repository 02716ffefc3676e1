"""Oil, seals and supply pressure of a cylinder."""

from collections.abc import Mapping

from leglab.diagnosis.change import Change
from leglab.diagnosis.effects.base import Effect, EffectParameter, register
from leglab.diagnosis.effects.cylinder_parameter import HYQ, Row, define
from leglab.diagnosis.machine import CYLINDER, Machine

define(
    "internal_leakage",
    "oil and seals",
    "Flow past the piston seal, C_i (p_A - p_B); grows with the cube of the clearance.",
    f"{HYQ}; seal wear up to x50",
    "a pressure difference across the piston while the valve opens little",
    Row(name="internal_leakage", trials=(3.0, 10.0, 35.0), tolerance=0.15, lower=0.0, upper=300.0),
)

define(
    "external_leakage",
    "oil and seals",
    "Flow from the chambers to the outside, C_e p: rod seal, fittings, hoses.",
    "ASME FPMC 2014: detectable at 0.07 to 0.25 l/min",
    "chamber pressures well above the tank's",
    Row(
        name="external_leakage_a",
        trials=(2e-13, 1.5e-12),
        lower=0.0,
        upper=3e-11,
        relative=False,
    ),
    Row(
        name="external_leakage_b",
        trials=(2e-13, 1.5e-12),
        lower=0.0,
        upper=3e-11,
        relative=False,
    ),
)

define(
    "entrained_air",
    "oil and seals",
    "Air in the oil makes it soft at low pressure: beta = (g + l)/(g/(n p) + l/beta_l).",
    "docs/physics.md; 0.5 % is normal, foaming oil holds several per cent",
    "pressures that change quickly",
    Row(name="entrained_air", trials=(0.3, 3.0, 10.0), tolerance=0.2, lower=0.0, upper=40.0),
)

define(
    "supply_pressure",
    "oil and seals",
    "The supply holds another pressure than the model says.",
    "HyQ class machines run at 160 bar; relief valves drift by some per cent",
    "valve openings in both directions",
    Row(name="supply_pressure", trials=(0.8, 0.94, 1.1), tolerance=0.01, lower=0.2, upper=1.6),
)


@register
class OilViscosity(Effect):
    """Cold or hot oil: leakage and viscous friction move together."""

    name = "oil_viscosity"
    group = "oil and seals"
    physics = "Leakage goes with 1/mu(T), viscous friction with mu(T); mu(T) by ASTM D341."
    source = "ISO VG 46: 46 cSt at 40 C, 6.8 at 100 C (ISO 3448)"
    excitation = "fast sliding for the friction, pressure at low flow for the leakage"

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """All cylinders."""
        return machine.instances(CYLINDER)

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """The temperature of the oil."""
        nominal = machine.parameter(element, "oil_temperature")
        return (
            EffectParameter(
                name="oil_temperature",
                unit="degC",
                nominal=nominal,
                lower=min(-20.0, nominal),
                upper=max(110.0, nominal),
                trials=(nominal - 36.0, nominal - 22.0, nominal - 8.0, nominal + 25.0),
            ),
        )

    def apply(self, change: Change, element: str, values: Mapping[str, float]) -> None:
        """Sets the temperature."""
        change.set_parameter(element, "oil_temperature", values["oil_temperature"])
