"""From Arrow tables to plain arrays, the same for every format."""

from pathlib import Path

import numpy as np
import pyarrow as pa

from leglab.base.errors import LeglabError, RecordingError
from leglab.data.files import LeftOut


def to_arrays(table: pa.Table, path: Path, left_out: LeftOut) -> dict[str, np.ndarray]:
    """Turns an Arrow table into float64 arrays; empty cells become NaN.

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
