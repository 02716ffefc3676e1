"""Detection of a table's time column by its name, its type, and its increase."""

import re
from collections.abc import Mapping

import numpy as np

from leglab.base.errors import RecordingError
from leglab.data.units_in_names import split

# Names of time columns of common loggers in several languages; X_Value is LabVIEW's, tout
# Simulink's.
_WORDS = re.compile(
    "time|t|tout|timestamps?|stamp|ts|clock|datetime|date|epoch|utc|elapsed|secs?|seconds|millis|micros|"
    "nanos|zeit|uhrzeit|zeitstempel|temps|tiempo|xvalue"
)
_WHOLE = re.compile(r"(.*?)[._/ ]*(sec|secs|seconds)", re.IGNORECASE)
_PARTS = dict.fromkeys(("nanosec", "nsec", "nsecs", "nanoseconds"), "ns")
_PARTS |= dict.fromkeys(("usec", "microseconds"), "us")
_SECOND = {"ns": 10**9, "us": 10**6}
# Largest share of a clock's rows that may step backwards.
_ODD = 0.01


def time_column(table: Mapping[str, np.ndarray]) -> tuple[str, np.ndarray | None, tuple[str, ...]]:
    """Finds the time of a table.

    It is the column `time`, possibly with a unit, else an increasing column with a similar name or,
    if there is none, with a time type. Whole seconds and their fraction, or a date and a time of
    day, in two columns are combined. A column that only counts rows is never taken.

    Returns:
        Name, samples, (n,), and names of the columns they come from; no time gives samples None.

    Raises:
        RecordingError: Two columns can be the time; names both.
    """
    choices = {name: (samples, (name,)) for name, samples in table.items()}
    for name, samples, parts in (*_split_seconds(table), *_dated(table)):
        choices = {n: choice for n, choice in choices.items() if n not in parts}
        choices[name] = samples, parts
    exact = [n for n in choices if n == "time"] or [n for n in choices if _plain(n) == "time"]
    found = exact if exact == ["time"] else [n for n in exact if _advances(choices[n][0])]
    found = found or [n for n in choices if _is_like(n) and _advances(choices[n][0])]
    found = found or [n for n, (x, _) in choices.items() if _is_typed(n, x) and _advances(x)]
    found = [name for name in found if len(found) == 1 or _is_even(choices[name][0])] or found
    if len(found) > 1:
        raise RecordingError(
            f"columns {' and '.join(map(repr, found))} can be the time; which one it is says a "
            f'column map by --columns FILE: "{found[0]}" = "time"',
            given=found[0],
            allowed=found,
        )
    return (found[0], *choices[found[0]]) if found else ("", None, ())


def _plain(name: str) -> str:
    return re.sub(r"\W|_", "", split(name).stem).lower()


def _is_like(name: str) -> bool:
    *_, last = ["", *re.findall(r"[a-z]+|[A-Z]+(?![a-z])|[A-Z][a-z]+", split(name).stem)]
    # "t" only as the whole name, or with its unit: `hip_t` is more likely a torque.
    words = (_plain(name), last.lower() if last.lower() != "t" else "")
    return any(map(_WORDS.fullmatch, words)) or split(f"t {name}").si == "s"


def _is_typed(name: str, samples: np.ndarray) -> bool:
    """Tests for a time type, or an unnamed index column of pandas with fractional values."""
    nameless = name == "" or name.startswith(("__index_level_", "Unnamed: "))
    fraction = samples.dtype.kind == "f" and bool((samples != np.rint(samples)).any())
    return samples.dtype.kind in "Mm" or (nameless and fraction)


def _forward(samples: np.ndarray) -> np.ndarray:
    known = samples[np.isfinite(samples)]
    known = known.astype(np.int64) if known.dtype.kind in "Mm" else known
    return np.diff(known) if known.dtype.kind != "b" else np.empty(0)


def _advances(samples: np.ndarray) -> bool:
    """Tests whether samples increase; a short float may also stand still due to its rounding."""
    steps = _forward(samples)
    short = samples.dtype.kind == "f" and samples.dtype.itemsize < 8
    return steps.size > 0 and bool((steps >= 0).mean() > 1 - _ODD and (short or (steps > 0).any()))


def _is_even(samples: np.ndarray) -> bool:
    steps = _forward(samples).astype(np.float64)
    usual = np.median(steps[steps > 0]) if (steps > 0).any() else 0.0
    return bool((np.abs(steps - usual) <= 0.5 * usual).mean() > 0.5)


def _split_seconds(table: Mapping[str, np.ndarray]) -> list[tuple[str, np.ndarray, tuple]]:
    """Combines whole seconds and their fraction in two columns, as in ROS, to datetime64."""
    found = []
    counts = {name: x for name, x in table.items() if x.dtype.kind in "if" and x.size}
    counts = {name: x for name, x in counts.items() if x.min() >= 0}
    for name, whole in counts.items():
        match = _WHOLE.fullmatch(name)
        if not match or not whole.max() < 2**33:  # ns up to the year 2242 are an int64
            continue
        for other, part in counts.items():
            unit = _PARTS.get(other[match.start(2) :].lower(), "")
            if unit and other.startswith(match[1]) and part.max() < _SECOND[unit]:
                ticks = whole.astype(np.int64) * _SECOND[unit] + part.astype(np.int64)
                stem = match[1] or f"{name} and {other}"
                found.append((stem, ticks.view(f"M8[{unit}]"), (name, other)))
    return found


def _dated(table: Mapping[str, np.ndarray]) -> list[tuple[str, np.ndarray, tuple]]:
    """Combines a date and a time of day in two columns to datetime64."""
    stamps = {n: x for n, x in table.items() if x.dtype.kind == "M" and x.size}
    dates = [n for n, x in stamps.items() if (x.astype("M8[D]") == x).all()]
    times = [n for n, x in table.items() if x.dtype.kind == "m" and "day" not in n.lower()]
    if len(dates) != 1 or len(times) != 1:
        return []
    (date,), (time,) = dates, times
    day = np.timedelta64(1, "D").astype("m8[ns]")
    both = table[date].astype("M8[ns]") + table[time].astype("m8[ns]") % day
    return [(f"{date} and {time}", both, (date, time))]
