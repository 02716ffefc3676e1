"""Recordings as Parquet files with checksums; metadata are JSON in the file's schema."""

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from leglab.base.errors import FileError, RecordingError
from leglab.base.input import parse_json
from leglab.base.output import cannot_write, new_file, write_atomically
from leglab.base.recording import Recording
from leglab.data.clock import Timed
from leglab.data.columns import to_arrays
from leglab.data.files import LeftOut, first_line, to_json

_METADATA_KEY, _DIGEST_KEY = b"leglab", b"leglab.sha256"

# No dictionary encoding: measured values seldom repeat, so it makes files a quarter larger.
_OPTIONS: dict[str, Any] = {
    "compression": "zstd",
    "write_page_checksum": True,
    "use_dictionary": False,
    "store_schema": False,  # The metadata of a growing file are known only at its end.
}
# Rows per group in writing and per batch in reading.
_GROUP = 65536


def read_table(
    path: Path, left_out: LeftOut, _: object = None, *, without: Set[str] = frozenset()
) -> tuple[dict[str, np.ndarray], dict]:
    """Reads the columns of a Parquet file except the columns in `without`.

    Raises:
        LeglabError: The file is truncated, damaged or not Parquet, its metadata is not JSON, or a
            column is not numeric.
    """
    try:
        table = pq.read_table(path, page_checksum_verification=True)
        shape = [table.num_rows, *table.column_names]
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        message = f"{path}: not a complete Parquet file: {first_line(error)}"
        raise FileError(message, given=path) from error
    stored = table.schema.metadata or {}
    text = stored.get(_METADATA_KEY)
    if _DIGEST_KEY in stored and stored[_DIGEST_KEY] != _digest(shape, text or b""):
        message = f"{path}: is damaged: names, length and metadata do not fit their checksum"
        raise FileError(message, given=path)
    unused = [name for name in without if name in table.column_names]
    columns = to_arrays(table.drop_columns(unused), path, left_out)
    return columns if text is None else Timed(columns), _metadata(path, text)


def write(recording: Recording, path: Path) -> None:
    """Writes a recording with its metadata.

    Raises:
        LeglabError: The folder does not exist or cannot be written to.
    """
    table = pa.table({"time": recording.time, **recording.columns})
    notes = _notes(len(recording), table.column_names, recording.metadata)

    def fill(stream: BinaryIO) -> None:
        with pq.ParquetWriter(stream, table.schema, **_OPTIONS) as writer:
            writer.write_table(table, row_group_size=_GROUP)
            writer.add_key_value_metadata(notes)

    write_atomically(path, fill)


class Growing:
    """A recording's file to which rows are appended; see `growing`."""

    def __init__(self, place: Path) -> None:
        self._place, self._writer = place, None
        self.names: list[str] = []  #: Columns so far, "time" the first
        self.rows = 0  #: Number of rows so far

    def append(self, columns: Mapping[str, np.ndarray]) -> None:
        """Writes rows.

        Args:
            columns: Samples by name, "time" first, (n,) each. A new column becomes NaN in the
                earlier rows.

        Raises:
            LeglabError: A column of earlier rows is missing.
        """
        if list(columns) != self.names:
            self._begin(list(columns))
        self._write(pa.table({name: _floats(values) for name, values in columns.items()}))

    def finish(self, metadata: Mapping[str, Any]) -> None:
        """Writes metadata and the end of the file.

        Raises:
            LeglabError: No row was written.
        """
        if self._writer is None:
            raise RecordingError("a recording needs at least one sample")
        self._writer.add_key_value_metadata(_notes(self.rows, self.names, metadata))
        self.close()

    def close(self) -> None:
        """Closes the file in its present state."""
        writer, self._writer = self._writer, None
        if writer is not None:
            try:
                writer.close()
            finally:
                writer.is_open = False  # Its destructor would try to close it again.
                self._stream.close()

    def _begin(self, names: list[str]) -> None:
        """Starts the file, or rewrites it with more columns."""
        if missing := [name for name in self.names if name not in names]:
            text = f"column {missing[0]!r} ends before the recording does"
            raise RecordingError(text, given=missing[0])
        earlier = self._place.with_name(f"{self._place.name}.earlier")
        self.close()
        if self.rows:
            os.replace(self._place, earlier)
        self.names, self.rows = names, 0
        self._stream = self._place.open("wb")
        schema = pa.schema([(name, pa.float64()) for name in names])
        self._writer = pq.ParquetWriter(self._stream, schema, **_OPTIONS)
        if earlier.exists():
            with pq.ParquetFile(earlier) as file:
                for batch in file.iter_batches(_GROUP):
                    none = _floats(np.full(batch.num_rows, np.nan))
                    known = dict(zip(batch.schema.names, batch.columns, strict=True))
                    self._write(pa.table(dict.fromkeys(names, none) | known))
            earlier.unlink()

    def _write(self, table: pa.Table) -> None:
        assert self._writer is not None
        self._writer.write_table(table)
        self.rows += table.num_rows


@contextmanager
def growing(
    path: Path, metadata: Callable[[Sequence[str]], Mapping[str, Any]]
) -> Iterator[Growing]:
    """Yields a file to append rows to; it is moved to its path at the end.

    Args:
        path: The file.
        metadata: Returns the recording's metadata for the names of its columns without "time".

    Raises:
        LeglabError: Another process is writing the file, no row was written, or the file cannot be
            written or replaced.
    """
    with new_file(path) as place:
        file = Growing(place)
        try:
            yield file
            file.finish(metadata(file.names[1:]))
        except OSError as error:
            raise cannot_write(path, error) from error
        finally:
            with suppress(OSError):  # of a full disk, which has been reported
                file.close()


class StoredColumns(Mapping[str, np.ndarray]):
    """Columns of a file, read on each access and not cached, and the recording's `metadata`.

    The file stays open, so it may be moved.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = pq.ParquetFile(path, page_checksum_verification=True, pre_buffer=False)
        self._names = [name for name in self._file.schema_arrow.names if name != "time"]
        text = (self._file.schema_arrow.metadata or {}).get(_METADATA_KEY)
        self.metadata = _metadata(path, text)

    def __getitem__(self, name: str) -> np.ndarray:
        try:
            samples = self._file.read([name]).column(0).to_numpy()
        except (pa.ArrowException, OSError) as error:
            text = f"{self._path}: cannot be read: {first_line(error)}"
            raise FileError(text, given=self._path) from error
        samples.setflags(write=False)
        return samples

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __contains__(self, name: object) -> bool:
        return name in self._names


class StoredRecording(Recording):
    """A recording whose columns stay in the file that `growing` wrote."""

    def __post_init__(self) -> None:
        """Skips the checks of `Recording`, which would read the whole file."""


def stored(path: Path) -> StoredRecording:
    """Opens a recording written by leglab, whose columns are read on each access."""
    columns = StoredColumns(path)
    return StoredRecording(time=columns["time"], columns=columns, metadata=columns.metadata)


def _notes(rows: int, names: list[str], metadata: Mapping[str, Any]) -> dict[bytes, bytes]:
    """Returns the metadata of a file with their checksum."""
    text = to_json(metadata).encode()
    return {_METADATA_KEY: text, _DIGEST_KEY: _digest([rows, *names], text)}


def _floats(values: np.ndarray) -> pa.Array:
    return pa.array(np.ascontiguousarray(values, dtype=np.float64))


def _metadata(path: Path, text: bytes | None) -> dict:
    if text is None:
        return {}
    try:
        found = parse_json(text)
        if not isinstance(found, dict):
            raise ValueError(f"it holds {type(found).__name__}, allowed is an object")
    except ValueError as error:
        message = f"{path}: metadata {_METADATA_KEY.decode()!r}: {error}"
        raise FileError(message, given=path) from error
    return found


def _digest(shape: list, metadata: bytes) -> bytes:
    """Returns a checksum of the parts that page checksums omit: length, names, metadata."""
    content = json.dumps(shape).encode() + b"\n" + metadata
    return hashlib.sha256(content).hexdigest().encode()
