"""Report of all checks, as tables or JSON."""

import math
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import asdict
from itertools import chain
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.measured import shared_data
from benchmarks.verification.cases import CASES, Check
from benchmarks.verification.replay import LIMITS, ReplayCheck, replay_all
from leglab.base.errors import LeglabError
from leglab.base.tables import print_whole


def _table(title: str, head: str, rows: Iterable[tuple[bool, Iterable[str]]], right: str) -> Table:
    """Builds a table of (passed, cells) rows, failures in red; columns in `right` align right."""
    grid = Table(title=title, title_justify="left")
    for heading in head.split(", "):
        grid.add_column(heading, justify="right" if heading in right.split(", ") else "left")
    for passed, cells in rows:
        grid.add_row(*cells, style=None if passed else "bold red")
    return grid


def closest(rows: Iterable[Check]) -> Check:
    """Returns the row closest to its limit."""
    return max(rows, key=lambda row: row.deviation / row.tolerance)


def _row_table(rows: Iterable[Check]) -> Table:
    lines = []
    for row in rows:
        values = f"{row.expected:.6g}", f"{row.got:.6g}", row.unit
        deviation = f"{row.deviation:.1e}", f"{row.tolerance:.0e}"
        cells = row.case, row.quantity, row.solver, *values, *deviation
        lines.append((row.passed, cells))
    head = "case, quantity, solver, expected, got, unit, deviation, allowed"
    return _table(
        "Cases of docs/concepts/physics.md", head, lines, "expected, got, deviation, allowed"
    )


def _summary(rows: Iterable[Check]) -> Table:
    """Builds a table by case and solver: number of passed rows, and row closest to its limit."""
    groups: dict[tuple[str, str], list[Check]] = defaultdict(list)
    for row in rows:
        groups[row.case, row.solver].append(row)
    lines = []
    for key, group in groups.items():
        worst, passed = closest(group), sum(row.passed for row in group)
        deviation = f"{worst.deviation:.1e}", f"{worst.tolerance:.0e}"
        cells = *key, f"{passed} of {len(group)}", worst.quantity, *deviation
        lines.append((passed == len(group), cells))
    head = "case, solver, passed, closest row, deviation, allowed"
    return _table(
        "Cases of docs/concepts/physics.md: the row closest to its limit", head, lines, ""
    )


def _replay_table(results: Iterable[ReplayCheck]) -> Table:
    """Builds a table of RMS errors at window ends and their limits."""
    lines = []
    for r in results:
        knee, pressure = LIMITS[r.recording]
        errors = f"{r.position * 1e3:.3f}", f"{r.pressure_a / 1e5:.2f}", f"{r.pressure_b / 1e5:.2f}"
        asked = f"{knee * 1e3:g} / {pressure / 1e5:g}"
        cells = r.recording, str(r.count), f"{r.timestep * 1e3:g}", *errors, asked
        lines.append((r.passed, cells))
    head = "recording, windows, step ms, knee mrad, pA bar, pB bar, asked"
    return _table("Replay of knee_bench/nominal over 0.3 s windows", head, lines, "")


def _run() -> tuple[list[Check], list[ReplayCheck], str | None]:
    """Runs all cases and replays; returns the results, and the reason if replays are left out."""
    rows = list(chain.from_iterable(case() for case in CASES.values()))
    try:
        folder = shared_data("knee_bench/nominal")
    except LeglabError as error:
        return rows, [], str(error)
    return rows, list(replay_all(folder)), None


def _passed(rows: list[Check], replays: list[ReplayCheck]) -> bool:
    return all(row.passed for row in rows) and all(result.passed for result in replays)


def verify(console: Console | None = None) -> bool:
    """Compares the hydraulics with closed forms and with recordings of the knee bench.

    Args:
        console: Where to print; standard output if None.

    Returns:
        Whether every check passed. Missing recordings are reported and do not count as failures.
    """
    out = console or Console()
    if not out.is_terminal and console is None:
        out = Console(width=160)  # a file or a pipe: keep rows on one line
    rows, replays, left_out = _run()
    print_whole(out, _row_table(rows))
    print_whole(out, _summary(rows))
    if left_out:
        out.print(f"Replay of recordings left out: {left_out}")
    else:
        print_whole(out, _replay_table(replays))
    return _passed(rows, replays)


def checks_as_json() -> dict[str, Any]:
    """Runs the checks of `verify`.

    Returns:
        JSON values: "passed" (whether all checks passed), "checks" (one object per row), "replays"
        (one per recording and time step), "left_out" (why there are no replays, or None). Numbers
        that are not finite become None.
    """
    rows, replays, left_out = _run()
    return {
        "passed": _passed(rows, replays),
        "checks": [_as_json(row, deviation=row.deviation) for row in rows],
        "replays": [_as_json(result) for result in replays],
        "left_out": left_out,
    }


def _as_json(result: Check | ReplayCheck, **more: Any) -> dict[str, Any]:
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in {**asdict(result), **more, "passed": result.passed}.items()
    }
