"""The page of a comparison."""

import base64
import io
import math
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from leglab.base.errors import LeglabError
from leglab.base.output import write_atomically
from leglab.report.comparison import words
from leglab.report.figures import comparison_figure
from leglab.report.page.shell import Linked, Section, Table, file_link, render
from leglab.report.page.wording import capital, listed, number
from leglab.report.run.page import PAGE
from leglab.report.style import SERIES, style
from leglab.runs.comparison import StoredRun, read_comparison, stored_runs

_DPI = 130
# Above this ratio of the largest to the smallest value, a linear axis shows one of them alone.
_LOG_RATIO = 8.0
# Room beyond the outermost values, as a share of the axis.
_ROOM = 0.04
_SHARED = ("severity", "element", "reference", "duration", "tolerance")


@dataclass(frozen=True, kw_only=True)
class Mark:
    """One mean with its interval: places along the axis [%], and the value as text."""

    name: str
    color: int
    middle: float
    low: float
    high: float
    value: str


@dataclass(frozen=True, kw_only=True)
class Intervals:
    """Means with their intervals, of one quantity, by scenario on one axis."""

    title: str
    ticks: Sequence[tuple[float, str]]
    groups: Sequence[tuple[str, Sequence[Mark]]]


def write_comparison_page(folder: Path, path: Path | None = None) -> Path:
    """Writes the page of a comparison.

    Args:
        folder: Of the comparison.
        path: The page; None for report.html in the folder. An earlier one is replaced.

    Raises:
        LeglabError: The folder holds no comparison, or the page cannot be written.
    """
    path = path or folder / PAGE
    text = page(folder, path.parent)
    write_atomically(path, lambda stream: stream.write(text.encode()))
    return path


def page(folder: Path, base: Path | None = None) -> str:
    """The page as one file that needs no other and runs no script.

    Args:
        folder: Of the comparison.
        base: Folder of the page, from where its links lead to files of runs; None for `folder`.
    """
    summary = read_comparison(folder)
    runs = stored_runs(summary, folder)
    return render(
        "comparison.html",
        kind="comparison",
        title=f"Comparison {folder.resolve().name}",
        headline=_headline(summary),
        sections=_sections(summary),
        table=_numbers(summary),
        explained=words.explained(summary),
        intervals=[found for quantity in _QUANTITIES if (found := _intervals(summary, *quantity))],
        curves=_curves(summary, runs),
        runs=_runs(summary, runs, base or folder),
        commands=_commands(summary),
        settings=_settings(summary),
    )


def _headline(summary: dict[str, Any]) -> str:
    if len(summary["controllers"]) == 1:
        told = (f"{name}: {words.closest(summary, name)}" for name in summary["scenarios"])
        return f"Error after the change in {'; '.join(told)}."
    wins: dict[str, list[str]] = {}
    for scenario in summary["scenarios"]:
        alike, _ = words.ranked(summary, scenario)
        wins.setdefault(alike[0] if len(alike) == 1 else "", []).append(scenario)
    best = [f"{name} in {listed(tuple(places))}" for name, places in wins.items() if name]
    text = f"Closest to the reference: {', '.join(best)}; " if best else ""
    if unclear := wins.get(""):
        text += f"no controller is clearly the closest in {listed(tuple(unclear))}"
    return f"{capital(text.removesuffix('; '))}."


def _sections(summary: dict[str, Any]) -> list[Section]:
    count = len(summary["scenarios"]) * len(summary["controllers"]) * summary["seeds"]
    told = (
        f"{count:,} runs on the model {Path(summary['model']).stem}: every scenario with every "
        f"controller, and {words.seeds(summary)} of each.",
        f"Seeds differ in {words.drawn(summary)}.",
    )
    closest = tuple(
        f"{words.closest(summary, name)}" + (f"; {rest}." if rest else ".")
        for name in summary["scenarios"]
        for rest in (words.farther(summary, name),)
    )
    sections = [
        Section(title="What was compared", lines=told),
        Section(
            title="Who follows most closely after the change (without one: in the whole run)",
            lines=closest,
            names=tuple(f"{name}:" for name in summary["scenarios"]),
        ),
    ]
    failed = tuple(f"{line.rstrip('.')}." for line in words.failures(summary))
    if failed:
        sections.append(Section(title="What failed", lines=failed))
    limits = ["These are simulations."]
    if summary["seeds"] < 2:
        limits.append("One seed says nothing about the scatter: there are no intervals.")
    else:
        limits.append("Intervals are of the mean over seeds, by Student's t: single runs differ.")
    sections.append(Section(title="What this does not show", lines=tuple(limits)))
    return sections


def _numbers(summary: dict[str, Any]) -> Table:
    return Table(
        caption=words.title(summary),
        head=("scenario", "controller", *words.HEAD),
        rows=[(scenario, name, *cells) for scenario, name, cells in words.rows(summary)],
        words=2,
    )


# Name in the summary, title, factor to the shown unit, digits, unit; "" for that of errors.
_QUANTITIES = (
    ("after_rad", "RMS error after the change; without one, of the whole run", 1e3, 3, ""),
    ("end_rad", "RMS error at the end", 1e3, 3, ""),
    ("recovered", "undone at the end", 100.0, 3, "%"),
    ("t90_s", "90 % undone after; runs that never did are left out", 1.0, 3, "s"),
)


def _intervals(
    summary: dict[str, Any], name: str, title: str, factor: float, digits: int, unit: str
) -> Intervals | None:
    """Means and intervals of a quantity on one axis; None where there is no value."""
    unit = unit or summary["unit"]
    found = [
        (scenario, color, controller, factor * one["mean"], factor * (one["half_width"] or 0.0))
        for scenario, cells in summary["results"].items()
        for color, (controller, cell) in enumerate(cells.items())
        if (one := cell[name])["mean"] is not None
    ]
    if not found:
        return None
    lows, highs = [m - h for *_, m, h in found], [m + h for *_, m, h in found]
    log = min(lows) > 0.0 and max(highs) / min(lows) > _LOG_RATIO
    scale = math.log10 if log else float
    ends = [scale(min(lows)), scale(max(highs))]
    if not log:
        ends = [min(ends[0], 0.0), max(ends[1], 0.0)]
    room = _ROOM * (ends[1] - ends[0] or 1.0)
    low, span = ends[0] - room, ends[1] - ends[0] + 2.0 * room

    def place(value: float) -> float:
        return round(100.0 * (scale(value) - low) / span, 2)

    groups: dict[str, list[Mark]] = {}
    for scenario, color, controller, middle, half in found:
        told = number(middle, digits) + (f" ± {number(half, 2)}" if half else "")
        groups.setdefault(scenario, []).append(
            Mark(
                name=controller,
                color=color % len(SERIES),
                middle=place(middle),
                low=place(middle - half),
                high=place(middle + half),
                value=f"{told} {unit}",
            )
        )
    ticks = [(at, f"{tick:g}") for tick in _ticks(low, low + span, log) if (at := place(tick)) >= 0]
    axis = ", logarithmic" if log else ""
    return Intervals(
        title=f"{title} [{unit}{axis}]",
        ticks=[tick for tick in ticks if tick[0] <= 100.0],
        groups=list(groups.items()),
    )


def _ticks(low: float, high: float, log: bool) -> list[float]:
    """Round values between the ends of an axis, which are logarithms where it is logarithmic."""
    if log:
        factors = (1, 2, 5) if high - low < 1.6 else (1,)
        powers = range(math.floor(low), math.ceil(high) + 1)
        return [float(f"{factor}e{power}") for power in powers for factor in factors]
    step = 10.0 ** math.floor(math.log10(high - low))
    step = next(step * f for f in (0.1, 0.2, 0.5, 1.0, 2.0) if (high - low) / (step * f) <= 7)
    return [step * i for i in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _curves(summary: dict[str, Any], runs: Sequence[StoredRun]) -> list[dict[str, str]]:
    """Error over time by scenario, as pictures; none of scenarios whose runs are not there."""
    drawn = []
    for scenario in summary["scenarios"]:
        shown = [r.result for r in runs if r.scenario == scenario and r.result and r.result["time"]]
        try:
            figure = comparison_figure(shown, title=scenario)
        except LeglabError:
            continue
        stream = io.BytesIO()
        with style():
            figure.savefig(stream, format="png", dpi=_DPI)
        many = summary["seeds"] > 1
        between = "; the shade is the range from the best to the worst seed" if many else ""
        drawn.append(
            {
                "alt": f"RMS error of {scenario} over time, by controller.",
                "caption": f"{scenario}: RMS error over the stride that ends at each time, mean "
                f"over the seeds{between}.",
                "data": base64.b64encode(stream.getvalue()).decode(),
            }
        )
    return drawn


def _runs(summary: dict[str, Any], runs: Sequence[StoredRun], base: Path) -> Table:
    """Every run with the link to its file."""
    rows: list[list[str]] = []
    for run in runs:
        metrics = run.result["metrics"] if run.result else {}
        adaptation, phases = metrics.get("adaptation") or {}, metrics.get("phases") or []
        name = f"seed {run.seed}"
        there = run.result is not None
        note = metrics.get("failure") or adaptation.get("reason") or ""
        rows.append(
            [
                run.scenario,
                run.controller,
                Linked(name, file_link(run.path, base)) if there else name,
                note if there else "its file is not there",
                _error(adaptation.get("before_rad")),
                _error(phases[-1]["rms_rad"] if phases else None),
                _error(adaptation.get("end_rad")),
                _figure(adaptation.get("recovered"), 100.0),
                _time(adaptation),
            ]
        )
    unit = summary["unit"]
    errors = (f"before [{unit}]", f"after [{unit}]", f"end [{unit}]")
    head = ("scenario", "controller", "run", "note", *errors, "undone [%]", "90 % undone [s]")
    return Table(
        caption="Every run, with the file of its figures; the note says why some are missing",
        head=head,
        rows=rows,
        words=4,
    )


def _error(errors: dict[str, float] | None) -> str:
    return "" if errors is None else _figure(errors["all"], 1e3)


def _figure(value: float | None, factor: float = 1.0) -> str:
    return "" if value is None else number(factor * value)


def _time(adaptation: dict[str, Any]) -> str:
    if adaptation.get("recovered") is None:
        return ""
    return _figure(adaptation.get("t90_s")) or "never"


def _commands(summary: dict[str, Any]) -> list[str]:
    """Commands that make the runs of one seed with their recordings, a film and a page."""
    if summary["ramp_duration"]:
        return []
    shared = "".join(
        f" --{name} {shlex.quote(str(summary[name]))}"
        for name in _SHARED
        if name != "duration" and summary[name]
    )
    if summary["duration"] is not None:
        shared += f" --duration {summary['duration']:g}"
    shared += " --vary" if summary["vary"] else ""
    names = shlex.quote(",".join(summary["controllers"]))
    model = shlex.quote(str(summary["model"]))
    return [
        f"leglab report --scenario {shlex.quote(scenario)} --controllers {names} --model {model} "
        f"--seed 0{shared} --out {shlex.quote(f'out/{scenario}')}"
        for scenario in summary["scenarios"]
    ]


def _settings(summary: dict[str, Any]) -> Table:
    told = {name: value for name, value in summary.items() if name not in ("results", "unit")}
    rows = [(name.replace("_", " "), _text(value)) for name, value in told.items()]
    return Table(caption="What all runs share", head=("setting", "value"), rows=rows, words=2)


def _text(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None:
        return "each scenario's own"
    return f"{value:g}" if isinstance(value, float) else str(value)
