"""Recordings in files: the suffix picks the format."""

from pathlib import Path
from types import ModuleType

from leglab.data import csv, parquet
from leglab.data.checks import Finding, inspect, to_recording
from leglab.data.files import write_atomically
from leglab.errors import LeglabError
from leglab.recording import Recording

__all__ = ["Finding", "inspect", "read", "read_table", "write", "write_atomically"]

_FORMATS = {".parquet": parquet, ".csv": csv}


def read(path: str | Path, *, repair: bool = True) -> Recording:
    """Reads a recording.

    Args:
        path: A `.parquet` or `.csv` file with a `time` column.
        repair: Whether what can be repaired without inventing data is: exact repetitions of a row
            and empty rows at the end are dropped, and noted in the metadata under "repairs".

    Raises:
        LeglabError: There is no such file, it cannot be read, a column is not numeric, or time
            stamps are missing, repeated or reversed; names the file, the row and the column.
    """
    columns, metadata = read_table(path)
    return to_recording(columns, metadata, source=str(path), repair=repair)


def read_table(path: str | Path) -> tuple[dict, dict]:
    """Reads the columns of a file as they are, `time` among them, without checking the values.

    Returns:
        Arrays of shape (n,) by column name, for `inspect`, and the metadata.

    Raises:
        LeglabError: There is no such file, it cannot be read, or a column is not numeric.
    """
    path = Path(path)
    if not path.is_file():
        raise LeglabError(f"{path}: there is no such file")
    return _format_of(path).read_table(path)


def write(recording: Recording, path: str | Path) -> Path:
    """Writes a recording; an existing file is replaced as a whole or left as it was.

    Args:
        recording: What to write. CSV holds no metadata.
        path: A `.parquet` or `.csv` file.

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
