"""Table of the effects on hydraulic cylinders, their oil, valves and supply."""

from functools import partial

import mujoco

from leglab.causes.record import Trials, plus, times
from leglab.causes.table import CAUSES
from leglab.diagnosis.effects import joints
from leglab.diagnosis.effects.base import EffectParameter, Row, TableEffect, Values, register_effect
from leglab.diagnosis.plant.model import SUPPLY, Change, Machine

_VALVE = "tolerances of small servovalves (type 30 data sheets)"
_added = partial(Trials, step=plus)


def row(trials: Trials) -> Row:
    """Returns a function that builds the effect parameter of a plugin parameter, in its bounds."""

    def parameter(machine: Machine, cylinder: str) -> EffectParameter:
        nominal = machine.parameter(cylinder, trials.parameter)
        own = machine.base.elements[cylinder][1].parameters[trials.parameter]
        unit = nominal if trials.step is times else 1.0
        return EffectParameter(
            trials.parameter,
            own.unit,
            nominal=nominal,
            lower=min(max(trials.lower * unit, own.minimum), nominal),
            upper=max(min(trials.upper * unit, own.maximum), nominal),
            trials=tuple(trials.step(nominal, step) for step in trials.steps),
            tolerance=trials.tolerance * unit,
            role=trials.role,
            faults=trials.faults,
            inverse=trials.inverse,
        )

    return parameter


class CylinderEffect(TableEffect):
    """Base of effects on cylinders; rows give the plugin parameters and their trials."""

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns all cylinders."""
        return machine.cylinders

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Shifts the plugin parameters by the values' differences from nominal."""
        for name, value in values.items():
            difference = value - change.machine.parameter(element, name)
            change.add_parameter(element, name, difference)
            if name == "coulomb":  # breakaway friction is shifted too, to stay above it
                change.add_parameter(element, "static", difference)


def define(name: str, trials: tuple[Trials, ...], **attributes: str | bool) -> None:
    """Registers an effect that changes parameters of cylinders; attributes as in `Effect`."""
    own = {"name": name, "rows": tuple(map(row, trials)), **attributes}
    own |= {"__doc__": attributes["physics"], "__module__": __name__}
    kind = "Cylinder" + name.title().replace("_", "")
    register_effect(type(kind, (CylinderEffect,), own))


_oil = partial(define, group="oil and seals")
_friction = partial(define, group="friction")
_valve = partial(define, group="valve and command")

for _cause in CAUSES.values():
    for _effect in _cause.effects:
        define(**vars(_effect))


@register_effect
class OilViscosity(CylinderEffect):
    """Cold or hot oil: leakage and viscous friction move together."""

    name = "oil_viscosity"
    group = "oil and seals"
    physics = "Leakage goes with 1/mu(T), viscous friction with mu(T); mu(T) by ASTM D341."
    source = "ISO VG 46: 46 cSt at 40 C, 6.8 at 100 C (ISO 3448)"
    excitation = "fast sliding for the friction, pressure at low flow for the leakage"

    rows = tuple(map(row, CAUSES["hot_oil"].trials))

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Sets the temperature."""
        change.set_parameter(element, "oil_temperature", values["oil_temperature"])


@register_effect
class AsymmetricSealFriction(CylinderEffect):
    """Friction of the seals that differs between extending and retracting."""

    name = "asymmetric_friction"
    group = "friction"
    physics = "Seals: F_1 + b_1 v while the piston extends, F_2 + b_2 |v| while it retracts."
    source = "lip seals of one direction, a U-cup against a wiper; rod gland under pressure"
    excitation = "sliding in both directions at several speeds; reversals"
    # It contains friction of the joint's bearing, which acts like the seals' at a constant lever.
    contains = ("viscous_friction", "coulomb_friction", "asymmetric_friction")
    by_direction = (
        ("viscous_extending", "viscous_retracting"),
        ("coulomb_extending", "coulomb_retracting"),
    )

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """Returns friction by direction; trials scale with it, or stall force if it is small."""
        pressure, bore = (machine.parameter(element, n) for n in ("supply_pressure", "bore"))
        found = []
        for name, unit, share in (("viscous", "N s/m", 0.02), ("coulomb", "N", 0.01)):
            least = share * (pressure * bore**2)
            mean = machine.parameter(element, name)
            half = 0.5 * machine.parameter(element, f"{name}_difference")
            for side, own in (("extending", mean + half), ("retracting", mean - half)):
                size = max(own, least)
                found.append(
                    EffectParameter(
                        f"{name}_{side}",
                        unit,
                        nominal=own,
                        lower=min(0.3 * own, own),
                        upper=30.0 * size,
                        trials=(own + 0.7 * size, own + 1.5 * size),
                    )
                )
        return tuple(found)

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Shifts mean and difference of the plugin's friction."""
        super().apply(change, element, joints.mean_and_difference(self.by_direction, values))


define(
    "backlash",
    (_added("play", (1e-4, 6e-4), upper=1e-2),),
    group="mechanics",
    physics="Play between rod end and pin: within it the piston moves and the joint does not.",
    source="pins of mobile hydraulics: 0.1 to 0.5 mm, worn ones more",
    excitation="forces of the cylinder that change their sign, reversals",
    gradual=False,
)

_friction(
    "pressure_dependent_friction",
    (_added("pressure_coefficient", (2e-6, 1e-5, 3e-5), upper=1e-3),),
    physics="k_p (p_A + p_B): seals that are pressed on by the oil.",
    source="lip and step seals",
    excitation="sliding at different pressures",
)

_valve(
    "valve_gain",
    (Trials("rated_flow", (0.6, 0.85, 1.15, 1.5), tolerance=0.02, lower=0.2, upper=3.0),),
    physics="Another flow at the same opening, in both directions: Q_n of the orifice equation.",
    source=f"{_VALVE}: flow within 10 %",
    excitation="large openings",
)

_valve(
    "valve_null_leakage",
    (
        Trials(
            "edge_rounding", (0.5, 2.0, 4.0), tolerance=0.1, lower=0.02, upper=20.0, faults="above"
        ),
    ),
    physics="Worn metering edges: rounding eps of each, so that at its lap it is open by eps/2.",
    source=(
        "null leakage of servovalves: a few per cent of the rated flow, several times that when "
        "worn"
    ),
    excitation="small openings under load, standstill",
)


@register_effect
class ValveGainAsymmetry(CylinderEffect):
    """A valve flow that differs from the model's by another factor in each spool direction."""

    name = "valve_gain_asymmetry"
    group = "valve and command"
    physics = "Flow gain times g_1 for positive and g_2 for negative spool position."
    source = f"{_VALVE}: symmetry of flow within 10 %; one worn or clogged pair of edges"
    excitation = "large openings in both directions"
    contains = ("valve_gain",)
    rows = tuple(
        EffectParameter(name, "1", nominal=1.0, lower=0.2, upper=3.0, trials=(0.9, 1.1))
        for name in ("gain_positive", "gain_negative")
    )

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Sets rated flow K and asymmetry a, so that the gains are K (1 + a) and K (1 - a)."""
        if values["gain_positive"] == values["gain_negative"] == 1.0:
            return
        asymmetry = change.parameter(element, "flow_asymmetry")
        positive = (1.0 + asymmetry) * values["gain_positive"]
        negative = (1.0 - asymmetry) * values["gain_negative"]
        mean = 0.5 * (positive + negative)
        change.set_parameter(element, "rated_flow", mean * change.parameter(element, "rated_flow"))
        change.set_parameter(element, "flow_asymmetry", 0.5 * (positive - negative) / mean)


@register_effect
class ValveBandwidth(CylinderEffect):
    """A slow spool, described by its lag at low frequencies, whatever the damping."""

    name = "valve_bandwidth"
    group = "valve and command"
    physics = (
        "A slow spool: x_s'' = w^2 (u - x_s) - 2 zeta w x_s'. Its bandwidth is that of a valve "
        "with the model's damping zeta_0 and the same lag 2 zeta / w: w zeta_0 / zeta."
    )
    source = "servovalves of the E024 class: 250 Hz; clogged first stages fall to a tenth"
    excitation = "commands that change within some hundredths of a second"
    rows = tuple(map(row, CAUSES["slow_valve"].trials))

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Sets the natural frequency, and the damping."""
        damping = change.machine.parameter(element, "damping_ratio")
        share = values["damping_ratio"] / damping if damping > 0.0 else 1.0
        natural = share * values["bandwidth_hz"]
        super().apply(change, element, {**values, "bandwidth_hz": natural})


@register_effect
class SupplyDroop(TableEffect):
    """Supply pressure falls with the flow that the valves draw."""

    name = "supply_droop"
    group = "oil and seals"
    physics = "p_s = p_0 - droop Q_s behind an accumulator, p V^n = constant."
    source = "HyQ leg parameters (Ledezma 2016): accumulator 0.04 l, 100 bar gas, n = 1.4"
    excitation = "large flows: fast motion, large openings"
    order = 1  # after effects on the cylinders' supply pressure, which the unit takes over
    rows = (
        EffectParameter("droop", "Pa s/m^3", upper=3e12, trials=(1e10, 1e11, 5e11)),
        # Gas volume of the accumulator at its precharge pressure.
        EffectParameter.shape("accumulator_volume", "m^3", 4e-5, 1e-6, 1e-3),
    )

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Returns "supply" if the machine has cylinders and none of them names a supply unit."""
        named = any(machine.base.drawn_by.values())
        return ("supply",) if machine.cylinders and not named else ()

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Inserts a supply unit that all cylinders draw from."""
        if values["droop"] <= 0.0:
            return
        cylinders = change.machine.cylinders
        pressure = change.parameter(cylinders[0], "supply_pressure")
        name = change.machine.free_name(element)

        def insert(spec: mujoco.MjSpec) -> None:
            joints.insert(spec, SUPPLY, name, {"accumulator_volume": 4e-5})
            for cylinder in cylinders:
                plugin = spec.actuator(cylinder).plugin
                plugin.config = {**plugin.config, "supply": name}

        change.edit(("supply", name), insert)
        change.inserted[name] = SUPPLY
        change.set_parameter(name, "supply_pressure", pressure)
        change.set_parameter(name, "accumulator_volume", values["accumulator_volume"])
        change.set_parameter(name, "compensator_gain", 1.0 / values["droop"])
        change.set_parameter(name, "pump_flow", 0.1)  # the compensator limits, not the pump


# Parameters of laws in which good machines differ by about one trial: calibrated, never named.

_valve(
    "metering_edges",
    (
        _added("edge_exponent", (-0.8, 1.0), tolerance=0.8, lower=1.02, upper=12.0),
        *(
            _added(f"lap_difference_{of}", (-0.01, 0.01), tolerance=0.004, lower=-0.1, upper=0.1)
            for of in ("tank", "chambers")
        ),
    ),
    physics=(
        "How an edge shuts behind its lap, exponent n of its rounding, and how laps of the four "
        "edges differ, which sets the level of both pressures."
    ),
    source=f"docs/concepts/physics.md; {_VALVE}: edges are ground to 2 um of a stroke of 0.5 mm",
    excitation="small openings of the valve",
    nameable=False,
)

_oil(
    "oil_stiffness",
    (Trials("bulk_modulus", (0.8, 1.25), tolerance=0.1, lower=0.3, upper=3.0),),
    physics="Bulk modulus of the oil without air, lower by what hoses and walls give.",
    source="mineral oils: 1.2 to 1.7 GPa by kind, temperature and pressure; hoses take a third",
    excitation="pressures that change quickly",
    nameable=False,
)

_oil(
    "return_line",
    (_added("tank_pressure", (2e5,), tolerance=1e5, upper=2e6),),
    physics="The return line holds another pressure than the model says.",
    source="pressure drop of return lines and filters, whose bypasses open at 1.5 to 3.5 bar",
    excitation="large flows to the tank",
    nameable=False,
)

_friction(
    "friction_curve",
    (
        Trials("stribeck_velocity", (0.5, 2.0), tolerance=0.5, lower=0.1, upper=8.0),
        _added("stribeck_exponent", (-0.7, 1.0), tolerance=0.7, lower=0.3, upper=4.0),
        # At 20 times the model's stiffness, the upper bound, the bristle is rigid under any load.
        Trials("sigma_0", (0.5, 2.0), tolerance=0.5, lower=0.1, upper=20.0, inverse=True),
    ),
    physics=(
        "How friction falls from breakaway to sliding, Stribeck velocity v_s and exponent n, and "
        "how far its bristle gives way before, 1/sigma_0."
    ),
    source=(
        "docs/concepts/physics.md; exponents from 0.5 to above 2 (Armstrong-Helouvry et al. 1994); "
        "seals creep, stick or give way by tens of um"
    ),
    excitation="slow motion and reversals",
    nameable=False,
)
