"""Units and directions in which loggers write signals, as factors that turn them into ours."""

from collections.abc import Mapping

import numpy as np

from leglab.data.units_in_names import split

# Factors differ from 1 by ten times or more: smaller ones are effects (gain, encoder scale).
_ANGLES, _LENGTHS, _PRESSURES = (
    {unit: split(f"x [{unit}]").factor for unit in units.split()}
    for units in ("degrees mrad turns", "mm inches micrometres", "bar MPa psi kPa")
)
_SHARES = {"per cent": 1e-2, "mA, mV or thousandths": 1e-3}
_LARGE = {"thousands of its unit": 1e3, "hundreds of its unit": 1e2}
OPPOSITE = "counted the other way"
DEGREES = ("degrees", _ANGLES["degrees"])
# Counts of encoders in a turn: others lie near enough to ask.
_COUNTS = [2.0**n for n in range(8, 25)]


def position_units(samples: np.ndarray, *, hinge: bool) -> dict[str, float]:
    """Factors that may turn a position, (n,), into rad of a `hinge` or m, by unit."""
    known = samples[np.isfinite(samples)]
    found = dict(_ANGLES if hinge else _LENGTHS)
    if hinge and known.size and np.all(known == np.rint(known)):
        turns = {f"counts, some {n:.0f} a turn": 2.0 * np.pi / n for n in _COUNTS}
        # Other resolutions would make the motion smaller than a degree or longer than eight turns.
        found |= {unit: f for unit, f in turns.items() if 0.02 < f * np.ptp(known) < 50.0}
    return found


def command_units(*, angle: bool) -> dict[str, float]:
    """Factors that may turn a command into the model's, by unit; `angle` of servos of hinges."""
    return {**_SHARES, **_LARGE, **({"degrees": _ANGLES["degrees"]} if angle else {})}


def pressure_unit(highest: float, supply: float) -> tuple[str, float] | None:
    """Unit of pressures that reach a `highest` value, and its factor, if they are hardly in Pa.

    A chamber that moves something reaches more than a hundredth of the `supply` [Pa], and kPa are a
    thousandth of Pa. Of the units the one counts that comes nearest to the supply without passing
    it by more than a third, as shocks do.
    """
    if not 0.0 < highest < 0.01 * supply:
        return None
    fitting = {u: f for u, f in _PRESSURES.items() if highest * f < 4.0 / 3.0 * supply}
    name = max(fitting, key=lambda u: fitting[u], default="kPa")
    return name, _PRESSURES[name]


def within(
    units: Mapping[str, float], values: tuple[float, float], room: tuple[float, float]
) -> tuple[str, float] | None:
    """In which unit, and by which factor, lowest and highest value lie within a room first.

    In words; counted the other way, in another unit, or both.
    """
    ways = {OPPOSITE: -1.0} | {f"in {name}": factor for name, factor in units.items()}
    ways |= {f"in {name}, {OPPOSITE}": -factor for name, factor in units.items()}
    for words, factor in ways.items():
        low, high = sorted(factor * value for value in values)
        if room[0] < low and high < room[1]:
            return words, factor
    return None


def in_map(columns: str, factor: float) -> str:
    """Returns the entry of the column map for columns in quotes."""
    return f"if so, give {columns} factor = {factor:.8g} in the column map (--columns)"
