"""Outcomes of a self-test in a file, one JSON line a case, so that an interrupted test goes on."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from leglab.runs.parallel import in_processes

Case = TypeVar("Case")
Result = TypeVar("Result")
Key = tuple[str, int]  # kind and number


def run_missing(
    path: Path,
    cases: Sequence[Case],
    run: Callable[[Case], Result],
    *,
    key: Callable[[Case | Result], Key],
    parse: Callable[[Any], Result],
    done: Callable[[Result], bool] = lambda _: True,
    processes: int = 2,
    progress: Callable[[str, int, int], None] = lambda *_: None,
) -> list[Result]:
    """Runs the cases whose outcome a file lacks, adds them to it, and returns all.

    Args:
        path: One JSON line an outcome.
        cases: All cases; they run in an order in which each kind is always as far as the others.
        run: Makes an outcome, a dataclass.
        key: Kind and number of a case, or of an outcome.
        parse: Result of a decoded line.
        done: Whether an outcome counts; a case without one that does runs again.
        processes: Cases at a time.
        progress: Called with the last case, the number done and the total.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    wanted = {key(case) for case in cases}
    found = {key(o): o for o in map(parse, _rows(path)) if key(o) in wanted and done(o)}
    rest = [case for case in cases if key(case) not in found]
    counts = {kind: sum(k == kind for k, _ in wanted) for kind, _ in wanted}
    rest.sort(key=lambda case: (key(case)[1] + 0.5) / counts[key(case)[0]])
    progress("", len(found), len(cases))
    with path.open("a") as stream:
        for outcome in in_processes(run, rest, jobs=processes):
            stream.write(json.dumps(asdict(outcome)) + "\n")  # type: ignore[call-overload]
            stream.flush()
            kind, number = key(outcome)
            found[kind, number] = outcome
            progress(f"{kind} {number}", len(found), len(cases))
    return [found[key(case)] for case in cases]


def _rows(path: Path) -> list[Any]:
    rows = []
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:  # the line that an interruption cut off
            continue
    return rows
