"""Recordings as CSV and other text: a line of column names, then one line per sample."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc

from leglab.base.errors import FileError, RecordingError
from leglab.base.input import read_bytes
from leglab.base.output import write_atomically
from leglab.base.recording import Recording
from leglab.data.column_map import ColumnMap
from leglab.data.columns import to_arrays
from leglab.data.dialect import MISSING, decoded, dialect
from leglab.data.files import LeftOut

_TRUE = [word for w in ("true", "on", "yes") for word in (w, w.capitalize(), w.upper())]
_FALSE = [word for w in ("false", "off", "no") for word in (w, w.capitalize(), w.upper())]


def read_table(
    path: Path, left_out: LeftOut, columns: ColumnMap | None = None
) -> tuple[dict[str, np.ndarray], dict]:
    """Reads all columns of delimited text, also with gzip. Row 0 is the first after the names.

    Raises:
        LeglabError: A line has too few or too many cells (for example the last line of a truncated
            file), or a cell is not a number; names the row.
    """
    settings = (columns or ColumnMap()).settings
    text = decoded(read_bytes(path), settings.encoding)
    found = dialect(text if "\n" in text else text.replace("\r", "\n"), settings, path)
    if not found.body.strip():
        return {name: np.empty(0) for name in found.names}, {}
    broken: list[pc.InvalidRow] = []

    def note(row: pc.InvalidRow) -> str:
        broken.append(row)
        return "skip"

    table = pc.read_csv(
        pa.BufferReader(found.body.encode()),
        # Invalid rows have numbers only with a single thread.
        read_options=pc.ReadOptions(use_threads=False, column_names=found.names),
        parse_options=pc.ParseOptions(
            delimiter="\t" if found.separator == " " else found.separator, invalid_row_handler=note
        ),
        convert_options=pc.ConvertOptions(
            null_values=MISSING,
            strings_can_be_null=True,
            decimal_point=found.decimal,
            true_values=_TRUE,
            false_values=_FALSE,
        ),
    )
    metadata = {}
    if broken:
        row = broken[0]
        cells = f"{row.actual_columns} cells instead of {row.expected_columns}"
        message = f"row {row.number - 1} has {cells} ({row.text!r})"
        if not left_out.salvage:
            way = "; is the file truncated? --salvage leaves such rows out"
            raise FileError(f"{path}: {message}{way}", given=path)
        metadata["salvaged"] = [f"{len(broken)} rows are left out, the first: {message}"]
    # An extra comma at the end of each line gives an empty, unnamed column.
    filled = [x.null_count < len(x) for x in table.columns]
    kept = [
        i for i, name in enumerate(found.names) if filled[i] or not name.startswith("Unnamed: ")
    ]
    return to_arrays(table.select(kept), path, left_out, decimal=found.decimal), metadata


def write(recording: Recording, path: Path) -> None:
    """Writes a recording with all digits; its metadata is lost.

    Raises:
        LeglabError: The folder does not exist or cannot be written to, or the name of a column
            has a line break.
    """
    table = pa.table({"time": recording.time, **recording.columns})
    broken = [name for name in table.column_names if "\n" in name or "\r" in name]
    if broken:
        text = f"{path}: column {broken[0]!r} has a line break, which CSV cannot hold"
        raise RecordingError(text, given=broken[0])
    # "needed" quotes all names.
    header = "needed" if {",", '"'} & set("".join(table.column_names)) else "none"
    options = pc.WriteOptions(quoting_style="needed", quoting_header=header)
    write_atomically(path, lambda stream: pc.write_csv(table, stream, options))
