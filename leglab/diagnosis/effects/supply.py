"""Supply whose pressure falls with the flow drawn from it."""

import mujoco

from leglab.diagnosis.effects import joints
from leglab.diagnosis.effects.base import EffectParameter, TableEffect, Values, register_effect
from leglab.diagnosis.plant.model import CYLINDER, SUPPLY, Change, Machine


@register_effect
class SupplyDroop(TableEffect):
    """Supply pressure falls with the flow that the valves draw."""

    name = "supply_droop"
    group = "oil and seals"
    physics = "p_s = p_0 - droop Q_s behind an accumulator, p V^n = constant."
    source = "HyQ leg parameters (Ledezma 2016): accumulator 0.04 l, 100 bar gas, n = 1.4"
    excitation = "large flows: fast motion, large openings"
    order = 1  # takes over the supply pressure of the cylinders
    rows = (
        EffectParameter("droop", "Pa s/m^3", upper=3e12, trials=(1e10, 1e11, 5e11)),
        # Gas of the accumulator at its precharge.
        EffectParameter(
            "accumulator_volume", "m^3", nominal=4e-5, lower=1e-6, upper=1e-3, role="shape"
        ),
    )

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """One for the machine, where no cylinder names a supply of its own."""
        named = any(machine.base.drawn_by.values())
        return ("supply",) if machine.instances(CYLINDER) and not named else ()

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Inserts a supply unit that all cylinders draw from."""
        if values["droop"] <= 0.0:
            return
        cylinders = change.machine.instances(CYLINDER)
        pressure = change.parameter(cylinders[0], "supply_pressure")

        def insert(spec: mujoco.MjSpec) -> None:
            joints.insert(spec, SUPPLY, element, {"accumulator_volume": 4e-5})
            for cylinder in cylinders:
                plugin = spec.actuator(cylinder).plugin
                plugin.config = {**plugin.config, "supply": element}

        change.edit(("supply", element), insert)
        change.set_parameter(element, "supply_pressure", pressure)
        change.set_parameter(element, "accumulator_volume", values["accumulator_volume"])
        change.set_parameter(element, "compensator_gain", 1.0 / values["droop"])
        change.set_parameter(element, "pump_flow", 0.1)  # the compensator limits, not the pump
