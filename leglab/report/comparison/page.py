"""The page of a comparison."""

import math
import shlex
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from leglab.base.errors import LeglabError
from leglab.report.comparison import words
from leglab.report.figures import comparison_figure, png
from leglab.report.page.shell import Section, Table, inlined, link, render, write_page
from leglab.report.page.wording import capital, figure, listed, log_ticks, number, readable
from leglab.report.run.page import PAGE
from leglab.report.style import SERIES
from leglab.runs.comparison import StoredRun, read_comparison, stored_runs

# The axis is logarithmic if the ratio of the largest to the smallest value exceeds this.
_LOG_RATIO = 8.0
# Margin of the axis beyond the outermost values, as a share of their distance.
_ROOM = 0.04
_SHARED = ("severity", "element", "reference", "tolerance")


def write_comparison_page(folder: Path, path: Path | None = None) -> Path:
    """Writes the page of a comparison.

    Args:
        folder: Folder of the comparison.
        path: Path of the page; None for report.html in the folder. An earlier page is replaced.

    Raises:
        LeglabError: The folder holds no comparison, or the page cannot be written.
    """
    path = path or folder / PAGE
    return write_page(page(folder, path.parent), path)


def page(folder: Path, base: Path | None = None) -> str:
    """Returns the page as one file that loads no other and runs no script.

    Args:
        folder: Folder of the comparison.
        base: Folder of the page, to which links to files of runs are relative; None for `folder`.
    """
    summary = read_comparison(folder)
    runs = stored_runs(summary, folder)
    return render(
        "comparison.html",
        kind="comparison",
        title=f"Comparison {folder.resolve().name}",
        headline=_headline(summary),
        sections=_sections(summary),
        table=Table(
            caption=words.title(summary),
            head=("scenario", "controller", *words.HEAD),
            rows=[(scenario, name, *cells) for scenario, name, cells in words.rows(summary)],
            words=2,
        ),
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
    closest = []
    for name in summary["scenarios"]:
        others = words.farther(summary, name)
        closest.append(words.closest(summary, name) + (f"; {others}." if others else "."))
    scatter = "Intervals are of the mean over seeds, by Student's t: single runs differ."
    if summary["seeds"] < 2:
        scatter = "One seed says nothing about the scatter: there are no intervals."
    failed, missing = (
        tuple(f"{line.rstrip('.')}." for line in lines)
        for lines in (words.failures(summary), words.untold(summary))
    )
    return [
        Section(title="What was compared", lines=told),
        Section(
            title="Who follows most closely after the change (without one: in the whole run)",
            lines=tuple(closest),
            names=tuple(f"{name}:" for name in summary["scenarios"]),
        ),
        Section(title="What failed", lines=failed),
        Section(title="What is missing", lines=missing),
        Section(title="What this does not show", lines=("These are simulations.", scatter)),
    ]


# Quantities: name in the summary, title, factor to the shown unit, unit ("": the errors' unit).
_QUANTITIES = (
    ("after_rad", "RMS error after the change; without one, of the whole run", 1e3, ""),
    ("end_rad", "RMS error at the end", 1e3, ""),
    ("recovered", "undone at the end", 100.0, "%"),
    ("t90_s", "90 % undone after; runs that never did are left out", 1.0, "s"),
)


def _intervals(
    summary: dict[str, Any], name: str, title: str, factor: float, unit: str
) -> dict[str, Any] | None:
    """Returns means and confidence intervals on an axis from 0 to 100; None without values."""
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

    groups: dict[str, list[dict[str, Any]]] = {}
    for scenario, color, controller, middle, half in found:
        told = words.with_half(middle, half) if half else number(middle)
        ends = [middle - half, middle, middle + half]
        places = dict(zip(("low", "middle", "high"), map(place, ends), strict=True))
        look = {"name": controller, "color": color % len(SERIES), "value": f"{told} {unit}"}
        groups.setdefault(scenario, []).append({**look, **places})
    ticks = log_ticks(low, low + span, fine=span < 1.6) if log else _ticks(low, low + span)
    return {
        "title": f"{title} [{unit}{', logarithmic' if log else ''}]",
        "ticks": [(at, f"{tick:g}") for tick in ticks if 0 <= (at := place(tick)) <= 100.0],
        "groups": list(groups.items()),
    }


def _ticks(low: float, high: float) -> list[float]:
    """Returns round, evenly spaced values between the ends of a linear axis."""
    step = 10.0 ** math.floor(math.log10(high - low))
    step = next(step * f for f in (0.1, 0.2, 0.5, 1.0, 2.0) if (high - low) / (step * f) <= 7)
    return [step * i for i in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _curves(summary: dict[str, Any], runs: Sequence[StoredRun]) -> list[dict[str, str]]:
    """Draws one picture of errors over time per scenario of which there are files of runs."""
    drawn = []
    many = summary["seeds"] > 1
    between = "; the shade is the range from the best to the worst seed" if many else ""
    for scenario in summary["scenarios"]:
        shown = [r.result for r in runs if r.scenario == scenario and r.result and r.result["time"]]
        with suppress(LeglabError):
            drawing = comparison_figure(shown, title=scenario)
            alt = f"RMS error of {scenario} over time, by controller."
            caption = (
                f"{scenario}: RMS error over the stride that ends at each time, mean "
                f"over the seeds{between}."
            )
            drawn.append({"alt": alt, "caption": caption, "data": inlined(png(drawing))})
    return drawn


def _runs(summary: dict[str, Any], runs: Sequence[StoredRun], base: Path) -> Table:
    """Returns the table of all runs, with links to the runs' files."""
    rows: list[list[str]] = []
    for run in runs:
        metrics = run.result["metrics"] if run.result else {}
        adaptation, phases = metrics.get("adaptation") or {}, metrics.get("phases") or []
        name, note = f"seed {run.seed}", "its file is not there"
        if run.result is not None:
            name = link(name, run.path, base)
            note = metrics.get("failure") or adaptation.get("reason") or ""
        undone = adaptation.get("recovered")
        after = phases[-1]["rms_rad"] if phases else None
        three = (adaptation.get("before_rad"), after, adaptation.get("end_rad"))
        t90 = "" if undone is None else figure(adaptation.get("t90_s"), missing="never")
        rows.append(
            [
                *(run.scenario, run.controller, name, note),
                *(figure((error or {}).get("all"), 1e3) for error in three),
                *(figure(undone, 100.0), t90),
            ]
        )
    errors = (f"{name} [{summary['unit']}]" for name in ("before", "after", "end"))
    head = ("scenario", "controller", "run", "note", *errors, "undone [%]", "90 % undone [s]")
    caption = "Every run, with the file of its figures; the note says why some are missing"
    return Table(caption=caption, head=head, rows=rows, words=4)


def _commands(summary: dict[str, Any]) -> list[str]:
    """Returns commands that repeat the runs of seed 0 with recordings, a film and a page."""
    if summary["ramp_duration"]:
        return []
    shared = "".join(
        f" --{name} {shlex.quote(str(summary[name]))}" for name in _SHARED if summary[name]
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
    rows = [(readable(name), _text(value)) for name, value in told.items()]
    return Table(caption="What all runs share", head=("setting", "value"), rows=rows, words=2)


def _text(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None:
        return "each scenario's own"
    return f"{value:g}" if isinstance(value, float) else str(value)
