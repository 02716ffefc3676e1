"""Sliders: parameters that a user changes by hand in the viewer."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from leglab.base.scenario import ParameterChange
from leglab.machine.changes import ADDED_MASS, Bodies
from leglab.machine.simulation import Simulation

# Body that carries the load if the model has it, as in the scenario "payload".
_LOADED = "shank"


@dataclass(frozen=True)
class Slider:
    """A slider of the control panel."""

    name: str  #: Name of the slider in the session
    label: str  #: Name of its actuator in the viewer's model, which the panel shortens
    unit: str  #: Unit of its value
    lowest: float  #: Smallest value
    highest: float  #: Largest value
    change: ParameterChange  #: Change of the machine, with the initial value
    #: Reads the present value from the machine, on which slider and scenario both act.
    present: Callable[[], float]


def sliders(simulation: Simulation) -> tuple[Slider, ...]:
    """Returns the slider payload; for machines with cylinders also seal_wear, oil_temperature."""
    bodies = Bodies(simulation.model).elements
    loaded = _LOADED if _LOADED in bodies else bodies[-1]
    masses, body = simulation.model.body_mass, simulation.model.body(loaded).id
    unloaded = float(masses[body])

    def load() -> float:
        return float(masses[body]) - unloaded

    change = partial(ParameterChange, start=0.0)
    mass = change(parameter=ADDED_MASS.name, element=loaded, kind="set", value=0.0)
    payload = Slider("payload", "payload kg", f"kg on {loaded}", 0.0, 30.0, mass, load)
    if not simulation.cylinders:
        return (payload,)
    state = simulation.data.plugin_state
    leakage, oil = simulation.slots("internal_leakage"), simulation.slots("oil_temperature")
    healthy = state[leakage].copy()

    def wear() -> float:
        return float((state[leakage] / healthy).max())

    def warmth() -> float:
        return float(state[oil].mean())

    warm = simulation.parameter(simulation.cylinders[0], "oil_temperature")
    leak = change(parameter="internal_leakage", kind="scale", value=1.0)
    heat = change(parameter="oil_temperature", kind="set", value=warm)
    return (
        Slider("seal_wear", "seal leak x", "x leakage", 1.0, 50.0, leak, wear),
        Slider("oil_temperature", "oil degC", "deg C", -10.0, 120.0, heat, warmth),
        payload,
    )
