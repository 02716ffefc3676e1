"""Conversion of Arrow tables to arrays, shared by all formats."""

import re
from collections import Counter
from contextlib import suppress
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from leglab.base.errors import LeglabError, RecordingError
from leglab.data.files import LeftOut
from leglab.data.time_text import past_midnight, times_of

_LIST = re.compile(r"^\s*[\[(](.*)[\])]\s*$")


def to_arrays(
    table: pa.Table, path: Path, left_out: LeftOut, *, decimal: str = "."
) -> dict[str, np.ndarray]:
    """Converts an Arrow table to arrays of numbers and times, (n,), by column name.

    Empty cells become NaN or NaT; `decimal` is the decimal sign of numbers in text.

    Raises:
        RecordingError: A column is named twice or is not numeric.
    """
    while any(pa.types.is_struct(field.type) for field in table.schema):
        table = table.flatten()
    found: dict[str, np.ndarray] = {}
    for name, count in Counter(table.column_names).items():
        try:
            if count > 1:
                text = f"{path}: column {name!r} is there {count} times"
                raise RecordingError(text, given=name)
            samples = _to_array(table.column(name), name, path, decimal)
        except LeglabError as error:
            left_out.add(name, error)
            continue
        lists = {f"{name}[{i}]": part for i, part in enumerate(samples.T)}
        found |= {name: samples} if samples.ndim == 1 else lists
    return found


def _to_array(column: pa.ChunkedArray, name: str, path: Path, decimal: str) -> np.ndarray:
    types, kind = pa.types, column.type
    if types.is_dictionary(kind):
        column, kind = column.cast(kind.value_type), kind.value_type
    if types.is_time(kind):  # A time of day becomes the time since the first day's midnight.
        stamps = column.cast(pa.int64() if kind.bit_width == 64 else pa.int32())
        return past_midnight(stamps.cast(pa.int64()).cast(pa.duration(kind.unit)).to_numpy())
    if types.is_temporal(kind) or (types.is_primitive(kind) and not column.null_count):
        return column.to_numpy()
    if types.is_primitive(kind) or types.is_decimal(kind) or types.is_null(kind):
        return column.cast(pa.float64(), safe=False).to_numpy().astype(np.float64)
    samples = None
    if kind in (pa.string(), pa.large_string(), pa.string_view()):
        column = column.cast(pa.string())
        with suppress(pa.ArrowInvalid):
            return column.cast(pa.float64()).to_numpy()
        samples = times_of(column)
        samples = _lists(column) if samples is None else samples
    elif _is_list(kind):
        samples = _elements(column)
    if samples is not None:
        return samples
    cells = enumerate(column.to_pylist())
    others = ((f", row {i}", x) for i, x in cells if not (x is None or _is_number(x, decimal)))
    where, value = next(others, ("", str(kind)))
    text = f"{path}: column {name!r}{where}: {value!r} is not "
    raise RecordingError(text, given=value, allowed="a number")


def _is_list(kind: pa.DataType) -> bool:
    types = pa.types
    return types.is_list(kind) or types.is_fixed_size_list(kind) or types.is_large_list(kind)


def _elements(column: pa.ChunkedArray) -> np.ndarray | None:
    """Converts lists of equal length, also nested, to an array (n, length); None for others."""
    lengths = pc.unique(pc.list_value_length(column).drop_null()).to_pylist()
    if len(lengths) != 1 or not lengths[0]:
        return None
    found = []
    for index in range(lengths[0]):
        element = pc.list_element(column, index)
        part = _elements(element) if _is_list(element.type) else None
        if part is None and not pa.types.is_primitive(element.type):
            return None
        found.append(element.cast(pa.float64()).to_numpy() if part is None else part)
    return np.column_stack(found).astype(np.float64)


def _is_number(text: object, decimal: str) -> bool:
    try:
        float(str(text).replace(decimal, "."))  # str, because float accepts a bool
    except ValueError:
        return False
    return True


def _lists(column: pa.ChunkedArray) -> np.ndarray | None:
    """Parses cells with lists of equal length to an array (n, length); None for other cells."""
    try:
        insides = [cell and _LIST.findall(cell)[0].strip(",; ") for cell in column.to_pylist()]
        rows = [cell and [float(x) for x in re.split(r"[,;\s]+", cell)] for cell in insides]
        length = len(next(filter(None, rows)))
        return np.array([row or [np.nan] * length for row in rows])
    except (ValueError, IndexError, StopIteration):
        return None
