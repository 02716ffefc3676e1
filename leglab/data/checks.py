"""Checks of raw data: defects of a table, their location, and safe repairs."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from leglab.base.errors import LeglabError, RecordingError
from leglab.base.recording import Recording

# Ratio of a time step to the usual time step above which samples are missing; 2 if one is missing.
_GAP = 1.5

MAP_HINT = "--columns FILE says what the columns are called here (docs/guides/recordings.md)"
"""Where to go with columns that have other names."""

# Kinds of findings without a valid time axis: they must be repaired before any computation.
_FATAL = frozenset({"empty", "no_time", "missing_time", "repeated_time", "reversed_time"})


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One defect of a table."""

    #: "empty", "no_time", "missing_time", "repeated_time", "repeated_row", "reversed_time", "gap",
    #: "nan_run", "infinite" or "constant".
    kind: str
    column: str  #: The column
    row: int  #: The first row, from 0
    count: int  #: Number of rows
    message: str  #: One line with the row, the column, the value and what is usual

    @property
    def fatal(self) -> bool:
        """Whether the table cannot become a recording as it is."""
        return self.kind in _FATAL


def inspect(table: Recording | Mapping[str, np.ndarray]) -> tuple[Finding, ...]:
    """Lists defects of a recording, or of arrays (n,) by name, ordered by column and row."""
    if isinstance(table, Recording):
        table = {"time": table.time, **table.columns}
    if not any(samples.size for samples in table.values()):
        return (_finding("empty", "time", 0, 0, "there is no sample"),)
    text = f"no column 'time'; {MAP_HINT}"
    timeless = Finding(kind="no_time", column="time", row=0, count=0, message=text)
    found = [_inspect_column(name, samples) for name, samples in table.items() if name != "time"]
    return tuple(chain(_inspect_time(table) if "time" in table else (timeless,), *found))


def drop_redundant_rows(
    table: Mapping[str, np.ndarray],
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Drops rows without information: exact repetitions of the row before, empty rows at the end.

    No data are invented: no value is interpolated, no row is moved.

    Returns:
        Arrays of shape (m,) by column name, and one line for each kind of repair made.
    """
    filled = ~np.isnan(np.column_stack(list(table.values()))).all(axis=1)
    keep = np.logical_or.accumulate(filled[::-1])[::-1]
    notes = []
    if not keep.all():
        notes.append(f"dropped {(~keep).sum()} empty rows at the end, from row {keep.sum()}")
    repeated = _repeated_rows(table) & keep
    if repeated.any():
        first = repeated.argmax()
        notes.append(f"dropped {repeated.sum()} exact repetitions of a row, the first is {first}")
    keep &= ~repeated
    return {name: samples[keep] for name, samples in table.items()}, tuple(notes)


def to_recording(
    table: Mapping[str, np.ndarray], metadata: Mapping[str, Any], *, source: str, repair: bool
) -> Recording:
    """Builds a recording from arrays of shape (n,) by column name, `time` among them.

    If `repair`, safe repairs are made and listed in the metadata under "repairs".

    Raises:
        RecordingError: The time axis is not valid; names the first reason and counts the others.
    """
    if repair:
        table, notes = drop_redundant_rows(table)
        if notes:
            metadata = {**metadata, "repairs": [*metadata.get("repairs", ()), *notes]}
    # Repeated rows are left here only if they were not repaired.
    fatal = [
        finding for finding in inspect(table) if finding.fatal or finding.kind == "repeated_row"
    ]
    if fatal:
        more = f" ({len(fatal) - 1} more such findings)" if len(fatal) > 1 else ""
        raise RecordingError(f"{source}: {fatal[0].message}{more}", given=fatal[0].column)
    columns = dict(table)
    try:
        return Recording(time=columns.pop("time"), columns=columns, metadata=metadata)
    except LeglabError as error:
        raise error.at(source) from error


def _inspect_time(table: Mapping[str, np.ndarray]) -> Iterator[Finding]:
    time = table["time"]
    for row, count in _runs(~np.isfinite(time)):
        yield _finding("missing_time", "time", row, count, f"{time[row]} is not a finite time")
    with np.errstate(invalid="ignore"):
        interval = np.diff(time)
    forward = interval[interval > 0]
    usual = float(np.median(forward)) if forward.size else np.nan
    same = _repeated_rows(table)
    for last in np.flatnonzero((interval <= 0) | (interval > _GAP * usual)).tolist():
        row, step, stamp = last + 1, interval[last], f"{time[last + 1]:.9g} s"
        if step > 0:
            kind, message = "gap", f"{step:.6g} s after the row before, usual are {usual:.6g} s"
        elif step < 0:
            kind, message = "reversed_time", f"{stamp} comes after {time[last]:.9g} s"
        elif same[row]:
            kind, message = "repeated_row", f"repeats row {last} exactly"
        else:
            kind, message = "repeated_time", f"{stamp} again, with other values than row {last}"
        yield _finding(kind, "time", row, 1, message)


def _inspect_column(name: str, samples: np.ndarray) -> Iterator[Finding]:
    for row, count in _runs(np.isnan(samples)):
        yield _finding("nan_run", name, row, count, f"{count} samples without a number")
    for row, count in _runs(np.isinf(samples)):
        yield _finding("infinite", name, row, count, f"{count} infinite samples")
    finite = samples[np.isfinite(samples)]
    if finite.size > 1 and (finite == finite[0]).all():
        message = f"{finite[0]:.9g} in every row: is the sensor connected?"
        yield _finding("constant", name, 0, samples.size, message)


def _repeated_rows(table: Mapping[str, np.ndarray]) -> np.ndarray:
    """Tests which rows equal the row before in every column; NaN equals NaN."""
    same = np.arange(table["time"].size) > 0
    for samples in table.values():
        one, two = samples[:-1], samples[1:]
        same[1:] &= (one == two) | (np.isnan(one) & np.isnan(two))
    # Without a time stamp, equal rows may be different samples.
    return same & ~np.isnan(table["time"])


def _runs(mask: np.ndarray) -> Iterator[tuple[int, int]]:
    """Yields first row and length of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        yield int(start), int(end - start)


def _finding(kind: str, column: str, row: int, count: int, message: str) -> Finding:
    message = f"column {column!r}, row {row}: {message}"
    return Finding(kind=kind, column=column, row=row, count=count, message=message)
