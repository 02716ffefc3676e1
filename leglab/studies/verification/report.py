"""Runs all checks and prints them as tables."""

import math
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import asdict
from itertools import chain
from typing import Any

from rich.console import Console
from rich.table import Table

from leglab.base.errors import LeglabError
from leglab.studies.verification import replay
from leglab.studies.verification.bench import nominal_folder
from leglab.studies.verification.conformance import CASES
from leglab.studies.verification.rows import Row

_ROUNDING = 1e-11


def table(title: str, rows: Iterable[Row]) -> Table:
    """A table of rows, failures in red."""
    grid = Table(title=title, title_justify="left")
    for heading in (
        "case",
        "quantity",
        "solver",
        "expected",
        "got",
        "unit",
        "deviation",
        "allowed",
    ):
        right = heading in {"expected", "got", "deviation", "allowed"}
        grid.add_column(heading, justify="right" if right else "left")
    for row in rows:
        grid.add_row(
            row.case,
            row.quantity,
            row.solver,
            f"{row.expected:.6g}",
            f"{row.got:.6g}",
            row.unit,
            f"{row.deviation:.1e}",
            f"{row.tolerance:.0e}",
            style=None if row.passed else "bold red",
        )
    return grid


def summary(rows: Iterable[Row]) -> Table:
    """One line a case and solver: how many rows pass, and the one closest to its limit."""
    groups: dict[tuple[str, str], list[Row]] = defaultdict(list)
    for row in rows:
        groups[row.case, row.solver].append(row)
    grid = Table(title="Cases of physics.md: the row closest to its limit", title_justify="left")
    for heading in ("case", "solver", "passed", "closest row", "deviation", "allowed"):
        grid.add_column(heading)
    for (case, solver), group in groups.items():
        worst = max(group, key=lambda row: row.deviation / row.tolerance)
        passed = sum(row.passed for row in group)
        grid.add_row(
            case,
            solver,
            f"{passed} of {len(group)}",
            worst.quantity,
            f"{worst.deviation:.1e}",
            f"{worst.tolerance:.0e}",
            style=None if passed == len(group) else "bold red",
        )
    return grid


def markdown() -> str:
    """The row closest to its limit of each case as Markdown, in MuJoCo at 1 ms or the core."""
    lines = ["| case | closest row | deviation | allowed |", "|---|---|---|---|"]
    for name, case in CASES.items():
        rows = [row for row in case() if row.solver in ("core", "MuJoCo 1 ms")]
        worst = max(rows, key=lambda row: row.deviation / row.tolerance)
        # What is left of rounding differs between processors.
        exact = worst.deviation < _ROUNDING
        deviation = "rounding" if exact else f"{worst.deviation:.1e}"
        quantity = "all" if exact else worst.quantity
        lines.append(f"| {name} | {quantity} | {deviation} | {worst.tolerance:.0e} |")
    return "\n".join(lines) + "\n"


def verify(*, full: bool = True, console: Console | None = None) -> bool:
    """Compares the hydraulics with closed forms and with recordings of the knee bench.

    Args:
        full: Print every row, not only the summary.
        console: Where to print; standard output if None.

    Returns:
        Whether every check passed. Missing recordings are said and do not count as failures.
    """
    out = console or Console()
    if not out.is_terminal and console is None:
        out = Console(width=160)  # a file or a pipe: keep rows on one line
    rows = list(chain.from_iterable(case() for case in CASES.values()))
    if full:
        out.print(table("Cases of physics.md", rows))
    out.print(summary(rows))
    passed = all(row.passed for row in rows)
    try:
        folder = nominal_folder()
    except LeglabError as error:
        out.print(f"Replay of recordings left out: {error}")
        return passed
    results = list(replay.replay_all(folder))
    out.print(replay.table(results))
    return passed and all(result.passed for result in results)


def checks_as_json() -> dict[str, Any]:
    """Runs the checks of `verify`.

    Returns:
        As JSON can hold it: "passed" (whether all did), "checks" (one object a row), "replays" (one
        a recording and time step), "left_out" (why there are no replays, or None). What is not
        finite is None.
    """
    rows = list(chain.from_iterable(case() for case in CASES.values()))
    found: dict[str, Any] = {
        "passed": all(row.passed for row in rows),
        "checks": [_as_json(row, deviation=row.deviation, passed=row.passed) for row in rows],
        "replays": [],
        "left_out": None,
    }
    try:
        folder = nominal_folder()
    except LeglabError as error:
        return {**found, "left_out": str(error)}
    results = list(replay.replay_all(folder))
    found["replays"] = [_as_json(result, passed=result.passed) for result in results]
    found["passed"] = found["passed"] and all(result.passed for result in results)
    return found


def _as_json(row: Row | replay.Replay, **more: Any) -> dict[str, Any]:
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in {**asdict(row), **more}.items()
    }
