"""Units that stand in the names of columns: `angle [deg]`, `stamp_ms`, `torque_Nm`, `p (bar)`."""

import math
import re
from typing import NamedTuple


class NamedUnit(NamedTuple):
    """A column's name and the unit that stands in it."""

    stem: str  #: The name without the unit, as it is where there is none
    unit: str  #: The unit as the name has it; "" where there is none
    factor: float  #: SI units per unit; 1 where there is none
    #: s, rad, m, rad/s, m/s^2, N m, N, Pa, degC, A, V or 1: the kind of quantity; "" where none.
    si: str


_TURN = 2.0 * math.pi
# Factor and SI unit by spelling, in lower case; what differs in case alone follows below.
_KNOWN: dict[str, tuple[float, str]] = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), (1.0, "s")),
    **dict.fromkeys(("ms", "msec", "millis", "millisecond", "milliseconds"), (1e-3, "s")),
    **dict.fromkeys(("us", "usec", "µs", "μs", "micros", "microseconds"), (1e-6, "s")),
    **dict.fromkeys(("ns", "nsec", "nanos", "nanosec", "nanosecond", "nanoseconds"), (1e-9, "s")),
    **dict.fromkeys(("min", "minutes"), (60.0, "s")),
    **dict.fromkeys(("h", "hours"), (3600.0, "s")),
    **dict.fromkeys(("rad", "radian", "radians"), (1.0, "rad")),
    **dict.fromkeys(("deg", "°", "degree", "degrees"), (math.radians(1.0), "rad")),
    **dict.fromkeys(("turn", "turns", "rev", "revs", "revolutions"), (_TURN, "rad")),
    "mrad": (1e-3, "rad"),
    **dict.fromkeys(("rpm", "rev/min", "1/min", "u/min", "min-1"), (_TURN / 60.0, "rad/s")),
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), (1.0, "m")),
    "cm": (1e-2, "m"),
    "mm": (1e-3, "m"),
    **dict.fromkeys(("um", "µm", "μm"), (1e-6, "m")),
    **dict.fromkeys(("nm", "n m", "n*m", "n.m", "n·m", "newtonmeter"), (1.0, "N m")),
    **dict.fromkeys(("knm", "kn m"), (1e3, "N m")),
    **dict.fromkeys(("n", "newton", "newtons"), (1.0, "N")),
    "kn": (1e3, "N"),
    **dict.fromkeys(("pa", "pascal"), (1.0, "Pa")),
    "kpa": (1e3, "Pa"),
    "bar": (1e5, "Pa"),
    "mbar": (1e2, "Pa"),
    "psi": (6894.757293168361, "Pa"),
    **dict.fromkeys(("degc", "°c", "celsius"), (1.0, "degC")),
    **dict.fromkeys(("a", "amp", "amps", "ampere"), (1.0, "A")),
    "ma": (1e-3, "A"),
    **dict.fromkeys(("v", "volt", "volts"), (1.0, "V")),
    "mv": (1e-3, "V"),
    **dict.fromkeys(("%", "pct", "percent"), (1e-2, "1")),
}
# 1e6 and 1e-3 differ in case alone; nobody measures a machine in mPa or mN m.
_KNOWN |= {"mpa": (1e6, "Pa"), "mnm": (1e-3, "N m"), "mn": (1e-3, "N"), "-": (1.0, "1")}
for _spelling, (_factor, _si) in list(_KNOWN.items()):
    if _si in ("rad", "m"):  # ... a second, and a second squared
        for _end in ("/s", "_s", "_per_s", "_per_sec", "ps", "/sec", "s^-1"):
            _KNOWN.setdefault(_spelling + _end, (_factor, f"{_si}/s"))
        for _end in ("/s^2", "/s2", "/s²", "_s2", "_per_s2"):
            _KNOWN.setdefault(_spelling + _end, (_factor, f"{_si}/s^2"))
# At the end of a name these are rather a port, an axis or a word than a unit.
_NO_ENDING = frozenset(("a", "v", "n", "h", "-", "min", "rev", "m", "turn", "ma", "mn"))
_BRACKETS = re.compile(r"\s*(?:\[([^\[\]]*)\]|\(([^()]*)\)|\{([^{}]*)\}|<([^<>]*)>)\s*$")
# Not "A", which is a port.
_CAPITAL_ENDINGS = frozenset(("V", "N", "mA", "kN"))


def split(name: str) -> NamedUnit:
    """Splits a column's name into stem and unit.

    A unit stands in brackets at the end, after a slash or a comma, or after the last `_`, `-`, `.`
    or blank. An index such as `[0]` is no unit.

    Args:
        name: As the file has it.

    Returns:
        Stem, unit, factor and SI unit.
    """
    match = _BRACKETS.search(name)
    if match:
        unit = next((group for group in match.groups() if group is not None), "").strip()
        return _named(name, name[: match.start()], unit)
    # The longest ending first: `speed_rad_s`, not `s`.
    for place in re.finditer(r"(?:\s*[,/]\s*|[_\-. ]+)(?=[^,])|(?<=[a-z])(?=[A-Z][a-z])", name):
        unit, stem = name[place.end() :].strip(), name[: place.start()].strip()
        lower = unit.lower()
        if stem and (lower not in _NO_ENDING or unit in _CAPITAL_ENDINGS):
            found = _named(name, stem, unit)
            if found.unit:
                return found
    return NamedUnit(name, "", 1.0, "")


def _named(name: str, stem: str, unit: str) -> NamedUnit:
    known = _KNOWN.get(unit.lower().replace("**", "^"))
    if known is None or not stem.strip():
        return NamedUnit(name, "", 1.0, "")
    return NamedUnit(stem.strip(), unit, *known)
