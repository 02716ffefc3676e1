"""Recordings as Parquet; the metadata is JSON in the file's schema, everything has checksums."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from leglab.base.errors import LeglabError
from leglab.base.input import parse_json
from leglab.base.output import write_atomically
from leglab.base.recording import Recording
from leglab.data.columns import to_arrays
from leglab.data.files import first_line
from leglab.data.metadata import check_notes, to_json

_METADATA_KEY, _DIGEST_KEY = b"leglab", b"leglab.sha256"


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
        LeglabError: The file is truncated, damaged or not Parquet, its metadata is not JSON, or a
            column is not numeric.
    """
    try:
        table = pq.read_table(path, page_checksum_verification=True)
        shape = [table.num_rows, *table.column_names]
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise LeglabError(f"{path}: not a complete Parquet file: {first_line(error)}") from error
    stored = table.schema.metadata or {}
    text = stored.get(_METADATA_KEY)
    if _DIGEST_KEY in stored and stored[_DIGEST_KEY] != _digest(shape, text or b""):
        raise LeglabError(
            f"{path}: is damaged: names, length and metadata do not fit their checksum"
        )
    return to_arrays(table, path, left_out), _metadata(path, text)


def write(recording: Recording, path: Path) -> None:
    """Writes a recording with its metadata.

    Raises:
        LeglabError: The folder does not exist or cannot be written to.
    """
    table = pa.table({"time": recording.time, **recording.columns})
    text = to_json(recording.metadata).encode()
    digest = _digest([table.num_rows, *table.column_names], text)
    table = table.replace_schema_metadata({_METADATA_KEY: text, _DIGEST_KEY: digest})
    options = {"compression": "zstd", "write_page_checksum": True}
    write_atomically(path, lambda stream: pq.write_table(table, stream, **options))


def _metadata(path: Path, text: bytes | None) -> dict:
    if text is None:
        return {}
    try:
        found = parse_json(text)
        if not isinstance(found, dict):
            raise ValueError(f"it holds {type(found).__name__}, allowed is an object")
        check_notes(found)
    except ValueError as error:
        raise LeglabError(f"{path}: metadata {_METADATA_KEY.decode()!r}: {error}") from error
    return found


def _digest(shape: list, metadata: bytes) -> bytes:
    """Checksum of what those of the pages leave out: length, names, metadata."""
    content = json.dumps(shape).encode() + b"\n" + metadata
    return hashlib.sha256(content).hexdigest().encode()
