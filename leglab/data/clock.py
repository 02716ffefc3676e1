"""Time axis of a table: unit, start, and resolution of the stamps."""

from collections.abc import Mapping
from fractions import Fraction

import numpy as np

from leglab.base.errors import LeglabError, RecordingError
from leglab.data.column_map import ColumnRule
from leglab.data.files import LeftOut
from leglab.data.time_column import time_column
from leglab.data.units_in_names import split

_SECOND = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
# Plausible rates of a log [Hz], with a margin for drift: `_LEAST`, as slower logs miss motion, to
# `_MOST`, as no drive is faster. `_LEAST_OF_FRACTIONS`: rate [Hz] above which stamps with fractions
# are seconds.
_LEAST, _MOST, _LEAST_OF_FRACTIONS = 9.5, 21e3, 0.95
# Stamps in `_EPOCH` [s], 2000 to 2100, count from 1970 if their rate is at least 0.1 Hz.
_EPOCH, _LEAST_OF_EPOCH = (946_684_800, 4_102_444_800), 0.1
# Largest time [s], 104 days, at which seconds in a float64 resolve nanoseconds. Stamps since 1970
# are larger, so such recordings begin at 0 s and their start is kept in the metadata.
LAST_EXACT = 2**53 / 1e9
# Allowed relative error of the period of rounded stamps: so small that a window of the diagnosis (a
# few hundred rows) shifts by less than a row.
_KNOWN = 1e-3


class Timed(dict[str, np.ndarray]):
    """Columns of a format that defines `time` in seconds."""


def time_axis(
    table: Mapping[str, np.ndarray],
    metadata: Mapping[str, object],
    left_out: LeftOut,
    *,
    source: str = "",
    given: tuple[str, ColumnRule] | None = None,
    timed: bool = False,
) -> tuple[dict[str, np.ndarray], dict]:
    """Converts the time of a table to seconds; used for the raw columns of all formats.

    Readers pass columns as they are stored: integers, floats of any size, Booleans, datetime64,
    timedelta64; time of an absolute clock as datetime64, so that no digit is lost.

    Args:
        table: Arrays of shape (n,) by column name.
        metadata: Metadata of the file.
        left_out: Gets "time" if the time column cannot be used.
        source: Origin of the table, for messages.
        given: Original name and rule of the table's "time" if a column map names it.
        timed: Whether the format defines `time` in seconds.

    Returns:
        Arrays of float64 by column name, "time" [s] first if there is one; and the metadata. If
        time was shifted to begin at 0, `start_ns` holds its start in ns since 1970; unless they are
        obvious, "time" holds a remark on the column and the unit used.

    Raises:
        LeglabError: Two columns or two units are possible; the time does not resolve the rows.
    """
    table = {n: x.astype(np.int64) if x.dtype.kind in "iu" else x for n, x in table.items()}
    rest = {name: samples for name, samples in table.items() if name != "time"}
    start, said = 0, ""
    parts: tuple[str, ...] = ("time",)
    try:
        name, raw = given[0] if given else "time", table.get("time")
        if raw is None or not (given or timed):
            name, raw, parts = time_column(table)
        if raw is not None:
            others = {n: samples for n, samples in table.items() if n not in parts}
            rule = given[1] if given else None
            time, start, said = _in_seconds(name, raw, rule, _moved(others), timed=timed)
            rest = {"time": time, **others}
    except LeglabError as error:
        left_out.add("time", error.at(source))
    notes = {key: note for key, note in (("start_ns", start), ("time", said)) if note}
    return {n: _floats(samples, start) for n, samples in rest.items()}, {**metadata, **notes}


def _in_seconds(
    name: str, raw: np.ndarray, rule: ColumnRule | None, moved: np.ndarray, *, timed: bool
) -> tuple[np.ndarray, int, str]:
    """Returns time [s], the start [ns since 1970] that was subtracted or 0, and a remark."""
    offset = rule.offset if rule else 0.0
    if timed:
        time = raw.astype(np.float64)
        return (rule.factor * time + offset if rule else time), 0, ""
    missing, stored = ~np.isfinite(raw), raw.dtype.kind
    if stored in "Mm":
        unit, raw = np.datetime_data(raw.dtype)[0], raw.astype(np.int64)
        seconds = float(np.ones((), f"m8[{unit}]") / np.timedelta64(1, "s"))
    elif rule and "factor" in rule.model_fields_set:
        unit, seconds = f"steps of {rule.factor:g} s", rule.factor
    else:
        unit, seconds = _unit(name, raw)
    # The exact fraction that was meant, not the binary value of the float: 1e-3 is 1/1000.
    factor = Fraction(seconds).limit_denominator(10**12) or Fraction(seconds)
    plain, known = stored not in "Mm" and name == "time" and unit == "s", raw[~missing]
    if not known.size:
        return np.full(raw.size, np.nan), 0, ""
    far = abs(float(known[np.argmax(np.abs(known.astype(np.float64)))])) * float(factor)
    # A time of day, stored as the time since midnight, is shifted to begin at 0 as well.
    first = known.min() if far > LAST_EXACT or stored == "m" else known.dtype.type(0)
    time = raw - first if raw.dtype.kind != "f" else raw.astype(np.float64) - float(first)
    scale = 1 / factor
    time = time / float(scale) if scale.denominator == 1 else time * float(factor)
    time = np.where(missing & (raw.dtype.kind == "i"), np.nan, time + offset if offset else time)
    time, rounding = _straight(name, raw, time, float(factor), moved)
    start = int(Fraction(first.item()) * factor * 10**9) if stored != "m" else 0
    rate = 1.0 / step if (step := usual_step(time)) else 0.0
    plausible = not rate or (_LEAST_OF_FRACTIONS if plain else _LEAST) <= rate <= _MOST
    said = f"{name} in {unit} since {'1970' if start else 'the start'}, {rate:.6g} Hz{rounding}"
    said += "" if plausible or stored in "Mm" else ": is this its unit?"
    return time, start, "" if plain and not start and not rounding and plausible else said


def _unit(name: str, raw: np.ndarray) -> tuple[str, float]:
    """Returns the unit in the name, else the unit with a plausible rate, and its value in s."""
    named = split(f"t {name}") if split(name).si != "s" else split(name)
    if named.si == "s":
        return named.unit, named.factor
    known = raw[np.isfinite(raw)]
    step = usual_step(known - known[0]) if known.size else 0.0
    if not step:
        return "s", 1.0
    rates = {unit: 1.0 / (step * seconds) for unit, seconds in _SECOND.items()}
    starts = {unit: float(known[0]) * seconds for unit, seconds in _SECOND.items()}
    early = [unit for unit, start in starts.items() if start <= _EPOCH[1]]
    fraction = "s" in early and bool((known != np.rint(known)).any())
    epoch = [unit for unit in early if starts[unit] >= _EPOCH[0]]
    if raw.dtype != np.float32:  # The rounding of float32 hides the rate.
        epoch = [unit for unit in epoch if rates[unit] >= _LEAST_OF_EPOCH]
    fits = [unit for unit in early if _LEAST <= rates[unit] <= _MOST]
    fits = [unit for unit in fits if unit in epoch] or list(dict.fromkeys(fits + epoch))
    if fraction and rates["s"] >= _LEAST_OF_FRACTIONS:
        fits = ["s"]
    elif epoch and raw.dtype == np.float32:
        fits = epoch[:1]
    elif not fits and name == "time" and "s" in early:
        fits = ["s"]
    if len(fits) == 1:
        return fits[0], _SECOND[fits[0]]
    each = ", ".join(f"in {unit} {rates[unit]:.6g} Hz" for unit in fits or _SECOND)
    raise RecordingError(
        f"column {name!r} is the time, in steps of {step:g}: {each}; which unit it is says a "
        f'column map by --columns FILE, for ms: "{name}" = {{name = "time", factor = 1e-3}}',
        given=name,
    )


def _straight(
    name: str, raw: np.ndarray, time: np.ndarray, factor: float, moved: np.ndarray
) -> tuple[np.ndarray, str]:
    """Replaces stamps of an even clock by a straight line if their rounding hides the rate.

    `moved`, (n - 1,), is true where another column differs from its value in the row before.
    """
    short, steps = raw.dtype.kind == "f" and raw.dtype.itemsize < 8, np.diff(time)
    if time.size < 3 or not np.isfinite(time).all():
        return time, ""
    largest = float(np.abs(raw.astype(np.float64)).max())
    mean = float(time[-1] - time[0]) / (time.size - 1)
    resolved = factor * float(np.spacing(raw.dtype.type(largest))) if short else factor
    if raw.dtype.kind == "f" and not short:
        resolved = float(steps[steps > 0].min(initial=np.inf))
    repeats = bool(((steps == 0) & moved).any())
    if not repeats and (not short or resolved <= _KNOWN * mean):
        return time, ""
    line = straight_line(np.arange(time.size), time)
    period = float(line[1] - line[0])
    text = f"float{8 * raw.dtype.itemsize}" if short else "it"
    text += f" resolves {resolved:.3g} s at {largest:.3g}"
    # A true time is at most half a step from its stamp, and slightly more from the fitted line.
    even = np.abs(time - line).max() <= 0.75 * resolved
    if even and 0 < resolved / np.sqrt(time.size) <= _KNOWN * period * time.size:
        return line, f" ({text}; the rows are even: straightened)"
    if raw.dtype.kind == "i":
        resolved = factor * float(np.gcd.reduce(np.diff(raw))) or np.inf
    if not short:
        text = f"its steps are {resolved:.3g} s" if resolved < np.inf else "it stands"
    # `inspect` reports a few repeated rows one by one.
    if repeats and (short or resolved > 2.0 * mean):
        text = f"column {name!r} is the time, and {text}: no use; log "
        finer = "float64, or time since the start" if short else "more digits or a finer unit"
        raise RecordingError(text, given=name, allowed=finer)
    return time, f" ({text})" if short else ""


def straight_line(ticks: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Fits a straight line to times over tick numbers and returns it at the ticks; all (n,)."""
    centred = ticks - ticks.mean()
    slope, level = np.polyfit(centred, time - time[0], 1)
    return time[0] + level + slope * centred


def usual_step(time: np.ndarray) -> float:
    """Returns the usual forward step of stamps, (n,), with rounding averaged out; 0 if none."""
    forward = np.diff(time)
    forward = forward[forward > 0]
    if not forward.size:
        return 0.0
    median = np.sort(forward)[forward.size // 2]
    return float(forward[np.abs(forward - median) <= 0.5 * median].mean())


def _moved(table: Mapping[str, np.ndarray]) -> np.ndarray:
    """Tests which rows differ from the row before, (n - 1,)."""
    changes = [(x[1:] != x[:-1]) & ((x == x)[1:] | (x == x)[:-1]) for x in table.values()]
    equal = len({change.shape for change in changes}) == 1
    return np.any(changes, axis=0) if equal else np.zeros(1, dtype=bool)


def _floats(samples: np.ndarray, start: int) -> np.ndarray:
    """Converts a column to float64; times become seconds since the recording's start."""
    if samples.dtype.kind not in "Mm":
        return samples.astype(np.float64)
    ticks = samples.astype(f"{samples.dtype.kind}8[ns]")
    since = start if samples.dtype.kind == "M" else 0
    return np.where(np.isnat(ticks), np.nan, (ticks.astype(np.int64) - since) / 1e9)
