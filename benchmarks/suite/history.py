"""Ratios of the benchmark over commits: a JSON line a measurement, in docs/data."""

import json
import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from benchmarks.suite.suite import ROOT, Measured, Ratio, Value, machine
from leglab.base.errors import FileError, SimulationError
from leglab.base.input import parse_json, read_bytes
from leglab.base.output import write_atomically

FILE = Path("docs") / "data" / "bench_history.jsonl"
# Kept values whose median a new one is compared with, and by how much it may be worse.
LAST, MARGIN = 5, 0.10


@dataclass(frozen=True, kw_only=True)
class Entry:
    """Result of one measurement."""

    commit: str  #: Of the checkout, with "+" where code was changed
    date: str  #: Day
    machine: str  #: Processor and number of cores
    ratios: dict[str, float]  #: Medians by name


def this_machine() -> str:
    """Processor and number of cores."""
    found = machine()
    return f"{found['processor']}, {found['cores']} cores"


def read_history(path: Path | None = None) -> list[Entry]:
    """Reads all entries, the oldest first; none where there is no file.

    Args:
        path: The file; None for that of the checkout.

    Raises:
        LeglabError: A line is no entry; names file and line.
    """
    path = path or ROOT / FILE
    if not path.exists():
        return []
    found = []
    for number, line in enumerate(read_bytes(path).decode().splitlines(), 1):
        try:
            content = parse_json(line)
            ratios = {str(name): float(value) for name, value in content.pop("ratios").items()}
            found.append(Entry(**content, ratios=ratios))
        except (ValueError, TypeError, LookupError, AttributeError) as error:
            told = f"{path}, line {number}: is no entry of the history"
            raise FileError(told, given=path) from error
    return found


def entry_of(measured: Sequence[Measured], found: Sequence[Value]) -> Entry:
    """The entry of what was measured.

    Raises:
        LeglabError: Nothing was.
    """
    records = [m.record for m in measured if m.record]
    if not records or not found:
        raise SimulationError("nothing was measured that could be kept")
    return Entry(
        commit=records[-1]["commit"],
        date=records[-1]["date"],
        machine=this_machine(),
        ratios={v.ratio.name: float(f"{v.median:.4g}") for v in found},
    )


def add(entry: Entry, path: Path | None = None) -> Path:
    """Adds an entry; one of the same commit and machine is replaced, ratio by ratio.

    Returns:
        The file.
    """
    path = path or ROOT / FILE
    entries = read_history(path)
    for i, other in enumerate(entries):
        if (other.commit, other.machine) == (entry.commit, entry.machine):
            entries[i] = replace(entry, ratios={**other.ratios, **entry.ratios})
            break
    else:
        entries.append(entry)
    text = "".join(json.dumps(asdict(one), allow_nan=False) + "\n" for one in entries)
    write_atomically(path, lambda stream: stream.write(text.encode()))
    return path


def kept_value(ratio: Ratio, entries: Sequence[Entry], here: str) -> float | None:
    """The median of the last kept values of a ratio; None where there is none to compare with.

    Args:
        ratio: Which one.
        entries: The history.
        here: This machine, with which figures that depend on it are compared alone.
    """
    found = [
        entry.ratios[ratio.name]
        for entry in entries
        if ratio.name in entry.ratios and (not ratio.absolute or entry.machine == here)
    ]
    return statistics.median(found[-LAST:]) if found else None


def change(value: Value, before: float | None) -> float | None:
    """By which share a ratio became better (above 0) or worse; None without one to compare with."""
    if before is None or not before:
        return None
    share = value.median / before - 1.0
    return share if value.ratio.better == "high" else -share


def worse(found: Sequence[Value], entries: Sequence[Entry], here: str) -> list[str]:
    """Ratios that are more than 10 % worse than the history's, a line each."""
    lines = []
    for value in found:
        before = kept_value(value.ratio, entries, here)
        changed = change(value, before)
        if changed is not None and changed < -MARGIN:
            lines.append(
                f"{value.ratio.name}: {value.median:.3g}, {-100 * changed:.0f} % worse than "
                f"{before:.3g}, the median of the last kept ({value.ratio.title})"
            )
    return lines
