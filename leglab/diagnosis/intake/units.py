"""Units and directions of logged signals, as factors that convert to the model's units."""

import numpy as np

from leglab.data.units_in_names import split
from leglab.diagnosis.plant.columns import UsableColumn
from leglab.diagnosis.plant.model import CHAMBERS
from leglab.diagnosis.thresholds import DEFAULT

# Only factors >= 2 pi or <= 0.1, because factors closer to 1 are effects (gain, encoder scale).
ANGLES, _LENGTHS, _PRESSURES = (
    {unit: split(f"x [{unit}]").factor for unit in units.split()}
    for units in ("degrees mrad turns", "mm inches micrometres", "bar MPa psi kPa")
)
_SHARES = {"per cent": 1e-2, "mA, mV or thousandths": 1e-3}
_LARGE = {"thousands of its unit": 1e3, "hundreds of its unit": 1e2}
OPPOSITE = "counted the other way"
DEGREES = ("degrees", ANGLES["degrees"])
# Encoder counts per turn to try; any other number is near enough to one of these for a doubt.
_COUNTS = [2.0**n for n in range(8, 25)]


def position_units(samples: np.ndarray, *, hinge: bool) -> dict[str, float]:
    """Returns, by unit, factors that may convert positions, (n,), to rad (if `hinge`) or m."""
    known = samples[np.isfinite(samples)]
    found = dict(ANGLES if hinge else _LENGTHS)
    if hinge and known.size and np.all(known == np.rint(known)):
        turns = {f"counts, some {n:.0f} a turn": 2.0 * np.pi / n for n in _COUNTS}
        # Only resolutions by which the joint moves more than a degree and less than eight turns.
        found |= {unit: f for unit, f in turns.items() if 0.02 < f * np.ptp(known) < 50.0}
    return found


def command_units(*, angle: bool) -> dict[str, float]:
    """Returns, by unit, factors that may convert a command; `angle` if it is a hinge's angle."""
    return {**_SHARES, **_LARGE, **({"degrees": ANGLES["degrees"]} if angle else {})}


def fits(samples: np.ndarray, column: UsableColumn, beyond: float = DEFAULT.beyond_range) -> bool:
    """Tests whether samples, (n,), NaN if missing, lie within a column's limits.

    They may exceed the limits by the share `beyond` of the range between the limits.
    """
    room = beyond * (column.limits[1] - column.limits[0])
    below = np.nanmin(samples) < column.limits[0] - room
    return not (below or np.nanmax(samples) > column.limits[1] + room)


def other_unit(
    samples: np.ndarray, column: UsableColumn, beyond: float = DEFAULT.beyond_range
) -> tuple[str, float] | None:
    """Returns a unit or direction in which samples, (n,), fit a column's limits, and its factor.

    Pressures are in doubt if none reaches a hundredth of the supply pressure [Pa], which every
    working chamber exceeds. Then the unit with the largest pressures below 4/3 of the supply is
    returned, since shocks may exceed the supply. Other columns are tried in the opposite direction,
    another unit, and both; the first fit is returned. None if unchanged samples or no others fit.
    """
    if column.kind in CHAMBERS:
        highest, supply = float(np.nanmax(samples)), column.limits[1]
        if not 0.0 < highest < 0.01 * supply:
            return None
        reached = {u: f for u, f in _PRESSURES.items() if f * highest < 4.0 / 3.0 * supply}
        name = max(reached, key=lambda u: reached[u], default="kPa")
        return name, _PRESSURES[name]
    hinge, moves = column.unit == "rad", column.unit in ("rad", "m")
    units = position_units(samples, hinge=hinge) if moves else {}
    units |= command_units(angle=False) if column.kind == "command" else {}
    ways = {"": 1.0, OPPOSITE: -1.0} | {f"in {name}": factor for name, factor in units.items()}
    ways |= {f"in {name}, {OPPOSITE}": -factor for name, factor in units.items()}
    found = next((way for way in ways.items() if fits(way[1] * samples, column, beyond)), None)
    return found if found and found[0] else None


def in_map(columns: str, factor: float) -> str:
    """Returns in words the entry of the column map that corrects columns (named in quotes)."""
    return f"if so, give {columns} factor = {factor:.8g} in the column map (--columns)"
