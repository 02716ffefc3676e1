"""Dataset of a sweep on disk: an SQLite database while runs are made, then Parquet files.

    FOLDER/sweep.json       record of the sweep: plan, digests, number of runs
    FOLDER/rows.sqlite      rows so far, and proposed points of tuned blocks
    FOLDER/dataset.json     list of the Parquet files with checksums, once all runs are made
    FOLDER/runs/scenario=NAME/controller=NAME/part-0.parquet
    FOLDER/.earlier         earlier sweep, until the sweep that replaces it is complete

A row is stored when its transaction is committed: a process killed at any moment loses the runs in
progress but no row; a power cut may lose the last rows, whose runs are made again. If there is a
`dataset.json`, the files it lists are the valid data, otherwise the database. A single process
writes, also if several processes make runs. Readers of the database must run on the writer's
machine, since SQLite's write-ahead log needs shared memory.
"""

import json
import sqlite3
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any, BinaryIO
from urllib.parse import quote

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import BaseModel, Field

from leglab.base.errors import FileError
from leglab.base.output import (
    cannot_write,
    has_locks,
    remove,
    write_atomically,
    write_json,
    writer_elsewhere,
)
from leglab.runs.record import read
from leglab.runs.sweeps.plan import SweepPlan
from leglab.runs.sweeps.rows import FAILED, PARTITION, row_of, schema

SWEEP, DATASET, ROWS = "sweep.json", "dataset.json", "rows.sqlite"
_RUNS, _PART = "runs", "part-0.parquet"
# `_EARLIER`: folder of the sweep that is being replaced. `_MOVING`: its name during the move.
_EARLIER, _MOVING = ".earlier", ".earlier.partial"
# Number of rows that are converted to columns at a time.
_BATCH = 5000
_PATIENCE = 60.0  # s: maximum wait for another process that locks the database
_MISSING, _DONE, _BROKEN = 0, 1, 2


class Part(BaseModel):
    """A Parquet file of the dataset."""

    file: str  #: Its path below the folder
    rows: Annotated[int, Field(ge=0)]  #: How many it has
    #: CRC-32 of its content: those of pages leave out what describes them.
    checksum: Annotated[int, Field(ge=0)]


class Dataset(BaseModel):
    """Content of `dataset.json`: files of rows, proposed points by number of their first run."""

    parts: list[Part] = []
    proposals: dict[int, dict[str, float]] = {}


class SweepRecord(BaseModel):
    """Content of `sweep.json`."""

    plan: dict[str, Any]  #: Content of the sweep's file
    digest: str  #: Of the plan
    code: str  #: Digest of leglab's code
    models: dict[str, str]  #: Digests of the models
    runs: Annotated[int, Field(ge=1)]  #: Number of runs
    axes: list[str]  #: Settings in which they differ
    version: str  #: Of leglab
    load: list[str] = []  #: What `--load` named, as one would give it again


def is_sweep(folder: Path) -> bool:
    """Tests whether a folder holds a sweep."""
    return (folder / SWEEP).is_file()


def read_record(folder: Path) -> SweepRecord:
    """Reads the record of a sweep, `sweep.json`.

    Raises:
        LeglabError: The folder holds no sweep, or the file does not have the required form.
    """
    if not is_sweep(folder):
        raise FileError(f"{str(folder)!r} holds no sweep: it has no {SWEEP}", given=folder)
    return read(SweepRecord, folder / SWEEP)


def read_plan_of(folder: Path) -> SweepPlan:
    """Reads the plan of a sweep.

    Raises:
        LeglabError: As `read_record`.
    """
    return SweepPlan(read_record(folder).plan, str(folder / SWEEP))


def read_rows(folder: Path, names: Sequence[str] | None = None) -> Any:
    """Returns all rows of a sweep, also while it is being made.

    Args:
        folder: Folder of the sweep.
        names: Names of the needed columns; None for all.

    Returns:
        A `pyarrow.dataset.Dataset`.

    Raises:
        LeglabError: A file is missing, truncated or changed, `dataset.json` is not valid, an
            earlier version of leglab left the sweep incomplete, or another machine is making it.
    """
    columns = schema(read_plan_of(folder))
    for journal in folder.glob("journal-*.jsonl"):
        raise FileError(
            f"{journal}: an earlier leglab has not made this sweep to its end; leglab sweep "
            "--overwrite makes it anew"
        )
    made = (folder / ROWS).exists()  # Tested first, since `finish` removes it last.
    if (folder / DATASET).exists():
        parts = read(Dataset, folder / DATASET).parts
        for part in parts:
            if problem := _problem(folder, part):
                raise FileError(f"{problem}; leglab sweep removes it and makes its runs again")
        return _files(folder, parts, columns)
    import pyarrow.dataset as pd  # imported late, since it imports pandas if installed

    columns = pa.schema([columns.field(name) for name in names or columns.names])
    found = [columns.empty_table()]
    if made:
        with _reading(folder) as database:
            rows = database.execute(f"SELECT {_names(columns.names)} FROM runs ORDER BY run")
            found += _tables(rows, columns)
    return pd.dataset(pa.concat_tables(found))


def _files(folder: Path, parts: Sequence[Part], columns: pa.Schema) -> Any:
    """Returns Parquet files as one `pyarrow.dataset.Dataset`."""
    import pyarrow.dataset as pd

    partition = pa.schema([columns.field(name) for name in PARTITION])
    return pd.dataset(
        [str(folder / part.file) for part in parts],
        schema=columns,
        partitioning=pd.HivePartitioning(partition, segment_encoding="uri"),
        partition_base_dir=str(folder / _RUNS),
    )


def read_proposals(folder: Path) -> dict[int, dict[str, float]]:
    """Reads the proposed points by the number of their first run.

    Raises:
        LeglabError: As `read_rows`.
    """
    if (folder / DATASET).exists():
        return read(Dataset, folder / DATASET).proposals
    if not (folder / ROWS).exists():
        return {}
    with _reading(folder) as database:
        return _proposals(database)


def _proposals(database: sqlite3.Connection) -> dict[int, dict[str, float]]:
    return {run: json.loads(text) for run, text in database.execute("SELECT * FROM proposals")}


@contextmanager
def _reading(folder: Path) -> Iterator[sqlite3.Connection]:
    """Yields the database, opened read-only."""
    path = folder / ROWS
    if writer := writer_elsewhere(folder):
        raise FileError(f"{folder}: {writer} is writing it; ask on that machine, or at the end")
    try:
        with closing(_connect(path, "ro")) as database:
            yield database
    except sqlite3.Error as error:
        raise FileError(f"{path}: cannot be read: {error}") from error


def _connect(path: Path, mode: str) -> sqlite3.Connection:
    """Opens a database for reading ("ro") or writing ("rwc")."""
    locks = has_locks(path.with_name(SWEEP))
    place = f"{path.absolute().as_uri()}?mode={mode}{'' if locks else '&nolock=1'}"
    database = sqlite3.connect(place, uri=True, timeout=_PATIENCE, isolation_level=None)
    if mode == "rwc":
        database.execute("PRAGMA journal_mode = WAL")  # Without locks it has no effect.
        database.execute(f"PRAGMA synchronous = {'NORMAL' if locks else 'OFF'}")
    return database


def _names(names: Iterable[str]) -> str:
    return ", ".join(f'"{name}"' for name in names)


def _tables(rows: sqlite3.Cursor, columns: pa.Schema) -> Iterator[pa.Table]:
    """Yields the rows of a query as tables of at most `_BATCH` rows."""
    while batch := rows.fetchmany(_BATCH):
        found = zip(zip(*batch, strict=True), columns, strict=True)
        arrays = [_column(values, column.type) for values, column in found]
        yield pa.table(arrays, schema=columns)


def _column(values: Sequence[Any], kind: pa.DataType) -> pa.Array:
    if pa.types.is_list(kind):
        values = [None if value is None else json.loads(value) for value in values]
    elif pa.types.is_boolean(kind):
        values = [None if value is None else bool(value) for value in values]
    return pa.array(values, kind)


def _problem(folder: Path, part: Part) -> str:
    """Returns the error message of a damaged file; empty if its checksum is right."""
    path = folder / part.file
    try:
        same = _checksum(path) == part.checksum
    except OSError as error:
        return f"{path}: is damaged: it cannot be read: {error.strerror}"
    return "" if same else f"{path}: is damaged: its checksum is another"


def _checksum(path: Path) -> int:
    found = 0
    with path.open("rb") as stream:
        while content := stream.read(1 << 20):
            found = zlib.crc32(content, found)
    return found


class Store:
    """Dataset of a sweep that is being made, for its only writer.

    Args:
        folder: Folder of the sweep, locked by `claimed_folder`.
        plan: Plan of the sweep.

    Attributes:
        damaged: Messages on damaged files, whose runs count as missing.

    Raises:
        LeglabError: The folder cannot be read or written.
    """

    def __init__(self, folder: Path, plan: SweepPlan) -> None:
        self._folder, self._plan, self._schema = folder, plan, schema(plan)
        self._state, names = bytearray(len(plan)), self._schema.names
        self._insert = f"REPLACE INTO runs VALUES ({', '.join('?' * len(names))})"
        self._database: sqlite3.Connection | None = None
        self.damaged: list[str] = []
        if (folder / DATASET).exists():
            self._remove_database()
            dataset = read(Dataset, folder / DATASET)
            whole = [part for part in dataset.parts if not _problem(folder, part)]
            self.damaged = [
                f"{part.file} is damaged; its {part.rows} runs are made again"
                for part in dataset.parts
                if part not in whole
            ]
            if self.damaged:
                self._reopen(dataset, whole)
        else:
            with self._opened():
                remove([folder / _RUNS])
        names = ["run", "status"]
        for row in read_rows(folder, names).to_table(names).to_pylist():
            self._note(row)

    def __contains__(self, run: int) -> bool:
        """Tests whether a run has a row."""
        return self._state[run] != _MISSING

    def missing(self) -> Iterator[int]:
        """Returns the numbers of the runs without a row."""
        return (number for number, state in enumerate(self._state) if state == _MISSING)

    @property
    def done(self) -> int:
        """Number of rows."""
        return len(self._state) - self._state.count(_MISSING)

    @property
    def failed(self) -> int:
        """Number of rows of failed runs."""
        return self._state.count(_BROKEN)

    def add(self, number: int, answer: dict[str, Any], by: str) -> None:
        """Stores the row of a run, also of a failed one.

        Raises:
            LeglabError: The row cannot be written.
        """
        self.keep(row_of(self._plan, number, answer, by))

    def keep(self, row: Mapping[str, Any]) -> None:
        """Stores a row.

        Raises:
            LeglabError: The row cannot be written.
        """
        with self._opened() as database:
            database.execute(self._insert, self._values(row))
        self._note(row)

    def propose(self, run: int, values: dict[str, float]) -> None:
        """Stores a proposed point by the number of its first run.

        Raises:
            LeglabError: The point cannot be written.
        """
        with self._opened() as database:
            database.execute("REPLACE INTO proposals VALUES (?, ?)", (run, json.dumps(values)))

    def forget_failed(self) -> None:
        """Deletes the rows of failed runs, so that the runs count as missing."""
        if (self._folder / DATASET).exists():
            dataset = read(Dataset, self._folder / DATASET)
            self._reopen(dataset, dataset.parts)
        with self._opened() as database:
            database.execute("DELETE FROM runs WHERE status = ?", (FAILED,))
        self._state = self._state.replace(bytes([_BROKEN]), bytes([_MISSING]))

    def finish(self) -> None:
        """Writes Parquet files, one per scenario and controller, with rows in order of the runs.

        Raises:
            LeglabError: A file cannot be written.
        """
        if (self._folder / DATASET).exists():
            return
        by = _names(PARTITION)
        with self._opened() as database:
            database.execute(f"CREATE INDEX IF NOT EXISTS places ON runs ({by})")
            places = database.execute(f"SELECT DISTINCT {by} FROM runs ORDER BY {by}").fetchall()
            parts = [self._write(database, place) for place in places]
            dataset = Dataset(parts=parts, proposals=_proposals(database))
        # From here on the files are the valid data.
        write_json(self._folder / DATASET, dataset.model_dump(), indent=1)
        self.close()
        self._remove_database()

    def close(self) -> None:
        """Closes the database and leaves its file without a write-ahead log, readable anywhere."""
        if self._database is not None:
            with suppress(sqlite3.Error):  # The journal mode cannot change during a read.
                self._database.execute("PRAGMA busy_timeout = 0")
                self._database.execute("PRAGMA journal_mode = DELETE")
            self._database.close()
            self._database = None

    @contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        """Yields the database, created if missing; converts SQLite errors to `FileError`."""
        path = self._folder / ROWS
        try:
            if self._database is None:
                if not path.exists():
                    self._create(path)
                self._database = _connect(path, "rwc")
            yield self._database
        except sqlite3.Error as error:
            raise FileError(f"{path}: cannot be written: {error}") from error

    def _create(self, path: Path) -> None:
        """Creates an empty database atomically."""
        new = path.with_name(f".{ROWS}.partial")
        remove([new])
        with closing(_connect(new, "rwc")) as database:
            runs = f"runs (run INTEGER PRIMARY KEY, {_names(self._schema.names[1:])})"
            for table in (runs, "proposals (run INTEGER PRIMARY KEY, point)"):
                database.execute(f"CREATE TABLE {table}")
        new.rename(path)

    def _reopen(self, dataset: Dataset, parts: Sequence[Part]) -> None:
        """Moves rows of Parquet files back into a database, which then is the valid data."""
        with self._opened() as database:
            database.execute("BEGIN")
            if parts:
                for batch in _files(self._folder, parts, self._schema).to_batches():
                    database.executemany(self._insert, map(self._values, batch.to_pylist()))
            for run, values in dataset.proposals.items():
                self.propose(run, values)
            database.execute("COMMIT")
        (self._folder / DATASET).unlink()

    def _values(self, row: Mapping[str, Any]) -> list[Any]:
        found = (row.get(name) for name in self._schema.names)
        return [json.dumps(x, allow_nan=False) if isinstance(x, list) else x for x in found]

    def _note(self, row: Mapping[str, Any]) -> None:
        self._state[row["run"]] = _BROKEN if row["status"] == FAILED else _DONE

    def _write(self, database: sqlite3.Connection, place: Sequence[str]) -> Part:
        """Writes the rows of one scenario and controller."""
        names = (f"{name}={quote(x, safe='')}" for name, x in zip(PARTITION, place, strict=True))
        path = self._folder.joinpath(_RUNS, *names, _PART)
        columns = pa.schema([field for field in self._schema if field.name not in PARTITION])
        where = " AND ".join(f"{name} = ?" for name in PARTITION)
        rows = database.execute(
            f"SELECT {_names(columns.names)} FROM runs WHERE {where} ORDER BY run", place
        )

        def write(stream: BinaryIO) -> None:
            options = {"compression": "zstd", "write_page_checksum": True}
            with pq.ParquetWriter(stream, columns, **options) as file:
                for table in _tables(rows, columns):
                    file.write_table(table)

        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise cannot_write(path.parent, error) from error
        write_atomically(path, write)
        return Part(
            file=path.relative_to(self._folder).as_posix(),
            rows=pq.read_metadata(path).num_rows,
            checksum=_checksum(path),
        )

    def _remove_database(self) -> None:
        remove(self._folder.glob(f"{ROWS}*"))


def put_aside(folder: Path) -> None:
    """Moves a sweep's files to the folder `.earlier`, where they stay until `forget_earlier`.

    An incomplete sweep that itself replaces another is removed instead: the earlier, complete
    sweep stays.

    Raises:
        LeglabError: A file cannot be moved.
    """
    if replaces(folder):
        remove(own(folder))
        return
    moving = folder / _MOVING
    try:
        moving.mkdir()
        for path in own(folder):
            path.rename(moving / path.name)
        moving.rename(folder / _EARLIER)
    except OSError as error:
        bring_back(folder)
        raise cannot_write(folder, error) from error


def bring_back(folder: Path) -> None:
    """Undoes an interrupted `put_aside`."""
    moving = folder / _MOVING
    for path in moving.glob("*"):
        path.rename(folder / path.name)
    if moving.exists():
        moving.rmdir()


def replaces(folder: Path) -> bool:
    """Tests whether a folder holds an earlier sweep that was put aside."""
    return (folder / _EARLIER).exists()


def forget_earlier(folder: Path) -> None:
    """Removes the earlier sweep that `put_aside` has kept."""
    remove([folder / _EARLIER])


def own(folder: Path) -> list[Path]:
    """Returns the existing files and folders of a sweep, `sweep.json` first."""
    found = [path for path in folder.iterdir() if is_own(path.name)]
    return sorted(found, key=lambda path: path.name != SWEEP)


def is_own(name: str) -> bool:
    """Tests whether a file of this name belongs to a sweep of this or an earlier version."""
    own = (SWEEP, DATASET, _RUNS, "recordings", "proposals.jsonl")
    return name in own or name.startswith((ROWS, "journal-"))
