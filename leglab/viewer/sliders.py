"""Sliders: parameters that a user changes by hand in the viewer."""

from collections.abc import Callable
from dataclasses import dataclass

from leglab.base.scenario import ParameterChange
from leglab.machine.changes import ADDED_MASS, Bodies
from leglab.machine.simulation import Simulation

# Where there is a body of this name it carries the load, as in the scenario "payload".
_LOADED = "shank"


@dataclass(frozen=True)
class Slider:
    """A slider of the control panel.

    Attributes:
        name: How it is called.
        label: Name of its actuator in the viewer's model, which the panel cuts at 14 letters.
        unit: Unit of its value.
        lowest: Smallest value.
        highest: Largest value.
        initial: Value of the unchanged machine.
        change: Makes the change that a value stands for, from a time [s] on.
        present: Reads from the machine what the slider and the scenario make together.
    """

    name: str
    label: str
    unit: str
    lowest: float
    highest: float
    initial: float
    change: Callable[[float, float], ParameterChange]
    present: Callable[[], float]


def sliders(simulation: Simulation, bodies: Bodies) -> tuple[Slider, ...]:
    """The sliders of a machine: of cylinders seal_wear and oil_temperature, of all payload."""
    loaded = _LOADED if _LOADED in bodies.elements else bodies.elements[-1]
    masses, body = simulation.model.body_mass, simulation.model.body(loaded).id
    unloaded = float(masses[body])

    def load() -> float:
        return float(masses[body]) - unloaded

    mass = _change(ADDED_MASS.name, loaded, "set")
    payload = Slider("payload", "payload kg", f"kg on {loaded}", 0.0, 30.0, 0.0, mass, load)
    return (*_oil(simulation), payload) if simulation.cylinders else (payload,)


def _oil(simulation: Simulation) -> tuple[Slider, Slider]:
    """Wear of the piston seals and temperature of the oil."""
    warm = simulation.parameter(simulation.cylinders[0], "oil_temperature")
    leakage, oil = simulation.slots("internal_leakage"), simulation.slots("oil_temperature")
    state = simulation.data.plugin_state
    healthy = state[leakage].copy()

    def wear() -> float:
        return float((state[leakage] / healthy).max())

    def warmth() -> float:
        return float(state[oil].mean())

    leak = _change("internal_leakage", "*", "scale")
    heat = _change("oil_temperature", "*", "set")
    return (
        Slider("seal_wear", "seal leak x", "x leakage", 1.0, 50.0, 1.0, leak, wear),
        Slider("oil_temperature", "oil degC", "deg C", -10.0, 120.0, warm, heat, warmth),
    )


def _change(parameter: str, element: str, kind: str) -> Callable[[float, float], ParameterChange]:
    return lambda value, start: ParameterChange(
        parameter=parameter, element=element, kind=kind, value=value, start=start
    )
