"""Recordings as Parquet; the metadata is JSON in the file's schema."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from leglab.base.errors import LeglabError
from leglab.base.output import write_atomically
from leglab.base.recording import Recording
from leglab.data.columns import to_arrays
from leglab.data.metadata import to_json

_METADATA_KEY = b"leglab"


def read_table(
    path: Path, left_out: dict[str, str] | None = None
) -> tuple[dict[str, np.ndarray], dict]:
    """Reads all columns of a Parquet file.

    Args:
        path: The file.
        left_out: Gets columns that cannot be read, with the reason; None: they are refused.

    Returns:
        Arrays of shape (n,) by column name, and the metadata (empty in a file of others).

    Raises:
        LeglabError: The file is truncated or not Parquet, or a column is not numeric.
    """
    try:
        table = pq.read_table(path)
    except (pa.ArrowException, OSError) as error:
        raise LeglabError(
            f"{path}: not a complete Parquet file: {str(error).splitlines()[0]}"
        ) from error
    stored = (table.schema.metadata or {}).get(_METADATA_KEY)
    return to_arrays(table, path, left_out), {} if stored is None else json.loads(stored)


def write(recording: Recording, path: Path) -> None:
    """Writes a recording with its metadata.

    Raises:
        LeglabError: The folder does not exist or cannot be written to.
    """
    table = pa.table({"time": recording.time, **recording.columns})
    table = table.replace_schema_metadata({_METADATA_KEY: to_json(recording.metadata)})
    write_atomically(path, lambda stream: pq.write_table(table, stream, compression="zstd"))
