"""Physical parameters and states of the plugins, by name.

The tables live in the C++ core (`leglab/csrc`), which documents unit, bounds and source of every
entry; this module mirrors them, so that a name is spelled in one place.
"""

import functools
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from leglab._native import hydraulics as _native
from leglab.base.errors import ModelError, SettingsError

RESIDUAL = "leglab.residual"
# Input variables of a learned residual, in the order of its coefficients.
RESIDUAL_VARIABLES = ("position", "velocity", "load", "command")
# Format of errors of plugins and core: "attribute 'bore' = 9 m is out of range; allowed: ..."
_GIVEN = re.compile(r" = ('[^']*'|[^\s;]+)")
_ALLOWED = re.compile(r"; allowed:? (.*)")


@dataclass(frozen=True)
class Parameter:
    """One physical parameter of a plugin instance: a row of its table."""

    name: str  #: Attribute name in MJCF and in `Simulation.set_parameter`
    #: SI unit (temperatures in degC). Parameters of a joint have the unit at a hinge, unless the
    #: table belongs to an instance on a slide.
    unit: str
    nominal: float  #: Default; NaN if MJCF must set the parameter
    minimum: float  #: Smallest value; itself excluded if `minimum_allowed` is false
    maximum: float  #: Largest value
    minimum_allowed: bool  #: Whether `minimum` itself is allowed
    description: str  #: Meaning, with its source
    offset: int = 0  #: Index in the plugin state of the instance

    @property
    def allowed(self) -> str:
        """The bounds as text."""
        bracket = "[" if self.minimum_allowed else "("
        return f"{bracket}{self.minimum:g}, {self.maximum:g}] {self.unit}"

    def check(self, value: float, where: str) -> float:
        """Returns the value as float.

        Raises:
            SettingsError: If it is not finite or out of bounds; `where` names the element.
        """
        number = float(value)
        above = number >= self.minimum if self.minimum_allowed else number > self.minimum
        if not (math.isfinite(number) and above and number <= self.maximum):
            text = f"{where}: {self.name} = {number:g}; allowed "
            raise SettingsError(text, given=number, allowed=self.allowed)
        return number


@dataclass(frozen=True)
class State:
    """One dynamic state of a plugin instance: `name`, `unit`, `description`, `offset`."""

    name: str
    unit: str
    description: str
    offset: int


Row = TypeVar("Row", Parameter, State)


@dataclass(frozen=True, kw_only=True)
class PluginTable:
    """All parameters and states of a plugin, by name, in the order of its plugin state."""

    plugin: str
    parameters: Mapping[str, Parameter]
    states: Mapping[str, State]

    def entry(self, name: str) -> Parameter | State:
        """Looks a parameter or state up by name.

        Raises:
            SettingsError: If the plugin has no such entry; lists all entries.
        """
        if name in self.parameters:
            return self.parameters[name]
        if name in self.states:
            return self.states[name]
        known = [*self.parameters, *self.states]
        raise SettingsError.unknown(f"{self.plugin} parameter", name, known)

    def to_json(self) -> dict[str, Any]:
        """Returns the table for JSON; a missing default and an infinite bound are None."""
        return {
            "parameters": {
                row.name: {
                    "unit": row.unit,
                    "default": _finite(row.nominal),
                    "minimum": _finite(row.minimum),
                    "minimum_allowed": row.minimum_allowed,
                    "maximum": _finite(row.maximum),
                    "meaning": row.description,
                }
                for row in self.parameters.values()
            },
            "states": {
                state.name: {"unit": state.unit, "meaning": state.description}
                for state in self.states.values()
            },
        }


# Sources in words, by their abbreviations in the tables of the compiled core.
_SOURCES = {
    "[HyQ]": "(source: leg of the robot HyQ, Ledezma 2016)",
    "[V]": "(source: data sheet of a servo valve, class E024)",
    "[ISO]": "(source: ISO 3448)",
    "[C]": "(chosen for leglab)",
}


def _sourced(description: str) -> str:
    """Replaces the abbreviation of the source in a description by words."""
    for short, told in _SOURCES.items():
        description = description.replace(short, told)
    return description


@functools.cache
def plugin_tables() -> Mapping[str, PluginTable]:
    """Returns the tables of all plugins with parameters, by plugin name."""
    tables = {}
    for plugin, (parameters, states, _) in _native.parameter_tables().items():
        if not parameters:
            continue
        rows = [Parameter(*r[:-1], _sourced(r[-1]), i) for i, r in enumerate(parameters)]
        dynamic = [State(*row, offset) for offset, row in enumerate(states, len(rows))]
        tables[plugin] = PluginTable(
            plugin=plugin,
            parameters=MappingProxyType({row.name: row for row in rows}),
            states=MappingProxyType({row.name: row for row in dynamic}),
        )
    return MappingProxyType(tables)


def table_at_slide(table: PluginTable) -> PluginTable:
    """Returns the table of an instance on a slide joint: N in place of N m, m in place of rad."""
    parameters, states = _at_slide(table.parameters), _at_slide(table.states)
    return replace(table, parameters=parameters, states=states)


def _at_slide(rows: Mapping[str, Row]) -> Mapping[str, Row]:
    at_slide = {n: replace(row, unit=_native.unit_at_slide(row.unit)) for n, row in rows.items()}
    return MappingProxyType(at_slide)


def residual_table(table: PluginTable, counts: Mapping[str, int], unit: str) -> PluginTable:
    """Returns the table of a learned residual; coefficients ("position_0" ...) follow the states.

    Args:
        table: Table of the plugin.
        counts: Number of coefficients by variable.
        unit: Unit of the coefficients: the unit of the joint's force, or "1" for a command.
    """
    place = len(table.parameters) + len(table.states)
    rows = dict(table.parameters)
    for variable in RESIDUAL_VARIABLES:
        for number in range(counts.get(variable, 0)):
            name = f"{variable}_{number}"
            meaning = f"coefficient of the cubic B-spline of {variable}"
            rows[name] = Parameter(name, unit, 0.0, -1e9, 1e9, True, meaning, offset=place)
            place += 1
    return replace(table, parameters=MappingProxyType(rows))


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def refused(where: str, text: str) -> ModelError:
    """Turns a message of MuJoCo, a plugin or the compiled core into a one-line error."""
    line = " ".join(text.split())
    given, allowed = _GIVEN.search(line), _ALLOWED.search(line)
    return ModelError(
        f"{where}: {line}", given=given and given[1].strip("'"), allowed=allowed and allowed[1]
    )


def parameter_vector(plugin: str, values: Mapping[str, float]) -> np.ndarray:
    """Returns parameters of an instance in table order, (n,): `values`, else the nominal ones.

    Raises:
        SettingsError: If a name is unknown, a value is out of bounds, or a required one is missing.
    """
    table = plugin_tables()[plugin]
    for name in values:
        if name not in table.parameters:
            raise SettingsError.unknown(f"{plugin} parameter", name, table.parameters)
    vector = np.empty(len(table.parameters))
    for name, parameter in table.parameters.items():
        if name not in values and math.isnan(parameter.nominal):
            text = f"{plugin}: {name} is missing; allowed "
            raise SettingsError(text, allowed=parameter.allowed)
        vector[parameter.offset] = parameter.check(values.get(name, parameter.nominal), plugin)
    return vector


def placed_parameters(
    parameters: Mapping[str, float], elements: Mapping[str, str]
) -> dict[tuple[str, str], float]:
    """Assigns parameter values to the elements that have the parameters.

    Args:
        parameters: Values by NAME, for all elements with that parameter, or by ELEMENT.NAME, which
            takes precedence.
        elements: Plugin names by element name.

    Returns:
        Values by element and name, in the parameter's own unit.

    Raises:
        SettingsError: There is no such element or parameter, or a value is out of bounds.
    """
    tables = plugin_tables()
    owned = {element: tables[plugin].parameters for element, plugin in elements.items()}
    found = {}
    for key, value in sorted(parameters.items(), key=lambda item: "." in item[0]):
        element, dot, name = key.rpartition(".")
        if dot and element not in owned:
            raise SettingsError.unknown("element", element, owned)
        having = [e for e, rows in owned.items() if name in rows and element in ("", e)]
        if not having:
            known = owned[element] if dot else {row for rows in owned.values() for row in rows}
            raise SettingsError.unknown(f"parameter of {element or 'the model'}", name, known)
        if isinstance(value, bool) or not isinstance(value, int | float):
            text = f"parameters: {key} is {value!r}; allowed: "
            raise SettingsError(text, given=value, allowed="a number")
        for each in having:
            found[each, name] = owned[each][name].check(value, f"parameters: {each}")
    return found


def markdown_tables(tables: Iterable[PluginTable]) -> str:
    """Returns parameters and states as Markdown, the content of docs/reference/parameters.md."""
    lines = [
        "# Parameters and states of the plugins",
        "",
        "Made by `leglab parameters --markdown > docs/reference/parameters.md`. SI units, "
        "°C for oil. Units of plugins on a joint are those at a hinge: at a slide N stands for "
        "N m, m for rad, kg for kg m^2.",
    ]
    for table in tables:
        lines += ["", f"## {table.plugin}", ""]
        lines += ["| parameter | default | allowed | meaning |", "|---|---|---|---|"]
        for row in table.parameters.values():
            default = "required" if math.isnan(row.nominal) else f"{row.nominal:g}"
            lines.append(f"| `{row.name}` | {default} | {row.allowed} | {row.description} |")
        if table.states:
            lines += ["", "| state | unit | meaning |", "|---|---|---|"]
            for state in table.states.values():
                lines.append(f"| `{state.name}` | {state.unit} | {state.description} |")
    return "\n".join(lines) + "\n"
