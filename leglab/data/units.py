"""Units of columns, for formats that can hold them and for summaries."""

from collections.abc import Mapping
from typing import Any

# By the end of the name. A joint may hinge or slide: the name does not say.
_UNITS = {
    "acceleration": "rad/s^2 or m/s^2",
    "temperature": "degC",
    "pressure_a": "Pa",
    "pressure_b": "Pa",
    "pressure": "Pa",
    "reference": "rad or m",
    "position": "rad or m",
    "velocity": "rad/s or m/s",
    "command": "1",
    "effort": "N m or N",
}


def unit_of(name: str, metadata: Mapping[str, Any]) -> str:
    """Returns the unit of a column.

    Args:
        name: The column, or "time".
        metadata: Of the recording; a mapping under "units" goes before the naming rules.

    Returns:
        The unit, in ASCII where it is ours; "1" for a number without one, "" where nothing is
        known.
    """
    return own_units(metadata).get(name) or usual_unit(name)


def own_units(metadata: Mapping[str, Any]) -> dict[str, str]:
    """Returns the units that the metadata gives, by column; anything but text is passed over."""
    units = metadata.get("units")
    if not isinstance(units, Mapping):
        return {}
    return {name: unit for name, unit in units.items() if isinstance(unit, str)}


def usual_unit(name: str) -> str:
    """Returns the unit that the naming rules of recordings give a column, or ""."""
    if name == "time":
        return "s"
    return next((unit for end, unit in _UNITS.items() if f"_{name}".endswith(f"_{end}")), "")
