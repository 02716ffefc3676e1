"""The dataset of a sweep on disk: Parquet files, and a journal of the rows that came last.

    FOLDER/sweep.json       what the sweep is: its plan, digests, number of runs
    FOLDER/dataset.json     the files of the dataset, and which journal goes on from them
    FOLDER/journal-7.jsonl  rows since then, a line each behind its checksum
    FOLDER/proposals.jsonl  points of tuned blocks, a line each behind its checksum
    FOLDER/runs/scenario=NAME/controller=NAME/part-000007-0.parquet
    FOLDER/.earlier         the sweep that this one replaces, until this one is whole

A row is kept as soon as its line is written, so that an end at any moment loses runs that were
being made, and no row. After some thousand rows, and at the end, the journal becomes Parquet files.
What counts is `dataset.json`, which is replaced as a whole: files that it does not name are left
over from an end in between, and go. So no row is lost or there twice.
"""

import json
import os
import zlib
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import quote, unquote

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pydantic import BaseModel, Field, ValidationError

from leglab.base.errors import FileError, LeglabError
from leglab.base.input import parse_json, read_bytes, read_json
from leglab.base.output import cannot_write, remove, write_atomically
from leglab.base.settings import first_problem
from leglab.data.files import first_line
from leglab.runs.sweeps.rows import FAILED, PARTITION

SWEEP, DATASET, PROPOSALS = "sweep.json", "dataset.json", "proposals.jsonl"
_RUNS = "runs"
# The sweep that is being replaced, and the same while its files are moved there.
_EARLIER, _MOVING = ".earlier", ".earlier.partial"
# Rows that the journal holds before they become Parquet.
_JOURNAL_ROWS = 10_000
# Files of a partition with fewer rows than these are put together at the end.
_PART_ROWS = 200_000
_MISSING, _DONE, _BROKEN = 0, 1, 2


class Part(BaseModel):
    """A Parquet file of the dataset.

    Attributes:
        file: Its path below the folder.
        rows: How many it has.
        bytes: Its size.
        checksum: CRC-32 of its content: those of pages leave out what describes them.
    """

    file: str
    rows: Annotated[int, Field(ge=0)]
    bytes: Annotated[int, Field(ge=0)]
    checksum: Annotated[int, Field(ge=0)]


class Dataset(BaseModel):
    """Content of `dataset.json`."""

    generation: Annotated[int, Field(ge=0)] = 0
    parts: list[Part] = []

    @property
    def journal(self) -> str:
        """Name of the journal that goes on from these parts."""
        return f"journal-{self.generation}.jsonl"


class SweepRecord(BaseModel):
    """Content of `sweep.json`.

    Attributes:
        plan: Content of the sweep's file.
        digest: Of the plan.
        code: Digest of leglab's code.
        models: Digests of the compiled models.
        runs: Number of runs.
        axes: Settings in which they differ.
        version: Of leglab.
        load: What `--load` named, as one would give it again.
    """

    plan: dict[str, Any]
    digest: str
    code: str
    models: dict[str, str]
    runs: Annotated[int, Field(ge=1)]
    axes: list[str]
    version: str
    load: list[str] = []


def is_sweep(folder: Path) -> bool:
    """Whether a folder holds a sweep."""
    return (folder / SWEEP).is_file()


def read_record(folder: Path) -> SweepRecord:
    """Reads what a sweep is.

    Raises:
        LeglabError: The folder holds none, or the file does not have the form.
    """
    if not is_sweep(folder):
        raise FileError(f"{str(folder)!r} holds no sweep: it has no {SWEEP}", given=folder)
    return _read(SweepRecord, folder / SWEEP)


def _read(model: Any, path: Path) -> Any:
    try:
        return model.model_validate(read_json(path))
    except ValidationError as error:
        where, reason = first_problem(error)
        raise FileError(f"{path}: {where or 'content'}: {reason}", given=path) from error


@dataclass(frozen=True, kw_only=True)
class Rows:
    """All rows of a sweep as they are stored: files, and what came after them.

    Attributes:
        files: Parquet files.
        late: Rows of the journal.
        schema: Columns.
    """

    files: tuple[Path, ...]
    late: pa.Table
    schema: pa.Schema
    folder: Path

    def parts(self) -> Any:
        """The files as one `pyarrow.dataset.Dataset`, whose pages are checked as they are read."""
        import pyarrow.dataset as pd  # imports pandas where that is installed

        checked = pd.ParquetFragmentScanOptions(page_checksum_verification=True)
        partition = pa.schema([self.schema.field(name) for name in PARTITION])
        return pd.dataset(
            [str(path) for path in self.files],
            schema=self.schema,
            format=pd.ParquetFileFormat(default_fragment_scan_options=checked),
            partitioning=pd.HivePartitioning(partition, segment_encoding="uri"),
            partition_base_dir=str(self.folder / _RUNS),
        )

    def table(self, columns: Sequence[str] | None = None) -> pa.Table:
        """Rows in the order of the runs.

        Args:
            columns: Names; None for all.

        Raises:
            LeglabError: A file is damaged.
        """
        wanted = list(columns or self.schema.names)
        asked = list(dict.fromkeys([*wanted, "run"]))
        tables = [self.late.select(asked), *(self._part(path, asked) for path in self.files)]
        return pa.concat_tables(tables).sort_by("run").select(wanted)

    def _part(self, path: Path, names: Sequence[str]) -> pa.Table:
        """Columns of one file; those of the partition stand in its path."""
        try:
            with pq.ParquetFile(path, page_checksum_verification=True) as file:
                found = file.read(columns=[name for name in names if name not in PARTITION])
                told = dict(part.split("=", 1) for part in path.parts if "=" in part)
                columns = {
                    name: pa.repeat(unquote(told[name]), len(found))
                    if name in PARTITION
                    else found.column(name)
                    for name in names
                }
                return pa.table(columns, pa.schema([self.schema.field(name) for name in names]))
        except (pa.ArrowException, OSError, KeyError, ValueError) as error:
            raise FileError(
                f"{path}: is damaged ({first_line(error)}); leglab sweep removes it and makes its "
                "runs again",
                given=path,
            ) from error


def read_rows(folder: Path, schema: pa.Schema) -> Rows:
    """Finds all rows of a sweep, also while it is being made.

    Args:
        folder: Of the sweep.
        schema: From `leglab.runs.sweeps.rows.schema`.

    Raises:
        LeglabError: A file is missing or cut off, or `dataset.json` does not have the form.
    """
    for _ in range(5):
        found: Dataset = _read(Dataset, folder / DATASET)
        lines = _journal(folder / found.journal)
        files = tuple(folder / part.file for part in found.parts)
        problems = [_problem(folder, part) for part in found.parts]
        # A sweep that runs may have replaced its files meanwhile.
        if _read(Dataset, folder / DATASET).generation == found.generation:
            break
    for problem in problems:
        if problem:
            raise FileError(f"{problem}; leglab sweep removes it and makes its runs again")
    return Rows(
        files=files,
        late=pa.Table.from_pylist(lines, schema=schema),
        schema=schema,
        folder=folder,
    )


def _problem(folder: Path, part: Part) -> str:
    """Fault of a file; empty without one."""
    path = folder / part.file
    try:
        size, found = path.stat().st_size, _checksum(path)
    except OSError as error:
        return f"{path}: cannot be read: {error.strerror}"
    if size != part.bytes:
        return f"{path}: has {size} bytes of {part.bytes}: it is cut off"
    return "" if found == part.checksum else f"{path}: is damaged: its checksum is another"


def _checksum(path: Path) -> int:
    found = 0
    with path.open("rb") as stream:
        while content := stream.read(1 << 20):
            found = zlib.crc32(content, found)
    return found


def _line(row: dict[str, Any]) -> bytes:
    text = json.dumps(row, allow_nan=False).encode()
    return b"%08x %s\n" % (zlib.crc32(text), text)


def _journal(path: Path) -> list[dict[str, Any]]:
    """Rows of a journal; a line that was cut off or changed is no row, its run is made again."""
    if not path.exists():
        return []
    rows = []
    for line in read_bytes(path).split(b"\n"):
        checksum, _, text = line.partition(b" ")
        try:
            if int(checksum, 16) == zlib.crc32(text):
                row = parse_json(text)
                if isinstance(row, dict) and isinstance(row.get("run"), int):
                    rows.append(row)
        except ValueError:
            continue
    return rows


def keep_proposal(folder: Path, run: int, values: dict[str, float]) -> None:
    """Keeps a proposed point: it is safe when this returns.

    Args:
        folder: Of the sweep, which is claimed.
        run: Number of the first run of the point.
        values: Of the ranges, by dotted name.

    Raises:
        LeglabError: It cannot be written.
    """
    try:
        with (folder / PROPOSALS).open("ab") as file:
            # Behind what an end in the middle of a line has left.
            file.write(b"\n" + _line({"run": run, "values": values}))
    except OSError as error:
        raise cannot_write(folder / PROPOSALS, error) from error


def read_proposals(folder: Path) -> dict[int, dict[str, float]]:
    """Proposed points by the number of their first run."""
    return {row["run"]: row["values"] for row in _journal(folder / PROPOSALS)}


class Store:
    """The dataset of a sweep that is being made; nobody else writes to it.

    Args:
        folder: Of the sweep, which is claimed.
        record: What the sweep is.
        schema: Columns of its rows.

    Attributes:
        damaged: What was wrong with files that were removed; their runs are missing now.

    Raises:
        LeglabError: The folder cannot be read or written.
    """

    def __init__(self, folder: Path, record: SweepRecord, schema: pa.Schema) -> None:
        self._folder, self._schema, self._runs = folder, schema, record.runs
        self._state = bytearray(record.runs)
        self.damaged: list[str] = []
        self._dataset = Dataset()
        if (folder / DATASET).exists():
            self._dataset = _read(Dataset, folder / DATASET)
        else:
            write_json(self._dataset, folder / DATASET)
        self._sweep_out()
        whole = [part for part in self._dataset.parts if self._is_whole(part)]
        self._journal_file: int | None = None
        self._pending = [row for row in _journal(folder / self._dataset.journal) if self._fits(row)]
        for row in self._pending:
            self._note(row)
        if len(whole) < len(self._dataset.parts):
            self._replace(whole, self._take_pending())

    def _fits(self, row: dict[str, Any]) -> bool:
        return 0 <= row["run"] < self._runs and set(row) <= set(self._schema.names)

    def missing(self, *, failed: bool = False) -> Iterator[int]:
        """Numbers of the runs without a row, and of those that failed if asked for."""
        state = self._state
        wanted = (_MISSING, _BROKEN) if failed else (_MISSING,)
        return (number for number in range(self._runs) if state[number] in wanted)

    @property
    def done(self) -> int:
        """Number of rows."""
        return self._runs - self._state.count(_MISSING)

    @property
    def failed(self) -> int:
        """Number of rows of failed runs."""
        return self._state.count(_BROKEN)

    def add(self, row: dict[str, Any]) -> None:
        """Keeps a row: it is safe when this returns.

        Raises:
            LeglabError: It cannot be written.
        """
        path = self._folder / self._dataset.journal
        try:
            if self._journal_file is None:
                flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC
                self._journal_file = os.open(path, flags, 0o666)
                # Behind what an end in the middle of a line has left.
                os.write(self._journal_file, b"\n")
            line = memoryview(_line(row))
            while line:
                line = line[os.write(self._journal_file, line) :]
        except OSError as error:
            raise cannot_write(path, error) from error
        self._pending.append(row)
        self._note(row)
        if len(self._pending) >= _JOURNAL_ROWS:
            self.flush()

    def flush(self) -> None:
        """Turns the journal into Parquet files."""
        if self._pending:
            self._replace(self._dataset.parts, self._take_pending())

    def compact(self) -> None:
        """Puts small files of a partition together, each then in the order of the runs."""
        self.flush()
        small = defaultdict(list)
        for part in self._dataset.parts:
            if part.rows < _PART_ROWS:
                small[str(Path(part.file).parent)].append(part)
        for parts in small.values():  # One partition at a time has to fit into memory.
            if len(parts) > 1:
                kept = [part for part in self._dataset.parts if part not in parts]
                self._replace(kept, self._table(parts))

    def forget_failed(self) -> None:
        """Drops the rows of failed runs, which are missing from then on."""
        self.flush()
        for part in list(self._dataset.parts):
            table = self._table([part])
            failed = pc.equal(table.column("status"), FAILED)
            if pc.any(failed).as_py():
                kept = [other for other in self._dataset.parts if other is not part]
                self._replace(kept, table.filter(pc.invert(failed)))
        for number in range(self._runs):
            if self._state[number] == _BROKEN:
                self._state[number] = _MISSING

    def close(self) -> None:
        """Closes the journal, which stays."""
        if self._journal_file is not None:
            os.close(self._journal_file)
            self._journal_file = None

    def _note(self, row: dict[str, Any]) -> None:
        self._state[row["run"]] = _BROKEN if row["status"] == FAILED else _DONE

    def _take_pending(self) -> pa.Table:
        rows, self._pending = self._pending, []
        return pa.Table.from_pylist(rows, schema=self._schema).sort_by("run")

    def _table(self, parts: Sequence[Part]) -> pa.Table:
        return Rows(
            files=tuple(self._folder / part.file for part in parts),
            late=self._schema.empty_table(),
            schema=self._schema,
            folder=self._folder,
        ).table()

    def _is_whole(self, part: Part) -> bool:
        """Whether a file can be read to its end; notes its rows."""
        problem = _problem(self._folder, part)
        if not problem:
            try:
                table = self._table([part]).select(["run", "status"])
                if len(table) != part.rows:
                    problem = f"{part.file}: has {len(table)} rows of {part.rows}"
                elif not all(0 <= run < self._runs for run in table.column("run").to_pylist()):
                    problem = f"{part.file}: holds rows of another sweep"
            except LeglabError as error:
                problem = str(error)
        if problem:
            self.damaged.append(f"{part.file} is damaged; its {part.rows} runs are made again")
            return False
        for row in table.to_pylist():
            self._note(row)
        return True

    def _replace(self, kept: Sequence[Part], rows: pa.Table) -> None:
        """Makes files of rows and puts them, with files that are kept, in the place of all."""
        generation = self._dataset.generation + 1
        places = rows.group_by(list(PARTITION)).aggregate([]).to_pylist()
        made = [self._write(place, rows, generation) for place in places]
        dataset = Dataset(generation=generation, parts=[*kept, *made])
        write_json(dataset, self._folder / DATASET)  # From here on the new files count.
        self.close()
        self._dataset = dataset
        self._sweep_out()

    def _write(self, place: Mapping[str, str], rows: pa.Table, generation: int) -> Part:
        for name, value in place.items():
            rows = rows.filter(pc.equal(rows.column(name), value))
        names = (f"{name}={quote(value, safe='')}" for name, value in place.items())
        path = self._folder.joinpath(_RUNS, *names, f"part-{generation:06d}.parquet")
        table = rows.drop_columns(list(PARTITION))
        options = {"compression": "zstd", "write_page_checksum": True}
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise cannot_write(path.parent, error) from error
        write_atomically(path, lambda stream: pq.write_table(table, stream, **options))
        file = path.relative_to(self._folder).as_posix()
        size = path.stat().st_size
        return Part(file=file, rows=len(table), bytes=size, checksum=_checksum(path))

    def _sweep_out(self) -> None:
        """Removes what the dataset does not name."""
        known = {self._folder / part.file for part in self._dataset.parts}
        for path in (self._folder / _RUNS).glob("*/*/*"):
            if path not in known:
                path.unlink(missing_ok=True)
        for path in self._folder.glob("journal-*.jsonl"):
            if path.name != self._dataset.journal:
                path.unlink(missing_ok=True)


def write_json(content: BaseModel, path: Path) -> None:
    """Writes a content as JSON, as a whole or not at all."""
    text = json.dumps(content.model_dump(), indent=1, allow_nan=False) + "\n"
    write_atomically(path, lambda stream: stream.write(text.encode()))


def empty(folder: Path) -> None:
    """Removes a sweep's files from its folder, the one by which it is known first."""
    remove(_own(folder))


def put_aside(folder: Path) -> None:
    """Moves a sweep's files to where they stay until `forget_earlier`.

    A sweep that replaces another, and is replaced itself before it is whole, is removed: the one
    that was whole stays.

    Raises:
        LeglabError: A file cannot be moved.
    """
    if replaces(folder):
        empty(folder)
        return
    moving = folder / _MOVING
    try:
        moving.mkdir()
        for path in _own(folder):
            path.rename(moving / path.name)
        moving.rename(folder / _EARLIER)
    except OSError as error:
        bring_back(folder)
        raise cannot_write(folder, error) from error


def bring_back(folder: Path) -> None:
    """Undoes a `put_aside` that did not come to its end."""
    moving = folder / _MOVING
    for path in moving.glob("*"):
        path.rename(folder / path.name)
    if moving.exists():
        moving.rmdir()


def replaces(folder: Path) -> bool:
    """Whether a folder holds a sweep that was put aside for another."""
    return (folder / _EARLIER).exists()


def forget_earlier(folder: Path) -> None:
    """Removes what `put_aside` has kept."""
    remove([folder / _EARLIER])


def _own(folder: Path) -> list[Path]:
    """Files and folders of a sweep that are there, the one by which it is known first."""
    names = (SWEEP, DATASET, PROPOSALS, _RUNS, "recordings")
    found = [folder / name for name in names if (folder / name).exists()]
    return [*found, *folder.glob("journal-*.jsonl")]
