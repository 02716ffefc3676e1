"""The index of a folder: a page that lists the runs, reports, sweeps and so on below it."""

import html
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from leglab.base.errors import FileError, LeglabError
from leglab.base.input import read_bytes, read_json
from leglab.report.comparison.words import closest, seeds
from leglab.report.page.outcome import outcome
from leglab.report.page.shell import asset, file_link, render, write_page
from leglab.runs.comparison import SUMMARY, read_comparison
from leglab.runs.folder import read_metrics

_RUN_FILES = ("metrics.json", "run.json", "recording.parquet")
# Number of bytes read of a page, enough for title and heading, which precede scripts and data.
_HEAD_LENGTH = 200_000
_UNIT = "mrad or mm"
_NUMBERS = ("seed", *(f"RMS {name} [{_UNIT}]" for name in ("before", "after", "end")))
_HEAD = ("where", "kind", "scenario", "controller", "model", *_NUMBERS, "outcome", "written, UTC")
_PAGE = re.compile(r'<meta name="generator" content="leglab \w')
_OURS = '<meta name="generator" content="leglab index"'


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One line of the index.

    Scenario, controller and model are set for runs and comparisons, seed and errors for runs.
    """

    name: str  #: Path below the folder
    #: Relative, quoted URL of the page or, without a page, of the best other file; may be empty.
    link: str
    kind: str  #: run, report, comparison, sweep or diagnosis
    #: Complete, stopped before its planned end, or unreadable.
    state: Literal["whole", "stopped", "broken"] = "whole"
    told: str = ""  #: Outcome; for an unreadable folder the error
    written: str = ""  #: Time of writing, in UTC
    scenario: str = ""
    controller: str = ""
    model: str = ""
    seed: int | None = None
    before: float | None = None  #: RMS error in the strides before the change [mrad or mm]
    after: float | None = None  #: RMS error after the change, or of the whole run [mrad or mm]
    end: float | None = None  #: RMS error in the last strides [mrad or mm]


def write_index(folder: Path, path: Path) -> tuple[list[Entry], Path]:
    """Writes the index of a folder.

    Args:
        folder: Folder to search, with all folders below it.
        path: The page; an earlier index is replaced, another file is not.

    Returns:
        The entries of the index, and its path.

    Raises:
        LeglabError: `folder` does not exist, `path` is a file that is no index, or the page cannot
            be written.
    """
    if path.is_dir():
        raise FileError(f"{str(path)!r} is a folder; give the name of a page", given=path)
    if path.exists() and _OURS.encode() not in read_bytes(path):
        raise FileError(f"{str(path)!r} is no index of leglab: it is left as it is", given=path)
    entries = _find_entries(folder, path.parent)
    return entries, write_page(_page(entries, folder.resolve().name), path)


def _page(entries: list[Entry], name: str) -> str:
    """Returns the index page with these entries, for a folder called `name`."""
    counts = sorted(Counter(entry.kind for entry in entries).items())
    parts = [f"{count} {kind}{'s' * (count > 1)}" for kind, count in counts]
    summary = ", ".join(parts).replace("diagnosiss", "diagnoses") or "Nothing was found"
    for state, told in (("stopped", "stopped half way"), ("broken", "cannot be read")):
        count = sum(entry.state == state for entry in entries)
        summary += f"; {count} {told}" if count else ""
    return render(
        "index.html",
        kind="index",
        scripts=(asset("index.js"),),
        title=f"Runs below {name}",
        summary=f"{summary}.",
        head=_HEAD,
        numbers=_NUMBERS,
        entries=entries,
    )


def _find_entries(folder: Path, base: Path) -> list[Entry]:
    """Returns the entries of a folder and of all folders below, with links relative to `base`."""
    if not folder.is_dir():
        raise FileError(f"{str(folder)!r} is not a folder", given=folder)
    found: list[Entry] = []
    for place, folders, files in os.walk(folder):  # links to folders are not followed
        folders.sort()
        found += _entries(Path(place), set(files), folder, base)
        # Hidden folders are skipped, except `.partial` folders of unfinished or interrupted runs.
        folders[:] = [f for f in folders if not f.startswith(".") or f.endswith(".partial")]
    return sorted(found, key=lambda entry: (entry.name, entry.kind))


def _entries(place: Path, files: set[str], folder: Path, base: Path) -> Iterator[Entry]:
    """Yields the entries of one folder, of the kinds that the names of its `files` show."""
    name = "." if place == folder else place.relative_to(folder).as_posix()

    def entry(
        kind: str, mark: str, links: tuple[str, ...], read: Callable[[Path, set[str]], dict]
    ) -> Entry:
        try:
            told = read(place, files)
        except LeglabError as error:
            told = {"state": "broken", "told": str(error).removeprefix(f"{place}{os.sep}")}
        except (ArithmeticError, LookupError, TypeError, ValueError):
            told = {"state": "broken", "told": f"{kind}.json does not have the form of a {kind}"}
        best = next((file_link(place / link, base) for link in links if link in files), "")
        return Entry(name=name, link=best, kind=kind, written=_written(place / mark), **told)

    if SUMMARY in files:
        yield entry("comparison", SUMMARY, ("report.html", SUMMARY), _comparison)
        return
    if "diagnosis.json" in files:
        links = ("diagnosis.html", "diagnosis.json")
        yield entry("diagnosis", "diagnosis.json", links, _diagnosis)
    if "sweep.json" in files:
        yield entry("sweep", "dataset.json", ("report.html", "sweep.json"), _sweep)
        return
    if "run.json" in files or "metrics.json" in files or place.name.endswith(".partial"):
        mark = next((f for f in _RUN_FILES if f in files), ".")
        yield entry("run", mark, ("report.html", "tracking.png", *_RUN_FILES), _run)
    elif "report.html" in files and _PAGE.search(_head(place / "report.html")):
        yield entry("report", "report.html", ("report.html",), _headline)


def _run(place: Path, files: set[str]) -> dict[str, Any]:
    if place.name.endswith(".partial"):
        raise LeglabError("was not written to its end")
    missing = [name for name in _RUN_FILES if name not in files]
    if missing:
        raise LeglabError(f"has no {' and no '.join(missing)}")
    metrics = read_metrics(place)
    first, last = metrics.phases[0], metrics.phases[-1]
    state, told = "whole", ""
    if not metrics.completed:
        reason = metrics.failure or "no reason was stored"
        state, told = "stopped", f"stopped at {metrics.duration:.2f} s: {reason}"
    elif last is not first:
        told = outcome(metrics.adaptation, metrics.error_unit())
    return {
        **{name: getattr(metrics, name) for name in ("scenario", "controller", "model", "seed")},
        "before": _milli(metrics.adaptation.before_rad),
        "after": _milli(last.rms_rad) if last.name != "before" else None,
        "end": _milli(metrics.adaptation.end_rad),
        "state": state,
        "told": told,
    }


def _milli(errors: Mapping[str, float] | None) -> float | None:
    value = (errors or {}).get("all")
    return None if value is None else 1e3 * value


def _comparison(place: Path, files: set[str]) -> dict[str, Any]:
    content = read_comparison(place)
    told = "; ".join(f"{name}: {closest(content, name)}" for name in content["scenarios"])
    page = "" if "report.html" in files else "; it has no page: leglab report writes one"
    return {
        "scenario": ", ".join(map(str, content["scenarios"])),
        "controller": ", ".join(map(str, content["controllers"])),
        "model": str(content["model"]),
        "told": f"{seeds(content)}; {told}{page}",
    }


def _sweep(place: Path, _: set[str]) -> dict[str, Any]:
    content = _content(place / "sweep.json")
    axes = ", ".join(map(str, content["axes"]))
    return {"told": f"{int(content['runs']):,} runs over {axes or 'nothing'}"}


def _diagnosis(place: Path, files: set[str]) -> dict[str, Any]:
    content = _content(place / "diagnosis.json")
    effects = [f"{effect['name']} at {effect['element']}" for effect in content["effects"]]
    verdict = str(content["verdict"]).replace("_", " ")
    text = f"{verdict}: {', '.join(effects)}" if effects else verdict
    return {"told": text + "; it has no page" * ("diagnosis.html" not in files)}


def _content(path: Path) -> Any:
    try:
        return read_json(path)
    except LeglabError:
        return None


def _head(page: Path) -> str:
    with suppress(LeglabError):
        return read_bytes(page, _HEAD_LENGTH).decode(errors="replace")
    return ""


def _headline(place: Path, _: set[str]) -> dict[str, Any]:
    if found := re.search(r"<h1[^>]*>([^<]*)</h1>", _head(place / "report.html")):
        return {"told": html.unescape(found.group(1)).strip()}
    return {}


def _written(path: Path) -> str:
    try:
        seconds = path.stat().st_mtime
    except OSError:
        return ""
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M")
