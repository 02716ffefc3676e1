"""Read-only SQL queries on the rows of a sweep by DuckDB, without access to other files."""

import csv
import io
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from leglab.base.errors import SettingsError
from leglab.base.notebook import data_frame, html_table
from leglab.base.output import write_atomically
from leglab.runs.sweeps import store

TABLE = "runs"
_FEW = 4  # significant digits in a table
_SHOWN = 50  # rows of a table in a notebook


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Result of a query."""

    names: tuple[str, ...]  #: Names of the columns
    rows: tuple[tuple[Any, ...], ...]  #: Rows with the values of the columns

    def __repr__(self) -> str:
        return f"Answer({len(self.rows)} rows; {len(self.names)} columns: {', '.join(self.names)})"

    def _repr_html_(self) -> str:
        text = f"{len(self.rows)} rows" + (f", the first {_SHOWN}" * (len(self.rows) > _SHOWN))
        return html_table(text, self.names, self.cells()[:_SHOWN])

    def to_pandas(self) -> Any:
        """Returns the rows as a `pandas.DataFrame`.

        Raises:
            LeglabError: pandas is missing.
        """
        return data_frame(list(self.rows), columns=list(self.names))

    def records(self) -> list[dict[str, Any]]:
        """Returns the rows as JSON-serialisable dicts; NaN and infinity become None."""
        return [dict(zip(self.names, map(_plain, row), strict=True)) for row in self.rows]

    def cells(self) -> list[list[str]]:
        """Returns the rows as text, numbers with four significant digits."""
        return [[_cell(value) for value in row] for row in self.rows]

    def write_csv(self, path: Path | None) -> None:
        """Writes the rows as CSV with all digits.

        Args:
            path: The file; None for standard output.

        Raises:
            LeglabError: The file cannot be written.
        """
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.names)
        writer.writerows([_plain(value) for value in row] for row in self.rows)
        if path is None:
            sys.stdout.write(text.getvalue())
        else:
            write_atomically(path, lambda stream: stream.write(text.getvalue().encode()))


def ask(folder: str | Path, sql: str) -> Answer:
    """Runs an SQL query on the rows of a sweep, also while the sweep is being made.

    Args:
        folder: Folder of the sweep.
        sql: One SELECT in DuckDB's SQL; the table is named `runs`.

    Raises:
        LeglabError: The folder holds no sweep, a file is damaged, or the query fails; the message
            is one line.
    """
    with questions(Path(folder)) as answered:
        return answered(sql)


@contextmanager
def questions(folder: Path) -> Iterator[Callable[[str], Answer]]:
    """Yields a function that runs queries as `ask` does, all on the rows that exist now.

    Raises:
        LeglabError: As in `ask`.
    """
    import duckdb

    rows = store.read_rows(folder)
    with duckdb.connect(":memory:") as database:
        # From here on queries cannot access files, the network or variables of this program.
        database.execute("SET enable_external_access = false")
        database.execute("SET python_enable_replacements = false")
        database.execute("SET lock_configuration = true")
        database.register(TABLE, rows)

        def answered(sql: str) -> Answer:
            try:
                statements = database.extract_statements(sql)
                kinds = (duckdb.StatementType.SELECT, duckdb.StatementType.EXPLAIN)
                if len(statements) != 1 or statements[0].type not in kinds:
                    allowed = "one SELECT, for instance: SELECT * FROM runs"
                    raise SettingsError("allowed is ", given=sql, allowed=allowed)
                found = database.execute(statements[0])
                names = tuple(column[0] for column in found.description or ())
                return Answer(names=names, rows=tuple(found.fetchall()))
            except duckdb.Error as error:
                told = " ".join(str(error).partition("\n\nLINE ")[0].split())
                raise SettingsError(f"SQL: {told}", given=sql) from error

        yield answered


def _plain(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    return value if isinstance(value, int | str | None) else str(value)


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.{_FEW}g}"
    return str(_plain(value))
