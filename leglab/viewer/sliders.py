"""What a user changes by hand while he watches."""

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
    """The sliders of a machine: seal_wear, oil_temperature and payload."""
    warm = simulation.parameter(simulation.actuators[0], "oil_temperature")
    loaded = _LOADED if _LOADED in bodies.elements else bodies.elements[-1]

    def change(
        parameter: str, element: str, kind: str
    ) -> Callable[[float, float], ParameterChange]:
        return lambda value, start: ParameterChange(
            parameter=parameter, element=element, kind=kind, value=value, start=start
        )

    leakage, oil = simulation.slots("internal_leakage"), simulation.slots("oil_temperature")
    state, masses = simulation.data.plugin_state, simulation.model.body_mass
    body = simulation.model.body(loaded).id
    healthy, unloaded = state[leakage].copy(), float(masses[body])

    def wear() -> float:
        return float((state[leakage] / healthy).max())

    def warmth() -> float:
        return float(state[oil].mean())

    def load() -> float:
        return float(masses[body]) - unloaded

    leak = change("internal_leakage", "*", "scale")
    heat = change("oil_temperature", "*", "set")
    mass = change(ADDED_MASS.name, loaded, "set")
    return (
        Slider("seal_wear", "seal leak x", "x leakage", 1.0, 50.0, 1.0, leak, wear),
        Slider("oil_temperature", "oil degC", "deg C", -10.0, 120.0, warm, heat, warmth),
        Slider("payload", "payload kg", f"kg on {loaded}", 0.0, 30.0, 0.0, mass, load),
    )
