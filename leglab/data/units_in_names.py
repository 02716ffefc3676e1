"""Units in the names of columns: `angle [deg]`, `stamp_ms`, `torque_Nm`, `p (bar)`."""

import re
from typing import NamedTuple


class NamedUnit(NamedTuple):
    """A column's name, split into stem and unit."""

    stem: str  #: The name without the unit; the whole name if it has no unit
    unit: str  #: The unit as spelled in the name; "" if there is none
    factor: float  #: SI units per unit; 1 if there is none
    #: SI unit of the quantity: s, rad, m, rad/s, m/s^2, N m, N, Pa, degC, A, V or 1; "" if none.
    si: str


# By SI unit: factors, each followed by its unit's spellings in lower case, with "~" for a blank.
_TABLE = {
    "s": "1 s sec secs second seconds|1e-3 ms msec millis millisecond milliseconds|60 min minutes|"
    "1e-6 us usec µs μs micros microseconds|1e-9 ns nsec nanos nanosec nanosecond nanoseconds|"
    "3600 h hours",
    "rad": "1 rad radian radians|1e-3 mrad|0.017453292519943295 deg ° degree degrees|"
    "6.283185307179586 turn turns rev revs revolutions",
    "rad/s": "0.10471975511965977 rpm rev/min 1/min u/min min-1",
    "m": "1 m meter meters metre metres|1e-2 cm|1e-3 mm|1e-6 um µm μm "
    "micrometres|0.0254 inch inches",
    "N m": "1 nm n~m n*m n.m n·m newtonmeter|1e3 knm kn~m|1e-3 mnm",
    "N": "1 n newton newtons|1e3 kn|1e-3 mn",
    # "mpa" is MPa, because nobody measures machines in mPa.
    "Pa": "1 pa pascal|1e3 kpa|1e6 mpa|1e5 bar|1e2 mbar|6894.757293168361 psi",
    "degC": "1 degc °c celsius",
    "A": "1 a amp amps ampere|1e-3 ma",
    "V": "1 v volt volts|1e-3 mv",
    "1": "1 -|1e-2 % pct percent",
}
_KNOWN: dict[str, tuple[float, str]] = {}
for _si, _line in _TABLE.items():
    for _factor, *_spellings in map(str.split, _line.split("|")):
        _KNOWN |= {word.replace("~", " "): (float(_factor), _si) for word in _spellings}
for _word, (_each, _si) in list(_KNOWN.items()):
    if _si in ("rad", "m"):  # also per second and per second squared
        for _end in ("/s", "_s", "_per_s", "_per_sec", "ps", "/sec", "s^-1"):
            _KNOWN.setdefault(_word + _end, (_each, f"{_si}/s"))
        for _end in ("/s^2", "/s2", "/s²", "_s2", "_per_s2"):
            _KNOWN.setdefault(_word + _end, (_each, f"{_si}/s^2"))
# Endings of names that more likely denote a port, an axis or a word than a unit.
_NO_ENDING = frozenset(("a", "v", "n", "h", "-", "min", "rev", "m", "turn", "ma", "mn"))
_BRACKETS = re.compile(r"\s*(?:\[([^\[\]]*)\]|\(([^()]*)\)|\{([^{}]*)\}|<([^<>]*)>)\s*$")
_CAPITAL_ENDINGS = frozenset(("V", "N", "mA", "kN"))  # not "A", which is a valve port


def split(name: str) -> NamedUnit:
    """Splits a column's name into stem and unit.

    A unit is in brackets at the end, or follows a slash, a comma, or one of `_`, `-`, `.` and
    blank. An index such as `[0]` is no unit.
    """
    if match := _BRACKETS.search(name):
        return _named(name, name[: match.start()], match[match.lastindex or 0].strip())
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
