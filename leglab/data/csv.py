"""Recordings as CSV: a line of column names, then one line a sample."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc

from leglab.base.errors import FileError, RecordingError
from leglab.base.input import read_bytes
from leglab.base.output import write_atomically
from leglab.base.recording import Recording
from leglab.data.columns import to_arrays
from leglab.data.files import LeftOut

# Cells that stand for a missing sample; all other text is refused.
_MISSING = ["", "nan", "NaN", "NAN", "null", "NULL", "NA", "n/a"]


def read_table(path: Path, left_out: LeftOut) -> tuple[dict[str, np.ndarray], dict]:
    """Reads all columns of a CSV file. Row 0 is the first line after the names.

    Raises:
        LeglabError: The text is not UTF-8, a line has too few or too many cells (as the last one
            of a truncated file), or a cell is not a number; names the row.
    """
    content = _text_of(path)
    broken: list[pc.InvalidRow] = []

    def note(row: pc.InvalidRow) -> str:
        broken.append(row)
        return "skip"

    try:
        table = pc.read_csv(
            pa.BufferReader(content),
            # One thread: only then are invalid rows numbered.
            read_options=pc.ReadOptions(use_threads=False),
            parse_options=pc.ParseOptions(invalid_row_handler=note),
            convert_options=pc.ConvertOptions(null_values=_MISSING, strings_can_be_null=True),
        )
    except pa.ArrowException as error:
        reason = str(error).splitlines()[0]
        raise FileError(f"{path}: not a CSV file: {reason}", given=path) from error
    if broken:
        row = broken[0]
        raise FileError(
            f"{path}: row {row.number - 2} has {row.actual_columns} cells instead of "
            f"{row.expected_columns} ({row.text!r}); is the file truncated?",
            given=path,
        )
    return to_arrays(table, path, left_out), {}


def write(recording: Recording, path: Path) -> None:
    """Writes a recording with all digits; its metadata is lost.

    Raises:
        LeglabError: The folder does not exist or cannot be written to, or the name of a column
            has a line break.
    """
    table = pa.table({"time": recording.time, **recording.columns})
    broken = [name for name in table.column_names if "\n" in name or "\r" in name]
    if broken:
        told = f"{path}: column {broken[0]!r} has a line break, which CSV cannot hold"
        raise RecordingError(told, given=broken[0])
    # "needed" quotes all names.
    special = any(letter in name for name in table.column_names for letter in ',"')
    options = pc.WriteOptions(
        quoting_style="needed", quoting_header="needed" if special else "none"
    )
    write_atomically(path, lambda stream: pc.write_csv(table, stream, options))


def _text_of(path: Path) -> bytes:
    """Returns a file's bytes if they are UTF-8; pyarrow trips over names and broken rows if not."""
    content = read_bytes(path)
    try:
        content.decode()
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        told = f"{path}: line {line}: byte 0x{content[error.start]:02x} is not UTF-8 text"
        raise FileError(told, given=path) from error
    return content
