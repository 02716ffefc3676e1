"""Units of columns, for file formats that store them and for summaries."""

from collections.abc import Iterable, Mapping
from typing import Any

# Units by suffix of the column name. The name does not show whether a joint is a hinge or a slide.
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
# Unit of the control input of a native MuJoCo actuator; only the model defines its meaning.
CONTROL_UNIT = "ctrl"


def unit_of(name: str, metadata: Mapping[str, Any]) -> str:
    """Returns the unit of a column.

    Args:
        name: The column, or "time".
        metadata: Metadata of the recording; its "units" mapping overrides the naming rules.

    Returns:
        The unit, in ASCII if it is from the naming rules; "1" for a dimensionless quantity, "" if
        unknown.
    """
    return own_units(metadata).get(name) or usual_unit(name)


def own_units(metadata: Mapping[str, Any]) -> dict[str, str]:
    """Returns the units in the metadata by column; ignores entries that are not text."""
    units = metadata.get("units")
    if not isinstance(units, Mapping):
        return {}
    return {name: unit for name, unit in units.items() if isinstance(unit, str)}


def usual_unit(name: str) -> str:
    """Returns the unit of a column by the naming rules of recordings, or "" if unknown."""
    if name == "time":
        return "s"
    return next((unit for end, unit in _UNITS.items() if f"_{name}".endswith(f"_{end}")), "")


def error_unit(slides: Iterable[bool]) -> str:
    """Returns the unit in which tracking errors are reported, a thousandth of the SI unit.

    Args:
        slides: For each joint, whether it is a slide.

    Returns:
        "mrad" for hinges, "mm" for slides, "mrad or mm" for a mixture.
    """
    kinds = set(slides)
    if kinds == {True}:
        return "mm"
    return "mrad or mm" if True in kinds else "mrad"


def shared_unit(units: Iterable[str]) -> str:
    """Returns the unit of errors shown together, given the unit of each from `error_unit`."""
    known = set(units)
    return known.pop() if len(known) == 1 else "mrad or mm"


def units_of_columns(columns: Iterable[str], slides: Mapping[str, bool]) -> dict[str, str]:
    """Returns the known units by column for a machine with known joint types.

    Args:
        columns: Names of the columns.
        slides: For each joint by name, whether it is a slide; the others are hinges.
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
