"""Units and directions in which loggers write signals, as factors that convert to the model's."""

import numpy as np

from leglab.data.units_in_names import split
from leglab.diagnosis.plant.columns import UsableColumn
from leglab.diagnosis.plant.model import CHAMBERS
from leglab.diagnosis.thresholds import DEFAULT

# Factors of ten or more, or a tenth or less: those nearer to 1 are effects (gain, encoder scale).
ANGLES, _LENGTHS, _PRESSURES = (
    {unit: split(f"x [{unit}]").factor for unit in units.split()}
    for units in ("degrees mrad turns", "mm inches micrometres", "bar MPa psi kPa")
)
_SHARES = {"per cent": 1e-2, "mA, mV or thousandths": 1e-3}
_LARGE = {"thousands of its unit": 1e3, "hundreds of its unit": 1e2}
OPPOSITE = "counted the other way"
DEGREES = ("degrees", ANGLES["degrees"])
# Encoder counts per turn: other resolutions are near enough to one of these to raise the question.
_COUNTS = [2.0**n for n in range(8, 25)]


def position_units(samples: np.ndarray, *, hinge: bool) -> dict[str, float]:
    """Returns factors that may convert a position, (n,), to rad (of a `hinge`) or m, by unit."""
    known = samples[np.isfinite(samples)]
    found = dict(ANGLES if hinge else _LENGTHS)
    if hinge and known.size and np.all(known == np.rint(known)):
        turns = {f"counts, some {n:.0f} a turn": 2.0 * np.pi / n for n in _COUNTS}
        # With other resolutions the motion would be below a degree or above eight turns.
        found |= {unit: f for unit, f in turns.items() if 0.02 < f * np.ptp(known) < 50.0}
    return found


def command_units(*, angle: bool) -> dict[str, float]:
    """Returns factors that may convert a command to the model's, by unit; `angle`: hinge servo."""
    return {**_SHARES, **_LARGE, **({"degrees": ANGLES["degrees"]} if angle else {})}


def fits(samples: np.ndarray, column: UsableColumn, beyond: float = DEFAULT.beyond_range) -> bool:
    """Tests whether samples, (n,), NaN where missing, lie within a column's limits.

    They may exceed the limits by the share `beyond` of the limits' range.
    """
    room = beyond * (column.limits[1] - column.limits[0])
    below = np.nanmin(samples) < column.limits[0] - room
    return not (below or np.nanmax(samples) > column.limits[1] + room)


def other_unit(
    samples: np.ndarray, column: UsableColumn, beyond: float = DEFAULT.beyond_range
) -> tuple[str, float] | None:
    """Returns a unit or direction in which samples, (n,), fit a column's limits, and its factor.

    Pressures are doubted if none reaches a hundredth of the supply [Pa], since a chamber that moves
    something exceeds this; their unit is the one that comes nearest to the supply without exceeding
    it by more than a third, as shocks do. For other columns it is the first that fits of: the other
    direction, another unit, both. None if the samples fit unchanged, or nothing fits.
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
    """Returns the entry of the column map for columns in quotes."""
    return f"if so, give {columns} factor = {factor:.8g} in the column map (--columns)"
