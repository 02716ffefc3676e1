"""Outcomes of a self-test in a file, one JSON line a case, so that an interrupted test goes on."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from leglab.base.errors import SimulationError
from leglab.jobs.engine import answers
from leglab.jobs.work import Work

Case = TypeVar("Case")
Result = TypeVar("Result")
Key = tuple[str, int]  # kind and number

# A diagnosis may take so long [s].
_TIMEOUT = 4 * 3600.0


def run_missing(
    path: Path,
    cases: Sequence[Case],
    work: Work,
    *,
    key: Callable[[Case | Result], Key],
    parse: Callable[[Any], Result],
    done: Callable[[Result], bool] = lambda _: True,
    settings: dict[str, Any] | None = None,
    processes: int = -1,
    scheduler: str | None = None,
    progress: Callable[[str, int, int], None] = lambda *_: None,
) -> list[Result]:
    """Runs the cases whose outcome a file lacks, adds them to it, and returns all.

    Args:
        path: One JSON line an outcome.
        cases: All cases, dataclasses; they run in an order in which each kind is always as far as
            the others.
        work: Makes an outcome, as JSON can hold it; it is given `case` and `settings` likewise.
        key: Kind and number of a case, or of an outcome.
        parse: Result of a decoded line.
        done: Whether an outcome counts; a case without one that does runs again.
        settings: What all cases share.
        processes: Cases at a time; -1 is one a core, 1 this process. With a scheduler -1.
        scheduler: Address of a Dask scheduler whose workers run the cases.
        progress: Called with the last case, the number done and the total.

    Raises:
        LeglabError: A case came to no outcome; those of the others are kept.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    wanted = {key(case) for case in cases}
    found = {key(o): o for o in map(parse, _rows(path)) if key(o) in wanted and done(o)}
    rest = [case for case in cases if key(case) not in found]
    counts = {kind: sum(k == kind for k, _ in wanted) for kind, _ in wanted}
    rest.sort(key=lambda case: (key(case)[1] + 0.5) / counts[key(case)[0]])
    progress("", len(found), len(cases))
    given = (
        (number, {"case": asdict(case), "settings": settings or {}})  # type: ignore[call-overload]
        for number, case in enumerate(rest)
    )
    problems = []
    with path.open("a") as stream:
        for place, answer, _ in answers(
            work, given, workers=processes, scheduler=scheduler, timeout=_TIMEOUT
        ):
            kind, number = key(rest[place])
            if "result" not in answer:
                problems.append(f"case {kind} {number}: {answer.get('error')}")
                continue
            stream.write(json.dumps(answer["result"]) + "\n")
            stream.flush()
            found[kind, number] = parse(answer["result"])
            progress(f"{kind} {number}", len(found), len(cases))
    if problems:
        others = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise SimulationError(f"{problems[0]}{others}; the other outcomes are in {path}")
    return [found[key(case)] for case in cases]


def _rows(path: Path) -> list[Any]:
    rows = []
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:  # the line that an interruption cut off
            continue
    return rows
