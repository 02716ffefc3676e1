"""Confidence of the diagnosis over kept tables of sets: are names as often right as they claim?

Reads outcomes of `diagnosis_self_test` and `diagnosis_scales`, which keep the table that each
verdict was judged by, and judges every table again: as it is, without each factor of the
confidence, and with each chosen number halved and doubled.
"""

import argparse
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import results
from benchmarks.self_test.figures import reliability_figure
from benchmarks.self_test.rough import CLAIM, DOUBT, SURE, binned
from leglab.base.errors import FileError
from leglab.base.output import write_atomically
from leglab.diagnosis import thresholds
from leglab.diagnosis.thresholds import EXPLANATION
from leglab.diagnosis.verdict.confidence import Judgement, judge
from leglab.diagnosis.verdict.table import Table
from leglab.report.style import style
from rigs.rough_bench import effect_of

Change = Callable[[Table], Table]
_ALLOWED = "outcomes of diagnosis_self_test or diagnosis_scales, one JSON line each"


@dataclass(frozen=True)
class Case:
    """A kept table, and what was hidden."""

    hidden: tuple[str, ...]  #: Effects that were there
    table: Table
    named: tuple[str, ...]  #: Names that the diagnosis gave
    explained: float  #: Share of the errors that these explain


def _each(change: Callable[..., Any]) -> Change:
    return lambda table: replace(table, sets=tuple(change(one) for one in table.sets))


def _members(**changes: Any) -> Change:
    """Changes all members of all sets."""
    return _each(
        lambda one: replace(one, members=tuple(replace(m, **changes) for m in one.members))
    )


def _all_contained(table: Table) -> Table:
    return replace(table, contains=tuple((a, b) for a in table.effects for b in table.effects))


# Tables that one factor of the confidence does not lower.
FACTORS: dict[str, Change] = {
    "as it is": lambda table: table,
    "without: a part of the recordings left out": _each(
        lambda one: replace(one, apart=(one.log,) * len(one.apart))
    ),
    "without: in units of the drive": _each(lambda one: replace(one, drive=0.0)),
    # Impostors that explain nothing: each cause is in the library.
    "without: share explained, against impostors": lambda t: replace(t, impostor=(-1e3, 1.0)),
    "without: held-out recordings in this share": _members(held_out=None),
    "without: directions have to differ": _members(differs=1.0),
    "without: ties": _all_contained,
    "without: bounds": _each(lambda one: replace(one, ended=())),
}
# Chosen numbers that judge a table, by the kind of change: of probabilities the odds are changed.
NUMBERS = ("LIBRARY_ODDS", "EDGE", "TIE", "RESISTING")
PROBABILITIES = ("NAMED", "POSSIBLE")
HEAD = (
    *("judged", "first name right", "at 0.8", "wrong above 0.5", "false alarms"),
    *("claims of 0.9 right", "sets right", "error of claims"),
)


@contextmanager
def _with(name: str, factor: float) -> Iterator[None]:
    """Changes a chosen number by a factor while it runs."""
    before = getattr(thresholds, name)
    odds = factor * before / (1.0 - before) if name in PROBABILITIES else 0.0
    setattr(thresholds, name, odds / (1.0 + odds) if odds else factor * before)
    try:
        yield
    finally:
        setattr(thresholds, name, before)


def read(path: Path) -> list[Case]:
    """Cases of a file of outcomes, one JSON line each.

    Raises:
        FileError: The file cannot be read, or no line has a table.
    """
    found = []
    try:
        rows = [json.loads(line) for line in path.read_text().splitlines()]
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: {error}; allowed: ", given=path, allowed=_ALLOWED) from error
    for row in rows:
        content = row.get("diagnosis", row)
        if not content.get("sets"):
            continue
        if "faults" in row:
            hidden, told = [effect_of(fault) for fault in row["faults"]], content["effects"]
            named, explained = [e["name"] for e in told], content["explained"]
        elif "hidden" in row:
            hidden, named, explained = row["hidden"], row["named"], None
        else:
            hidden, explained = [row["effect"]], row["explained"]
            named = [name for name, *_ in row["named"]]
        table = Table.from_json(content["sets"])
        share = 1.0 if explained is None else float(explained)
        found.append(Case(tuple(hidden), table, tuple(named), share))
    if not found:
        told = f"{path} holds no table of sets; allowed: "
        raise FileError(told, given=path, allowed=_ALLOWED)
    return found


def _claims(case: Case, judged: Judgement) -> list[tuple[str, float]]:
    """Names with their confidence, the most confident first."""
    names = [(key[0], judged.effects[key].confidence) for key in judged.named]
    # Names that explain less than half of the errors are not given.
    low = case.explained < EXPLANATION and {name for name, _ in names} <= set(case.named)
    return [(name, min(c, case.explained)) if low else (name, c) for name, c in names]


def scores(cases: list[Case], change: Change) -> dict[str, Any]:
    """Judges all cases with changed tables."""
    judged = [judge(change(case.table)) for case in cases]
    claims = [_claims(case, one) for case, one in zip(cases, judged, strict=True)]
    single = [(c, k) for c, k in zip(cases, claims, strict=True) if len(c.hidden) == 1]
    unchanged = [k for c, k in zip(cases, claims, strict=True) if not c.hidden]
    every = [(n in c.hidden, p) for c, k in zip(cases, claims, strict=True) for n, p in k]
    sets = [
        any(key[0] in case.hidden for key in one.confusion)
        for case, one in zip(cases, judged, strict=True)
        if one.verdict == "confusion_set"
    ]
    firsts = [(k[0][0] in c.hidden, k[0][1]) if k else (False, 0.0) for c, k in single]
    return {
        "first": _share([right for right, _ in firsts]),
        "sure": _share([right and p >= SURE for right, p in firsts]),
        "wrong": _share([any(n not in c.hidden and p > DOUBT for n, p in k) for c, k in single]),
        "alarms": _share([any(p > DOUBT for _, p in k) for k in unchanged]),
        "claims": _share([right for right, p in every if p >= CLAIM]),
        "sets": _share(sets),
        "error": float(np.mean([(right - p) ** 2 for right, p in every])) if every else None,
        "every": every,
    }


def _share(good: list[bool]) -> list[int]:
    return [sum(good), len(good)]


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Scores by kind of judging."""
    cases = [case for path in options.outcomes for case in read(path)]
    rows = {name: scores(cases, change) for name, change in FACTORS.items()}
    for name in (*NUMBERS, *PROBABILITIES):
        for factor, word in ((0.5, "half"), (2.0, "twice")):
            with _with(name, factor):
                rows[f"{word} {name}"] = scores(cases, FACTORS["as it is"])
    claims = rows["as it is"]["every"]
    if options.figure and (figure := reliability_figure(binned(claims))):
        with style():
            write_atomically(options.figure, partial(figure.savefig, format="png"))
    return {"cases": len(cases), "rows": [{"judged": n, **row} for n, row in rows.items()]}


def tables(kept: dict[str, Any]) -> str:
    """A row a way of judging."""
    names = ("first", "sure", "wrong", "alarms", "claims", "sets")
    rows = [
        (
            row["judged"],
            *(f"{row[n][0]} of {row[n][1]}" for n in names),
            "" if row["error"] is None else f"{row['error'] ** 0.5:.2f}",
        )
        for row in kept["rows"]
    ]
    return f"{kept['cases']} cases\n\n" + results.table(HEAD, rows)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("outcomes", type=Path, nargs="+", help="files of outcomes")
    parser.add_argument("--figure", type=Path, help="PNG of the reliability")
