"""Tables of docs/guides/calibration.md: `python docs/_tools/calibration_tables.py NAME`.

`told` makes every controller on a nominal machine that notes what it is asked for, and runs it on
readings of which one after the other is disturbed. `exactness` and `specimen` hold the calibrated
valve maps against the nominal machine between their grid points and against specimens.
"""

import copy
import inspect
import re
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
from sphinx.pycode import ModuleAnalyzer

import leglab.controllers  # noqa: F401  registers the controllers
from leglab.base.scale import rms
from leglab.commissioning.calibration import ValveMap, steady_commands, valve_maps
from leglab.commissioning.setup import controller_setup
from leglab.control import (
    ControllerSetup,
    Foreknowledge,
    Measurement,
    NominalMachine,
    ReferencePoint,
    controller_names,
)
from leglab.control.backstepping.data import NominalCylinders
from leglab.control.contract import CONTROLLERS, Controller
from leglab.control.feedforward.fault_bank import FaultBank, FaultCurve
from leglab.machine.changes import vary_bodies, vary_parameters
from leglab.machine.parameters import plugin_tables
from leglab.machine.sensors import SensorConfiguration
from leglab.machine.simulation import Simulation, load_model

MODELS = ("knee_bench", "leg")
PERIODS = 300
# By how much a reading is off where it is disturbed: far above noise, far below what is refused.
DISTURBANCE = {
    "position": 1e-3,
    "velocity": 1e-2,
    "pressure_a": 1e5,
    "pressure_b": 1e5,
    "supply_pressure": 5e5,
}
TOLERANCE, SPECIMENS = 0.1, 5


class Witness:
    """Passes on what an object gives and notes the names that it is asked for.

    Args:
        thing: The object.
        kind: What the names begin with.
        asked: Collects them.
    """

    def __init__(self, thing: Any, kind: str, asked: set[str]) -> None:
        self._thing, self._kind, self._asked = thing, kind, asked

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._thing, name)
        if not inspect.ismethod(value):
            self._asked.add(f"{self._kind}{name}")
        if name == "valve_maps":
            return [Witness(part, f"{name}.", self._asked) for part in value]
        if name == "cylinders":
            return Witness(value, f"{name}.", self._asked)
        return value


class WitnessSetup(ControllerSetup):
    """Notes when somebody asks for the period of the planned motion."""

    asked: set[str]

    def __getattribute__(self, name: str) -> Any:
        if name == "reference_period":
            object.__getattribute__(self, "asked").add(name)
        return object.__getattribute__(self, name)


class BenchRun:
    """In place of a recording: a fit to it gives the parameters that the controller starts with."""

    def identify(self, adaptation: Any) -> np.ndarray:
        """Returns parameters as `leglab.control.feedforward.offline` does."""
        return adaptation.learner.parameters


def made(name: str) -> tuple[Controller, set[str]]:
    """A controller for the knee bench, and what it asked for; it may ask for more as it runs."""
    simulation = Simulation(load_model("knee_bench", visual=False))
    setup = controller_setup(simulation, "knee_bench", SensorConfiguration())
    asked: set[str] = set()
    known = Foreknowledge(
        first_change=1e3,
        last_change=1e3,
        bench_runs=lambda: [BenchRun(), BenchRun()],
        exact_commands=lambda: np.zeros((PERIODS, 1)),
    )
    witness = WitnessSetup(
        joints=setup.joints,
        control_period=setup.control_period,
        machine=Witness(setup.machine, "", asked),  # type: ignore[arg-type]
        reference_period=1.0,
        foreknowledge=Witness(known, "", asked),  # type: ignore[arg-type]
        fault_bank=lambda: asked.add("fault_bank") or bank(),  # type: ignore[func-returns-value]
    )
    object.__setattr__(witness, "asked", asked)
    factory, settings = CONTROLLERS.configured(name, None)
    return factory(witness, settings), asked


def bank() -> FaultBank:
    """In place of a bank of faults: one curve, which nothing that happens here will meet.

    It is of the parameters that the map of one joint has.
    """
    curve = FaultCurve(
        fault="seal_wear",
        element="all",
        meaning="",
        sizes=np.array([1.0, 2.0]),
        shifts=np.stack([np.zeros((1, 22)), np.ones((1, 22))]),
    )
    return FaultBank(curves=(curve,))


def told(name: str) -> set[str]:
    """What a controller asks for of the nominal machine and of the run's changes."""
    controller, asked = made(name)
    commands(controller)
    return asked


def commands(controller: Controller, disturbed: str = "") -> np.ndarray:
    """Commands on readings that trail a swing; one kind of reading may be disturbed. (n, 1)."""
    period, given = SensorConfiguration().control_period, []
    for k in range(PERIODS):
        phase = 2 * np.pi * np.array([period * k])
        swing = [0.3 * f(phase - lag) for lag in (0.0, 0.02) for f in (np.sin, np.cos)]
        reference = ReferencePoint(0.8 + swing[0], 2 * np.pi * swing[1], -39.5 * swing[0])
        readings: dict[str, Any] = {
            "position": 0.8 + swing[2],
            "velocity": 2 * np.pi * swing[3],
            "pressure_a": 6e6 + 1e6 * swing[2],
            "pressure_b": 9e6 - 1e6 * swing[2],
            "supply_pressure": 16e6,
        }
        if disturbed:
            readings[disturbed] = readings[disturbed] + DISTURBANCE[disturbed] * np.sin(k)[None]
        if disturbed == "supply_pressure":
            readings[disturbed] = float(readings[disturbed][0])
        measurement = Measurement(period * k, **readings)
        if not k:
            controller.reset(measurement)
        given.append(np.array(controller.command(measurement, reference)))
    return np.array(given)


def measured(name: str) -> set[str]:
    """Readings that change what a controller commands."""
    controller, _ = made(name)
    still = commands(controller)
    return {kind for kind in DISTURBANCE if not np.array_equal(commands(controller, kind), still)}


def told_rows() -> list[tuple[str, str, str]]:
    """Name, where it is told, and meaning of everything that a controller can know."""
    rows = []
    for name, text in meanings(NominalMachine):
        if name == "valve_maps":
            rows += [(f"{name}.{part}", "told", text) for part, text in meanings(ValveMap)]
        else:
            rows.append((name, "told", text))
    setup = dict(meanings(ControllerSetup))
    rows += [(name, "told", setup[name]) for name in ("reference_period", "fault_bank")]
    rows += [(name, "told of the run", text) for name, text in meanings(Foreknowledge)]
    known = dict(meanings(Measurement))
    return rows + [(name, "measured", known[name]) for name in DISTURBANCE]


def meanings(described: type) -> list[tuple[str, str]]:
    """Names and meanings of the attributes of a class, from its docstring or beside its fields."""
    _, _, text = (inspect.getdoc(described) or "").partition("Attributes:\n")
    entries = re.findall(r"^ {4}(\w+): (.+(?:\n {8}.+)*)", text.partition("\n\n")[0], re.MULTILINE)
    if not entries:
        beside = ModuleAnalyzer.for_module(described.__module__).find_attr_docs()
        owner = described.__qualname__
        entries = [(name, " ".join(lines)) for (of, name), lines in beside.items() if of == owner]
    return [(name, first(words)) for name, words in entries]


def first(text: str) -> str:
    """The first sentence, without the shape of an array."""
    text = re.split(r"\.(?:\s|$)|;|, a `|, or None", " ".join(text.split()))[0]
    return re.sub(r",? \((?:joints|[pv])(?:, [pv])?,?\)(?: each)?|, shape \(.*", "", text)


def told_table() -> Iterator[str]:
    """What every controller is told and what it measures, the ones that know least first."""
    rows = told_rows()
    knows = {name: told(name) | measured(name) for name in controller_names()}
    shown = {row[0] for row in rows}
    names = sorted(knows, key=lambda name: (len(knows[name] & shown), name))
    yield f"| | meaning | {' | '.join(f'`{name}`' for name in names)} |"
    yield "|---|---|" + ":-:|" * len(names)
    last = ""
    for key, kind, text in rows:
        if kind != last:
            yield f"| **{kind}** | |" + " |" * len(names)
            last = kind
        marks = " | ".join("x" if key in knows[name] else "" for name in names)
        yield f"| `{key}` | {text} | {marks} |"
    yield ""
    for name in names:
        sheet = {key.partition(".")[2] for key in knows[name] if key.startswith("cylinders.")}
        if sheet:
            entries = [f"`{entry}`" for entry, _ in meanings(NominalCylinders) if entry in sheet]
            yield f"Of `cylinders`, `{name}` reads {', '.join(entries)}."


def machine(model: str, seed: int | None = None) -> Simulation:
    """The nominal machine in its rest pose, or the specimen of a seed."""
    nominal = Simulation(load_model(model, visual=False))
    if seed is None:
        return nominal
    other = copy.copy(nominal.model)
    vary_bodies(other, TOLERANCE, seed)
    specimen = Simulation(other)
    vary_parameters(specimen, TOLERANCE, seed)
    return specimen


def exactness_table() -> Iterator[str]:
    """Valve maps against steady motion between their points, and against specimens'."""
    head = ("% of full command", "map, RMS", "off between its points, RMS", "largest")
    yield f"| {' | '.join(head)} | off on {SPECIMENS} specimens, RMS | of the map |"
    yield "|---|---:|---:|---:|---:|---:|"
    for model in MODELS:
        nominal = machine(model)
        maps = valve_maps(nominal)
        specimens = [machine(model, seed) for seed in range(SPECIMENS)]
        for joint, known in enumerate(maps):
            inside = np.abs(known.command) < 1
            size = rms(known.command[inside])
            between = between_points(nominal, joint, known)
            off = []
            for specimen in specimens:
                own = steady_commands(specimen, joint, known.position, known.velocity)
                off.append((own - known.command)[inside & (np.abs(own) < 1)])
            other = rms(np.concatenate(off))
            largest = 100 * np.abs(between).max()
            name = f"`{model}` {nominal.joints[joint]}"
            yield (
                f"| {name} | {100 * size:.1f} | {100 * rms(between):.2f} | {largest:.1f} | "
                f"{100 * other:.1f} | {100 * other / size:.0f} % |"
            )


def between_points(nominal: Simulation, joint: int, known: ValveMap) -> np.ndarray:
    """Error of the bilinear map in the middle of its cells, where the valve suffices, (cells,)."""
    middle = (0.5 * (grid[1:] + grid[:-1]) for grid in (known.position, known.velocity))
    exact = steady_commands(nominal, joint, *middle)
    corners = [known.command[i : i - 1 or None, j : j - 1 or None] for i, j in np.ndindex(2, 2)]
    inside = np.all([np.abs(c) < 1 for c in (*corners, exact)], axis=0)
    return (np.mean(corners, axis=0) - exact)[inside]


def specimen_table() -> Iterator[str]:
    """Parameters that a specimen has of its own, found by drawing one, and those that it has not.

    Parameters that are zero on the drawing stay zero and are not named.
    """
    yield "| element of `leg` | differs from the drawing | is as on the drawing |"
    yield "|---|---|---|"
    drawn, nominal = machine("leg", 0), machine("leg")
    kinds: dict[str, tuple[set[str], set[str]]] = {}
    for element, plugin in nominal.elements.items():
        differs, same = kinds.setdefault(plugin, (set(), set()))
        for name in plugin_tables()[plugin].parameters:
            if nominal.has(element, name) and nominal.parameter(element, name):
                changed = drawn.parameter(element, name) != nominal.parameter(element, name)
                (differs if changed else same).add(name)
    for plugin, (differs, same) in sorted(kinds.items()):
        cells = [", ".join(f"`{name}`" for name in sorted(names)) for names in (differs, same)]
        yield f"| `{plugin}` | {' | '.join(cells)} |"
    bodies = {
        name: not np.array_equal(getattr(drawn.model, name), getattr(nominal.model, name))
        for name in ("body_mass", "body_inertia", "body_ipos", "jnt_range", "dof_damping")
    }
    parts = [
        ", ".join(f"`{n}`" for n, changed in bodies.items() if changed == kind)
        for kind in (True, False)
    ]
    yield f"| bodies and joints | {' | '.join(parts)} |"


TABLES = {"told": told_table, "exactness": exactness_table, "specimen": specimen_table}


def main() -> None:
    """Prints a table."""
    if len(sys.argv) != 2 or sys.argv[1] not in TABLES:
        raise SystemExit(f"usage: calibration_tables.py {'|'.join(TABLES)}")
    print("\n".join(TABLES[sys.argv[1]]()))


if __name__ == "__main__":
    main()
