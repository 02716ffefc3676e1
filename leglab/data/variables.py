"""Variables of a workspace (MATLAB, NumPy) as columns: vectors, matrices, series with a clock.

A series is a struct with `time` (or `Time`) and values: Simulink's "structure with time"
(To Workspace, Scope), or a timeseries as a struct. Forms: docs/reference/data_formats.md.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from leglab.base.errors import RecordingError
from leglab.data.alignment import TopicSeries, on_clock
from leglab.data.clock import Timed
from leglab.data.column_map import ColumnMap
from leglab.data.files import LeftOut

_TIMES, _VALUES = ("time", "Time"), ("values", "Values", "data", "Data")
_PLAIN_TIMES = ("time", "tout", "t")
_PERIODS = ("Ts", "ts", "dt", "sampling_time")  # names of a sampling period [s]


def table_of(
    variables: Mapping[str, Any], left_out: LeftOut, columns: ColumnMap | None
) -> tuple[dict[str, np.ndarray], dict]:
    """Converts variables to columns on one clock.

    Series with the same clock keep their samples. With several clocks, series are resampled to the
    clock with the most samples: commands (`..._command`) by zero-order hold, the others linearly.

    Args:
        variables: Variables by name.
        left_out: Gets duplicate columns and columns of a different length.
        columns: Map to the names that identify commands; None: the variables' names do.

    Returns:
        The columns, and metadata: `left_out`, and `period` [s] if a number `Ts` or `dt` gives it.

    Raises:
        RecordingError: Lengths differ, or a series' time does not fit its values.
    """
    structs = [value for value in variables.values() if isinstance(value, dict)]
    if len(variables) == len(structs) == 1 and not _is_series(structs[0]):
        variables = structs[0]
    series = [one for n, v in variables.items() if _is_series(v) for one in _signals(n, v)]
    samples = {n: np.asarray(v) for n, v in variables.items() if _is_samples(v)}
    others = {n for n, v in variables.items() if not _is_series(v)} - samples.keys()
    if not series:
        metadata: dict[str, Any] = {"left_out": sorted(others)} if others else {}
        periods = [float(variables[n]) for n in _PERIODS if _is_number(variables.get(n))]
        metadata |= {"period": periods[0]} if periods and periods[0] > 0 else {}
        return _vectors(samples, left_out), metadata
    time = next((samples.pop(t) for t in _PLAIN_TIMES if t in samples), np.empty(0)).ravel()
    beside = {n: x for n, x in samples.items() if time.size in x.shape}
    series += [(n, time, dict(elements(n, x, time.size))) for n, x in beside.items()]
    others |= samples.keys() - beside.keys()
    topics = [TopicSeries(n, np.rint(t * 1e9).astype(np.int64), x) for n, t, x in series]
    most = int(np.argmax([topic.stamps.size for topic in topics]))
    clock = replace(topics[most], columns={"time": series[most][1]})
    table, notes = on_clock(topics, clock, columns or ColumnMap(), left_out)
    metadata = {"left_out": sorted(others), "alignment": notes}
    return Timed(table), {key: told for key, told in metadata.items() if told}


def check_lengths(table: dict[str, np.ndarray], left_out: LeftOut) -> None:
    """Leaves out columns whose length differs from the length of `time`.

    Raises:
        RecordingError: Lengths differ, and nothing may be left out or there is no `time`.
    """
    first = "time" if "time" in table else next(iter(table), "")
    for name in [name for name in table if len(table[name]) != len(table[first])]:
        found = f"{first!r} {len(table[first])}, {name!r} {len(table[name])}"
        error = RecordingError(f"vectors have different lengths: {found}", given=name)
        if first != "time":
            raise error
        left_out.add(name, error)
        del table[name]


def _is_series(value: Any) -> bool:
    timed = isinstance(value, Mapping) and any(_is_samples(value.get(t)) for t in _TIMES)
    return timed and not {"signals", *_VALUES}.isdisjoint(value)


def _signals(
    name: str, value: Mapping[str, Any]
) -> Iterator[tuple[str, np.ndarray, dict[str, np.ndarray]]]:
    """Yields name, time [s] and columns of each signal of a struct."""
    time = np.ravel(next(value[t] for t in _TIMES if t in value)).astype(np.float64)
    if not np.isfinite(time).all():
        row = int(np.argmin(np.isfinite(time)))
        raise RecordingError(f"{name!r}, row {row}: {time[row]} is not a finite time", given=name)
    signals = np.atleast_1d(value.get("signals", value))
    for index, signal in enumerate(signals):
        label = signal.get("label")
        place = f"/{label}" if isinstance(label, str) and label else f"[{index}]"
        owner = name + place * (len(signals) > 1)
        values = np.asarray(next((signal[v] for v in _VALUES if v in signal), None))
        if values.dtype.kind not in "fiub" or time.size not in values.shape[:1] + values.shape[-1:]:
            text = f"{owner!r}: values of shape {values.shape} for {time.size} times; allowed: "
            raise RecordingError(text, given=owner, allowed="numbers, one row a time")
        yield owner, time, dict(elements(owner, values, time.size))


def elements(name: str, values: np.ndarray, rows: int) -> Iterator[tuple[str, np.ndarray]]:
    """Yields names and columns of samples; their first or last axis is time, of length `rows`."""
    if values.shape[-1] == rows and (values.shape[0] != rows or values.ndim > 2):
        values = np.moveaxis(values, -1, 0)  # Simulink puts time last where samples are matrices.
    flat = values.reshape(len(values), -1)
    for index, column in enumerate(flat.T):
        yield (name if flat.shape[1] == 1 else f"{name}[{index}]"), column


def _vectors(samples: Mapping[str, np.ndarray], left_out: LeftOut) -> dict[str, np.ndarray]:
    rows = max((len(array) for array in samples.values()), default=0)
    table: dict[str, np.ndarray] = {}
    for name, array in samples.items():
        for key, column in elements(name, array, rows):
            if key in table:
                left_out.add(key, RecordingError(f"two variables give column {key!r}", given=key))
            table[key] = column
    table = {key: column for key, column in table.items() if key not in left_out}
    check_lengths(table, left_out)
    return table


def _is_number(value: Any) -> bool:
    return np.size(value) == 1 and np.asarray(value).dtype.kind in "fiu"


def _is_samples(value: Any) -> bool:
    """Tests for a real vector or matrix; a single number counts as a setting, not as a sample."""
    real = isinstance(value, np.ndarray) and value.dtype.kind in "fiubMm"
    return real and value.ndim in (1, 2) and value.size > 1
