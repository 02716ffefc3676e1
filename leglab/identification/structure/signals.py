"""Preparation of signals: resampling, removal of unusable columns, NaN for missing samples."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leglab.base.errors import RecordingError, SettingsError
from leglab.base.recording import Recording
from leglab.identification.structure.fit import SHORTEST, Record

Array = NDArray[np.float64]
LEAST_SAMPLES = 100
# Share by which an interval between samples may deviate from a period or, in a gap, a multiple.
_JITTER = 0.05
# A sample more than _WILD interquartile ranges from the median is an outlier; a column in which the
# share of outliers exceeds _MOST_WILD is left out.
_WILD, _MOST_WILD = 1e4, 0.2
_SAME = 1e-3  # relative difference up to which two sampling periods count as equal
_LONGEST_GAP = 100_000  # maximum number of missing samples of a recording
# A longer period is recommended if the RMS change per sample, in standard deviations, is smaller.
_SLOW = 0.01


@dataclass(frozen=True)
class Signals:
    """Signals of all recordings.

    Attributes:
        records: One tuple of records per output; a record has the inputs in the order of `inputs`.
        inputs: Names of the columns that are used.
        outputs: Names of the columns to be modelled.
        period: Sampling period [s].
        notes: Messages about omitted, interpolated or doubtful data.
    """

    records: tuple[tuple[Record, ...], ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    period: float
    notes: tuple[str, ...]


def columns_of(
    recordings: Mapping[str, Recording], inputs: Sequence[str], outputs: Sequence[str]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Returns input and output columns: those named or, by default, `u...` and `y...`.

    Raises:
        SettingsError: A name is unknown or both input and output, or no column begins with u or y.
    """
    known = list(dict.fromkeys(c for r in recordings.values() for c in r.columns))
    for kind, names in (("input", inputs), ("output", outputs)):
        for name in names:
            if name not in known:
                raise SettingsError.unknown(kind, name, known)
    both = sorted(set(inputs) & set(outputs))
    if both:
        raise SettingsError(f"{both[0]!r} is input and output: give it once", given=both[0])
    rest = [c for c in known if c not in inputs and c not in outputs]
    guessed_in = tuple(inputs) or tuple(c for c in rest if c.lower().startswith("u"))
    guessed_out = tuple(outputs) or tuple(c for c in rest if c.lower().startswith("y"))
    for kind, names in (("input", guessed_in), ("output", guessed_out)):
        if not names:
            text = f"which column is the {kind}? Give --{kind}, one of "
            raise SettingsError(text, given=None, allowed=rest or known)
    return guessed_in, guessed_out


def signals_of(
    recordings: Mapping[str, Recording],
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    *,
    period: float | None = None,
    resting: bool = False,
) -> Signals:
    """Returns the signals of recordings, each on a uniform time axis.

    Args:
        recordings: Recordings by name.
        inputs: Names of input columns; see `columns_of`.
        outputs: Names of output columns.
        period: Period to resample to [s]; None takes the period of the first recording.
        resting: True accepts constant columns, which test data may have, and needs the names of
            all columns.

    Raises:
        RecordingError: A recording is too short or not uniformly sampled, lacks a column, or a
            required column holds no signal.
        SettingsError: As `columns_of`, or the period is no positive number.
    """
    if period is not None and not (np.isfinite(period) and period > 0):
        raise SettingsError(f"period is {period}; allowed: ", given=period, allowed="above 0")
    if not resting:
        inputs, outputs = columns_of(recordings, inputs, outputs)
    notes: list[str] = []
    usual = {name: _period(r) for name, r in recordings.items()}
    wanted = period or next(iter(usual.values()))
    tables = {}
    for name, recording in recordings.items():
        _check_recording(name, recording, (*inputs, *outputs))
        same = abs(usual[name] - wanted) <= _SAME * wanted
        uniform = _is_uniform(recording.time, wanted)
        tables[name] = (_on_grid if period is None or (same and uniform) else _resampled)(
            name, recording, (*inputs, *outputs), wanted, notes
        )
    used_in = tuple(c for c in inputs if _sound(c, tables, notes, resting))
    if not used_in:
        raise RecordingError("no input is left: " + "; ".join(notes), given=inputs)
    for output in outputs:
        reasons: list[str] = []
        if not _sound(output, tables, reasons, resting):
            raise RecordingError(f"output {reasons[0]}", given=output)
        notes += reasons
    records = tuple(
        tuple(r for name, table in tables.items() for r in _records(name, table, used_in, output))
        for output in outputs
    )
    for name, table in tables.items():
        _note_gaps(name, table, used_in, outputs, notes)
    notes += _note_copies(tables, used_in, outputs)
    for own in records:
        _check_sampling(own, wanted, notes)
    return Signals(records, used_in, tuple(outputs), wanted, tuple(notes))


def _check_recording(name: str, recording: Recording, columns: Sequence[str]) -> None:
    if len(recording) < LEAST_SAMPLES:
        text = f"{name}: {len(recording)} samples; needed are {LEAST_SAMPLES}"
        raise RecordingError(text, given=len(recording))
    for column in columns:
        if column not in recording:
            text = f"{name}: no column {column!r}, found "
            raise RecordingError(text, given=column, allowed=recording.columns)


def _period(recording: Recording) -> float:
    """Returns the sampling period [s]: the mean of intervals near the median interval."""
    steps = np.diff(recording.time)
    if not len(steps):
        return 1.0
    usual = float(np.median(steps))
    regular = steps[np.abs(steps - usual) <= _JITTER * usual]
    return float(f"{regular.mean():.9g}")


def _is_uniform(time: Array, period: float) -> bool:
    """Tests whether all intervals are multiples of a period, and not too many samples missing."""
    steps = np.diff(time) / period
    whole = np.maximum(np.round(steps), 1)
    few = whole.sum() <= _LONGEST_GAP + len(steps)
    return bool(few and np.all(np.abs(steps - whole) <= _JITTER * whole))


def _on_grid(
    name: str, recording: Recording, columns: Sequence[str], period: float, notes: list[str]
) -> dict[str, Array]:
    """Returns columns of a uniformly sampled recording, with NaN for its missing samples."""
    steps = np.diff(recording.time)
    if not _is_uniform(recording.time, period):
        text = f"{name}: sampled every {steps.min():.4g} to {steps.max():.4g} s, one period is "
        raise RecordingError(text + f"needed; --period {period:.4g} resamples it", given=name)
    whole = np.maximum(np.round(steps / period), 1)
    at = np.concatenate([[0], np.cumsum(whole)]).astype(int)
    missing = at[-1] + 1 - len(at)
    if missing:
        notes.append(f"{name}: {missing} rows are missing from the time axis")
    out = {}
    for column in columns:
        out[column] = np.full(at[-1] + 1, np.nan)
        out[column][at] = recording[column]
    return out


def _resampled(
    name: str, recording: Recording, columns: Sequence[str], period: float, notes: list[str]
) -> dict[str, Array]:
    """Interpolates columns linearly to a uniform time axis of the given period."""
    time = recording.time
    axis = np.arange(time[0], time[-1] + 0.5 * period, period)
    axis = axis[axis <= time[-1]]
    if len(axis) < LEAST_SAMPLES:
        text = f"{name}: {len(axis)} samples of {period:g} s; needed are {LEAST_SAMPLES}"
        raise RecordingError(text, given=period)
    notes.append(f"{name}: {len(time)} samples became {len(axis)} of {period:g} s")
    steps = np.diff(time)
    usual = max(float(np.median(steps)), period)
    between = steps[np.clip(np.searchsorted(time, axis) - 1, 0, len(steps) - 1)]
    out = {}
    for column in columns:
        good = np.isfinite(recording[column])
        if not good.any():
            out[column] = np.full(len(axis), np.nan)
            continue
        out[column] = np.interp(axis, time[good], recording[column][good])
        # Values interpolated across NaN, or over more than two periods, count as not measured.
        gap = np.interp(axis, time, (~good).astype(float)) > 0.5
        out[column][gap | (between > 2 * usual)] = np.nan
    return out


def _sound(
    column: str, tables: Mapping[str, dict[str, Array]], notes: list[str], resting: bool
) -> bool:
    """Tests whether a column is a usable signal; sets its outliers (see `_WILD`) to NaN."""
    values = np.concatenate([table[column] for table in tables.values()])
    finite = values[np.isfinite(values)]
    if len(finite) < len(values) / 2:
        notes.append(f"{column!r} is left out: {len(values) - len(finite)} samples are no numbers")
        return False
    low, middle, high = np.quantile(finite, (0.25, 0.5, 0.75))
    width = (high - low) or float(np.ptp(finite)) or 1.0
    wild = np.abs(values - middle) > _WILD * max(width, abs(middle) * 1e-6)
    usual = finite[~wild[np.isfinite(values)]]
    constant = not len(usual) or np.ptp(usual) <= 1e-9 * np.max(np.abs(usual))
    if constant and not resting:
        notes.append(f"{column!r} is left out: it is constant, {middle:.4g}")
        return False
    if wild.mean() > _MOST_WILD or np.max(np.abs(usual)) > 1e12:
        worst = float(np.max(np.abs(finite)))
        notes.append(f"{column!r} is left out: values of {worst:.3g} are no measurements")
        return False
    if wild.any():
        notes.append(f"{column!r}: {int(wild.sum())} wild samples count as missing")
        for table in tables.values():
            far = np.abs(table[column] - middle) > _WILD * max(width, abs(middle) * 1e-6)
            table[column] = np.where(far, np.nan, table[column])
    return True


def _records(
    name: str, table: Mapping[str, Array], inputs: Sequence[str], output: str
) -> list[Record]:
    """Splits one recording into records, where inputs are missing and straight lines do not do."""
    u, parts = _inputs(table, inputs)
    if len(parts) == 1:
        return [Record(u[parts[0]], table[output][parts[0]], name)]
    return [
        Record(u[part], table[output][part], f"{name}, part {k}") for k, part in enumerate(parts, 1)
    ]


def _inputs(table: Mapping[str, Array], inputs: Sequence[str]) -> tuple[Array, list[slice]]:
    """Returns the inputs with interpolated gaps, (N, M), and the samples that can be used.

    The free run is unknown from a missing input on, so a recording is split at a gap; but a gap is
    interpolated if straight lines over such gaps explain more than half of the input's variance,
    and all gaps are if parts of sufficient length would contain less than half of the samples.
    """
    u = np.column_stack([table[column] for column in inputs])
    known = np.ones(len(u), dtype=bool)
    for column in u.T:
        for a, b in _runs(~np.isfinite(column)):
            known[a:b] &= a > 0 and b < len(u) and _is_smooth(column, b - a)
    parts = [slice(a, b) for a, b in _runs(known) if b - a >= SHORTEST]
    if sum(part.stop - part.start for part in parts) < len(u) / 2:
        parts = [slice(0, len(u))]
    return _bridged(u), parts


def _runs(chosen: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Returns start and end of each sequence of chosen samples."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], chosen.astype(int), [0]])))
    return [(a, b) for a, b in edges.reshape(-1, 2).tolist()]


def _is_smooth(column: Array, gap: int) -> bool:
    """Tests whether straight lines over a gap explain more than half of a signal's variance."""
    half = (gap + 2) // 2  # from an end of the gap to its middle, where a line errs most
    middle = column[half:-half] if len(column) > 2 * half else column[:0]
    errors = middle - 0.5 * (column[: len(middle)] + column[2 * half :][: len(middle)])
    errors = errors[np.isfinite(errors)]
    return bool(len(errors)) and float(np.mean(errors**2)) < 0.5 * float(np.nanvar(column))


def _bridged(u: Array) -> Array:
    out, at = u.copy(), np.arange(len(u))
    for j in range(u.shape[1]):
        good = np.isfinite(u[:, j])
        if not good.all():
            out[:, j] = np.interp(at, at[good], u[good, j]) if good.any() else 0.0
    return out


def _note_gaps(
    name: str,
    table: Mapping[str, Array],
    inputs: Sequence[str],
    outputs: Sequence[str],
    notes: list[str],
) -> None:
    for column in outputs:
        if lost := int((~np.isfinite(table[column])).sum()):
            notes.append(f"{name}: {lost} samples of {column!r} are missing and left out")
    u = np.column_stack([table[column] for column in inputs])
    missing = np.asarray(~np.isfinite(u).all(axis=1))
    if missing.any():
        _, parts = _inputs(table, inputs)
        used = sum(part.stop - part.start for part in parts)
        bridged = sum(int(missing[part].sum()) for part in parts)
        text = f"{name}: inputs are missing in {missing.sum()} samples"
        text += f"; {bridged} of them are bridged by straight lines" * (bridged > 0)
        if used < len(u):
            text += f"; split into {len(parts)} parts, which hold {used} of {len(u)} samples"
        notes.append(text)
    for column in inputs:
        if len(np.unique(table[column][np.isfinite(table[column])])) == 2:
            notes.append(
                f"{name}: {column!r} takes two values only: how it acts between them, and "
                "beyond, cannot be seen"
            )


def _note_copies(
    tables: Mapping[str, dict[str, Array]], inputs: Sequence[str], outputs: Sequence[str]
) -> list[str]:
    return [
        f"{output!r} is the same numbers as input {name!r}"
        for output in outputs
        for name in inputs
        if all(np.array_equal(t[output], t[name], equal_nan=True) for t in tables.values())
    ]


def _check_sampling(records: Sequence[Record], period: float, notes: list[str]) -> None:
    moves = np.concatenate([np.diff(r.y) for r in records])
    spread = float(np.nanstd(np.concatenate([r.y for r in records])))
    share = float(np.sqrt(np.nanmean(moves**2))) / spread if spread > 0 else 0.0
    if 0 < share < _SLOW:
        better = period * _SLOW / share
        notes.append(
            f"the output moves by {100 * share:.2g} % of its spread a sample; "
            f"--period {better:.2g} would show more of its dynamics to as many lags"
        )
