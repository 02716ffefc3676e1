"""Outcomes of a self-test in a file, one JSON line a case, so that an interrupted test goes on."""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from leglab.base.errors import SettingsError, SimulationError
from leglab.jobs.engine import Progress, Results, executor, make_missing
from leglab.jobs.work import Work

Case = TypeVar("Case")
Result = TypeVar("Result")
Key = tuple[str, int]  # kind and number

# A diagnosis may take so long [s].
TIMEOUT = 4 * 3600.0


def run_missing(
    path: Path,
    cases: Sequence[Case],
    work: Work,
    *,
    parse: Callable[[Any], Result],
    done: Callable[[Result], bool] = lambda _: True,
    settings: dict[str, Any] | None = None,
    processes: int = -1,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> list[Result]:
    """Runs the cases whose outcome a file lacks, adds them to it, and returns all.

    Args:
        path: One JSON line an outcome.
        cases: All cases, dataclasses; they run in an order in which each kind is always as far as
            the others.
        work: Makes an outcome, as JSON can hold it; it is given `case` and `settings` likewise.
        parse: Result of a decoded line; cases and outcomes have a `kind` and a `number`.
        done: Whether an outcome counts; a case without one that does runs again.
        settings: What all cases share.
        processes: Cases at a time; -1 is one a core, 1 this process. With a scheduler -1.
        scheduler: Address of a Dask scheduler whose workers run the cases.
        progress: Called with the number done, the total and the last case.

    Raises:
        LeglabError: A case came to no outcome; those of the others are kept.
    """

    def key(one: Any) -> Key:
        return one.kind, one.number

    by_key = {key(case): case for case in cases}
    kept = lines(path, key, parse, done)
    counts = Counter(kind for kind, _ in by_key)
    problems = make_missing(
        executor(work, processes, scheduler, timeout=TIMEOUT),
        sorted(by_key, key=lambda one: (one[1] + 0.5) / counts[one[0]]),
        kept,
        lambda one: {"case": asdict(by_key[one]), "settings": settings or {}},  # type: ignore[call-overload]
        told=lambda one: f"{one[0]} {one[1]}",
        progress=progress,
    )
    for (kind, number), problem in problems.items():
        others = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise SimulationError(
            f"case {kind} {number}: {problem}{others}; the other outcomes are in {path}"
        )
    return [kept[one] for one in by_key]


def numbers(shares: Mapping[str, float], kinds: Iterable[str], count: int) -> dict[str, int]:
    """Cases of each of some kinds, by their shares of a count.

    Raises:
        LeglabError: A kind does not exist.
    """
    for kind in kinds:
        if kind not in shares:
            raise SettingsError.unknown("kind of case", kind, shares)
    return {k: max(1, round(share * count)) for k, share in shares.items() if k in kinds}


def lines(
    path: Path,
    key: Callable[[Any], Any],
    parse: Callable[[Any], Any] = dict,
    done: Callable[[Any], bool] = lambda _: True,
) -> Results:
    """Outcomes that a file holds, one JSON line each; to it those are added that come."""
    found = []
    path.parent.mkdir(parents=True, exist_ok=True)
    for line in path.read_text().splitlines() if path.exists() else ():
        with suppress(json.JSONDecodeError):  # the line that an interruption cut off
            found.append(parse(json.loads(line)))

    def keep(_: Any, row: Any) -> Any:
        with path.open("a") as stream:
            stream.write(json.dumps(row) + "\n")
        return parse(row)

    return Results({key(one): one for one in found if done(one)}, keep)
