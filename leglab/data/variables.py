"""Variables of a workspace (MATLAB, NumPy) as columns: vectors, matrices, series with a clock.

A series is a struct with `time` (or `Time`) beside its numbers: Simulink's "structure with time"
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


def table_of(
    variables: Mapping[str, Any], left_out: LeftOut, columns: ColumnMap | None
) -> tuple[dict[str, np.ndarray], dict]:
    """Returns variables as columns on one clock.

    Series of one clock keep their samples; of several, those whose name ends on `_command` hold
    their last value on the clock with the most samples, all others are drawn linearly.

    Args:
        variables: By name.
        left_out: Gets columns that are there twice, or of another length.
        columns: Says which series are commands; None: their names here do.

    Raises:
        RecordingError: Lengths differ, or a series' time does not fit its values.
    """
    structs = [value for value in variables.values() if isinstance(value, dict)]
    if len(variables) == len(structs) == 1 and not _is_series(structs[0]):
        variables = structs[0]
    series = {n: _series(n, v) for n, v in variables.items() if _is_series(v)}
    samples = {n: np.asarray(v) for n, v in variables.items() if _is_samples(v)}
    others = sorted(variables.keys() - series.keys() - samples.keys())
    metadata: dict[str, Any] = {"left_out": others} if others else {}
    if not series:
        table = _vectors(samples, left_out)
        check_lengths(table, left_out)
        return table, metadata
    time = next((samples.pop(t) for t in _PLAIN_TIMES if t in samples), np.empty(0)).ravel()
    beside = {n: x for n, x in samples.items() if time.size and time.size in x.shape}
    series |= {n: (time, dict(_split(n, x, time.size))) for n, x in beside.items()}
    if rest := samples.keys() - beside.keys():
        metadata["left_out"] = sorted((*others, *rest))
    topics = [
        TopicSeries(name, np.rint(own * 1e9).astype(np.int64), found)
        for name, (own, found) in series.items()
    ]
    clock = max(topics, key=lambda topic: topic.stamps.size)
    clock = replace(clock, columns={"time": series[clock.topic][0]})
    table, notes = on_clock(topics, clock, columns or ColumnMap(), left_out)
    return Timed(table), metadata | ({"alignment": notes} if notes else {})


def check_lengths(table: dict[str, np.ndarray], left_out: LeftOut) -> None:
    """Leaves columns of another length than `time` out.

    Raises:
        RecordingError: There are some, and nothing may be left out or no `time` decides.
    """
    for name in list(table) if left_out.partial and "time" in table else ():
        rows, wanted = len(table[name]), len(table["time"])
        if rows != wanted:
            why = f"column {name!r} has {rows} samples, 'time' has {wanted}"
            left_out.add(name, RecordingError(why, given=name))
            del table[name]
    lengths = {name: len(column) for name, column in table.items()}
    if len(set(lengths.values())) > 1:
        found = ", ".join(f"{name!r} {length}" for name, length in lengths.items())
        raise RecordingError(f"vectors have different lengths: {found}", given=lengths)


def _is_series(value: Any) -> bool:
    if not isinstance(value, Mapping) or not any(_is_samples(value.get(t)) for t in _TIMES):
        return False
    return "signals" in value or any(v in value for v in _VALUES)


def _series(name: str, value: Mapping[str, Any]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Time [s] and columns of a struct."""
    time = np.ravel(next(value[t] for t in _TIMES if t in value)).astype(np.float64)
    if not np.isfinite(time).all():
        row = int(np.argmin(np.isfinite(time)))
        raise RecordingError(f"{name!r}, row {row}: {time[row]} is not a finite time", given=name)
    signals = value.get("signals", value)
    signals = [signals] if isinstance(signals, Mapping) else list(signals)
    found: dict[str, np.ndarray] = {}
    for index, signal in enumerate(signals):
        owner = name
        if len(signals) > 1:
            label = signal.get("label")
            owner = f"{name}/{label}" if isinstance(label, str) and label else f"{name}[{index}]"
        values = next((signal[v] for v in _VALUES if v in signal), None)
        for key, column in _split(owner, np.asarray(values), time.size):
            if key in found:
                raise RecordingError(f"two signals of {name!r} are called {key!r}", given=key)
            found[key] = column
    return time, found


def _split(name: str, values: np.ndarray, rows: int) -> Iterator[tuple[str, np.ndarray]]:
    """Yields the elements of samples, of which the first or the last axis is time."""
    if values.dtype.kind not in "fiub" or rows not in (values.shape[:1] + values.shape[-1:]):
        told = f"{name!r}: values of shape {values.shape} for {rows} times; allowed: "
        raise RecordingError(told, given=name, allowed="numbers, one row a time")
    if values.shape[0] != rows or (values.ndim > 2 and values.shape[-1] == rows):
        values = np.moveaxis(values, -1, 0)  # Simulink puts time last where samples are matrices.
    yield from elements(name, values.astype(np.float64))


def elements(name: str, rows: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Yields names and columns of samples, (n, ...): of several numbers a row by their place."""
    flat = rows.reshape(len(rows), -1)
    for index, column in enumerate(flat.T):
        yield (name if flat.shape[1] == 1 else f"{name}[{index}]"), column


def _vectors(samples: Mapping[str, np.ndarray], left_out: LeftOut) -> dict[str, np.ndarray]:
    rows = max((len(array) for array in samples.values()), default=0)
    table: dict[str, np.ndarray] = {}
    for name, array in samples.items():
        lies = len(array) != rows and array.shape[-1] == rows
        for key, column in elements(name, array.T if lies else array):
            if key in table:
                left_out.add(key, RecordingError(f"two variables give column {key!r}", given=key))
            table[key] = column
    for key in left_out:
        table.pop(key, None)
    return table


def _is_samples(value: Any) -> bool:
    """Whether this is a real vector or matrix; a lone number is rather a setting."""
    real = isinstance(value, np.ndarray) and value.dtype.kind in "fiubMm"
    return real and value.ndim in (1, 2) and value.size > 1
