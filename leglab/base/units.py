"""Units of columns, for formats that can hold them and for summaries."""

from collections.abc import Iterable, Mapping
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
    "truth": "rad or m",
    "velocity": "rad/s or m/s",
    "command": "1",
    "feedforward": "1",
    "feedback": "1",
    "fallback": "1",
    "spool": "1",
    "seal_clearance": "1",
    "energy_supply": "J",
    "effort": "N m or N",
}
_EITHER = " or "
# Of what is sent to a native actuator: the model alone knows what it stands for.
CONTROL_UNIT = "ctrl"


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


def error_unit(slides: Iterable[bool]) -> str:
    """Returns the unit in which tracking errors are told, a thousandth of the SI unit.

    Args:
        slides: Of each joint whose error is meant, whether it slides.

    Returns:
        "mrad" of hinges, "mm" of slides, "mrad or mm" of both together.
    """
    kinds = set(slides)
    if kinds == {True}:
        return "mm"
    return "mrad or mm" if True in kinds else "mrad"


def shared_unit(units: Iterable[str]) -> str:
    """Returns the unit of errors that stand together, each of which has one of `error_unit`."""
    known = set(units)
    return known.pop() if len(known) == 1 else "mrad or mm"


def units_of_columns(columns: Iterable[str], slides: Mapping[str, bool]) -> dict[str, str]:
    """Returns the units that are known, by column, for a machine whose joints are known.

    Args:
        columns: Names.
        slides: By joint, whether it slides; the others hinge.
    """
    units = {}
    for column in columns:
        unit = usual_unit(column)
        owners = [joint for joint in slides if column.startswith(f"{joint}_")]
        if _EITHER in unit and owners:
            hinge, slide = unit.split(_EITHER)
            unit = slide if slides[max(owners, key=len)] else hinge
        if unit:
            units[column] = unit
    return units
