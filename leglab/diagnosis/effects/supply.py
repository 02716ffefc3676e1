"""Supply whose pressure falls with the flow drawn from it."""

import mujoco
import numpy as np
from scipy.signal import lfilter

from leglab.diagnosis.effects import joints
from leglab.diagnosis.effects.base import Effect, EffectParameter, Values, register_effect
from leglab.diagnosis.model import CYLINDER, Change, Machine, Measured, Variant
from leglab.machine.parameters import plugin_tables

SUPPLY = "leglab.supply"
_ATMOSPHERE = 101325.0  # Pa


@register_effect
class SupplyDroop(Effect):
    """Supply pressure falls with the flow that the valves draw."""

    name = "supply_droop"
    group = "oil and seals"
    physics = "p_s = p_0 - droop Q_s behind an accumulator, p V^n = constant."
    source = "HyQ leg parameters (Ledezma 2016): accumulator 0.04 l, 100 bar gas, n = 1.4"
    excitation = "large flows: fast motion, large openings"
    order = 1  # takes over the supply pressure of the cylinders

    def elements(self, machine: Machine) -> tuple[str, ...]:
        """One for the machine, where no cylinder names a supply of its own."""
        cylinders = machine.instances(CYLINDER)
        spec = machine.spec()
        named = any(spec.actuator(c).plugin.config.get("supply") for c in cylinders)
        return () if named or not cylinders else ("supply",)

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """Droop, and gas volume of the accumulator at its precharge."""
        droop = EffectParameter("droop", "Pa s/m^3", upper=3e12, trials=(1e10, 1e11, 5e11))
        volume = EffectParameter(
            "accumulator_volume", "m^3", nominal=4e-5, lower=1e-6, upper=1e-3, role="shape"
        )
        return droop, volume

    def apply(self, change: Change, element: str, values: Values) -> None:
        """Inserts a supply unit that all cylinders draw from."""
        droop, volume = values["droop"], values["accumulator_volume"]
        if droop <= 0.0:
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
        change.set_parameter(element, "accumulator_volume", volume)
        change.set_parameter(element, "compensator_gain", 1.0 / droop)
        change.set_parameter(element, "pump_flow", 0.1)  # the compensator limits, not the pump

        def start(measured: Measured, variant: Variant, state: np.ndarray) -> np.ndarray:
            fall = _fall(change.machine, measured, pressure, droop, volume)
            return np.full(len(state), pressure) - fall

        change.start(element, "pressure", start)
        change.start(element, "started", lambda measured, variant, state: np.ones(len(state)))


def _fall(
    machine: Machine, measured: Measured, pressure: float, droop: float, volume: float
) -> np.ndarray:
    """Fall of the supply pressure at window starts [Pa], (windows,), from measured openings.

    Linear about the set pressure: a first-order lag of the demand with the accumulator's
    capacity V_gas/(n p).
    """
    demand = np.zeros(next(iter(measured.command.values())).size)
    for cylinder in machine.instances(CYLINDER):
        joint = machine.driven[cylinder][0]
        gain = machine.parameter(cylinder, "rated_flow") / np.sqrt(
            0.5 * machine.parameter(cylinder, "rated_pressure_drop")
        )
        lap = machine.parameter(cylinder, "lap")
        rounding = machine.parameter(cylinder, "edge_rounding")
        for chamber, sign in (("a", 1.0), ("b", -1.0)):
            edge = sign * measured.command[cylinder] - lap
            opening = 0.5 * (edge + np.sqrt(edge**2 + rounding**2))
            load = measured.pressure.get(f"{joint}_pressure_{chamber}", 0.5 * pressure)
            demand += gain * opening * np.sqrt(np.maximum(pressure - load, 0.0))
    precharge = plugin_tables()[SUPPLY].parameters["accumulator_precharge"].nominal
    gas = volume * ((precharge + _ATMOSPHERE) / (pressure + _ATMOSPHERE)) ** (1.0 / 1.4)
    lag = droop * gas / (1.4 * (pressure + _ATMOSPHERE))
    decay = np.exp(-measured.period / lag)
    slow = lfilter([1.0 - decay], [1.0, -decay], demand)
    return np.minimum(droop * slow[measured.samples], 0.9 * pressure)
