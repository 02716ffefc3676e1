"""From Arrow tables to plain arrays, the same for every format."""

from pathlib import Path

import numpy as np
import pyarrow as pa

from leglab.base.errors import LeglabError, RecordingError
from leglab.data.files import LeftOut


def to_arrays(table: pa.Table, path: Path, left_out: LeftOut) -> dict[str, np.ndarray]:
    """Turns an Arrow table into arrays of numbers and times; empty cells become NaN or NaT.

    Args:
        table: The table.
        path: Where it came from, for messages.
        left_out: Gets columns that cannot be read.

    Returns:
        Arrays of shape (n,) by column name.

    Raises:
        RecordingError: A column is named twice or is not numeric.
    """
    names = table.column_names
    found: dict[str, np.ndarray] = {}
    for name in dict.fromkeys(names):
        try:
            if names.count(name) > 1:
                told = f"{path}: column {name!r} is there {names.count(name)} times"
                raise RecordingError(told, given=name)
            found[name] = _to_array(table.column(name), name, path)
        except LeglabError as error:
            left_out.add(name, error)
    return found


def _to_array(column: pa.ChunkedArray, name: str, path: Path) -> np.ndarray:
    kind = column.type
    if pa.types.is_null(kind):
        return np.full(len(column), np.nan)
    if pa.types.is_time(kind):  # A time of day as the time since the first day's midnight.
        stamps = column.cast(pa.int64() if kind.bit_width == 64 else pa.int32())
        column = stamps.cast(pa.int64()).cast(pa.duration(kind.unit))
        return _past_midnight(column.to_numpy())
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind) or pa.types.is_date(kind):
        return column.to_numpy()
    if (pa.types.is_integer(kind) or pa.types.is_floating(kind)) and not column.null_count:
        return column.to_numpy()
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind):
        return column.cast(pa.float64(), safe=False).to_numpy().astype(np.float64)
    for row, value in enumerate(column.to_pylist()):
        if value is not None and not _is_number(value):
            told = f"{path}: column {name!r}, row {row}: {value!r} is not "
            raise RecordingError(told, given=value, allowed="a number")
    told = f"{path}: column {name!r} holds {kind}, allowed are "
    raise RecordingError(told, given=str(kind), allowed="numbers")


def _is_number(text: object) -> bool:
    try:
        float(str(text))  # Not of a bool, whose name is no number.
    except ValueError:
        return False
    return True


def _past_midnight(times: np.ndarray) -> np.ndarray:
    """Adds a day wherever a clock, timedelta64 of shape (n,), begins anew."""
    day, half = np.timedelta64(24, "h"), np.timedelta64(12, "h")
    begins = np.concatenate([[False], np.diff(times) < -half])
    return times + np.cumsum(begins) * day.astype(times.dtype)
