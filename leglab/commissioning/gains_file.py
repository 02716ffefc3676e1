"""Files of tuned gains: one table per model, with the timing of the loop and each joint's gains."""

import inspect
import json
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from leglab.base.output import write_atomically
from leglab.base.registry import Registry, import_modules
from leglab.machine.files import model_digest
from leglab.machine.library import is_shipped
from leglab.machine.sensors import SensorConfiguration
from leglab.machine.simulation import Simulation, load_model

# Models whose joints all have cylinders.
CYLINDER_MODELS = ("knee_bench", "leg", "leg_rail")

Row = dict[str, float]
T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class GainsFile:
    """A file of tuned gains in the folder of this module."""

    path: Path  #: The file
    head: Sequence[str]  #: Lines of the comment at its head
    timing: Sequence[str]  #: Names of the sensor settings on which the tuned gains depend
    formats: Mapping[str, str]  #: Number formats of a joint's gains, by name of the gain

    def table(
        self, simulation: Simulation, sensors: SensorConfiguration, rows: Sequence[Row]
    ) -> dict[str, Any]:
        """Returns the table of a model, with values rounded as in the file."""
        joints = {
            joint: {name: float(f"{row[name]:{form}}") for name, form in self.formats.items()}
            for joint, row in zip(simulation.joints, rows, strict=True)
        }
        return {**{name: getattr(sensors, name) for name in self.timing}, "joints": joints}

    def text(self, tables: Mapping[str, dict[str, Any]]) -> str:
        """Formats tables by model as TOML."""
        lines = [f"# {line}" for line in self.head]
        for model, table in tables.items():
            lines += [
                "",
                f"[{_key(model)}]",
                *(f"{name} = {table[name]!r}" for name in self.timing),
            ]
            for joint, row in table["joints"].items():
                cells = (f"{name} = {row[name]:{form}}" for name, form in self.formats.items())
                lines.append(f"joints.{_key(joint)} = {{ {', '.join(cells)} }}")
        return "\n".join(lines) + "\n"

    def store(self, tables: Mapping[str, dict[str, Any]]) -> None:
        """Writes tables by model; keeps the tables of other models in the file.

        Raises:
            LeglabError: The file cannot be written.
        """
        text = self.text({**tomllib.loads(self.path.read_text()), **tables})
        write_atomically(self.path, lambda file: file.write(text.encode()))

    def rows(
        self, model: str, simulation: Simulation, sensors: SensorConfiguration
    ) -> list[Row] | None:
        """Returns each joint's stored gains; None without a table for this model and timing.

        Args:
            model: Name or path of the model.
            simulation: The machine, for the names of its joints.
            sensors: Sensors and timing of the loop.
        """
        tables = tomllib.loads(self.path.read_text())
        # `stored_name` reads the model's files, so it is called only if a key may match.
        asked = any(key.partition(" ")[0] == Path(model).name for key in tables)
        entry = tables.get(stored_name(model)) if asked else None
        if entry is None or any(entry[name] != getattr(sensors, name) for name in self.timing):
            return None
        rows = [entry["joints"].get(name) for name in simulation.joints]
        return None if None in rows else rows


@dataclass(frozen=True, kw_only=True)
class ControllerGains(GainsFile, Generic[T]):
    """Gains of a controller: stored for the shipped models, tuned on request for others."""

    #: Type of gains that the controller takes: a dataclass whose fields are arrays (joints,).
    kind: Callable[..., T]
    #: Function that tunes a model's machine and changes its positions; returns gains per joint.
    tune: Callable[[str, Simulation, SensorConfiguration], list[Row]]

    def gains(self, model: str, simulation: Simulation, sensors: SensorConfiguration) -> T:
        """Returns the gains of all joints.

        Args:
            model: Name or path of the model.
            simulation: The nominal machine in its rest pose; its positions are changed.
            sensors: Sensors and timing of the loop.
        """
        rows = self.rows(model, simulation, sensors) or self.tune(model, simulation, sensors)
        names = inspect.signature(self.kind).parameters
        return self.kind(**{name: np.array([row[name] for row in rows]) for name in names})

    def write(self) -> None:
        """Tunes `CYLINDER_MODELS` for the default sensors and writes the file."""
        sensors, tables = SensorConfiguration(), {}
        for model in CYLINDER_MODELS:
            machine = Simulation(load_model(model))
            tables[model] = self.table(machine, sensors, self.tune(model, machine, sensors))
        self.path.write_text(self.text(tables))


# Gains by name of the controller; `leglab.commissioning.*_gains` and other modules add entries.
GAINS: Registry[ControllerGains[Any]] = Registry("controller with tuned gains")
GAINS.add_loader(partial(import_modules, __package__, [str(Path(__file__).parent)]))


def stored_name(model: str) -> str:
    """Returns the key of a model's gains: a shipped model's name, or file name and digest.

    Raises:
        LeglabError: There is no such model.
    """
    return model if is_shipped(model) else f"{Path(model).name} {model_digest(model)[:16]}"


def _key(name: str) -> str:
    """Returns a name as a TOML key."""
    return name if re.fullmatch(r"[\w-]+", name, re.ASCII) else json.dumps(name)
