"""Recordings in files: the suffix picks the format."""

from pathlib import Path
from types import ModuleType

from leglab.data import csv, mcap, parquet
from leglab.data.checks import Finding, inspect, to_recording
from leglab.data.column_map import ColumnMap, read_column_map
from leglab.data.files import write_atomically
from leglab.errors import LeglabError
from leglab.recording import Recording

__all__ = [
    "ColumnMap",
    "Finding",
    "inspect",
    "read",
    "read_column_map",
    "read_table",
    "write",
    "write_atomically",
]

_FORMATS = {".parquet": parquet, ".csv": csv, ".mcap": mcap}


def read(
    path: str | Path, *, columns: ColumnMap | str | Path | None = None, repair: bool = True
) -> Recording:
    """Reads a recording.

    Args:
        path: A `.parquet` or `.csv` file with a `time` column, a `.mcap` file with joint states, or
            the folder of a ROS 2 bag.
        columns: How the columns of the file are called here, and their units: a map, or its file.
        repair: Whether what can be repaired without inventing data is: exact repetitions of a row
            and empty rows at the end are dropped, and noted in the metadata under "repairs".

    Raises:
        LeglabError: There is no such file, it cannot be read, a column is not numeric, time stamps
            are missing, repeated or reversed, or the map does not fit; names the file, the row and
            the column.
    """
    table, metadata = read_table(path, columns=columns)
    return to_recording(table, metadata, source=str(path), repair=repair)


def read_table(
    path: str | Path, *, columns: ColumnMap | str | Path | None = None
) -> tuple[dict, dict]:
    """Reads the columns of a file, `time` among them, without checking the values.

    Args:
        path: The file.
        columns: See `read`.

    Returns:
        Arrays of shape (n,) by column name, for `inspect`, and the metadata.

    Raises:
        LeglabError: There is no such file, it cannot be read, a column is not numeric, there is no
            `time`, or the map does not fit.
    """
    path = Path(path)
    if columns is not None and not isinstance(columns, ColumnMap):
        columns = read_column_map(columns)
    is_bag = path.is_dir()
    if not is_bag and not path.is_file():
        raise LeglabError(f"{path}: there is no such file")
    form = mcap if is_bag else _format_of(path)
    # Only topics have clocks of their own, and how they are brought onto one depends on the names.
    table, metadata = mcap.read_table(path, columns) if form is mcap else form.read_table(path)
    if columns is not None:
        table = columns.apply(table, str(path))
    if "time" not in table:
        found = ", ".join(map(repr, table)) or "no column"
        raise LeglabError(f"{path}: no column 'time', found {found}")
    return table, metadata


def write(recording: Recording, path: str | Path) -> Path:
    """Writes a recording; an existing file is replaced as a whole or left as it was.

    Args:
        recording: What to write. CSV holds no metadata; MCAP rounds times to 1 ns.
        path: A `.parquet`, `.csv` or `.mcap` file.

    Returns:
        The path.

    Raises:
        LeglabError: The suffix is not known, or the folder cannot be written to.
    """
    path = Path(path)
    _format_of(path).write(recording, path)
    return path


def _format_of(path: Path) -> ModuleType:
    if path.suffix not in _FORMATS:
        raise LeglabError(
            f"{path}: suffix {path.suffix!r} is not a known format, allowed: {', '.join(_FORMATS)}"
        )
    return _FORMATS[path.suffix]
