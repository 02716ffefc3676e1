"""Texts and table cells of a comparison, for the terminal and for the page."""

import math
from collections import Counter
from collections.abc import Iterator
from typing import Any

from leglab.report.page.wording import listed
from leglab.runs.clock import NOTHING_CHANGES

HEAD = ("before", "after", "ratio", "end", "undone, %", "90 % undone, s")
# Maximum number of controllers that a sentence names.
_MOST_TOLD = 3


def title(summary: dict[str, Any]) -> str:
    """Returns the title of the table, which explains the numbers of the table."""
    return (
        f"RMS tracking error of all joints in {summary['unit']}, mean and half of the 95 % "
        f"interval, {seeds(summary)}: {drawn(summary)}"
    )


def explained(summary: dict[str, Any]) -> str:
    """Explains those columns of the table whose headings are too short to be clear."""
    return (
        f"ratio: error after the change, of {summary['controllers'][0]}'s; end: the last whole "
        "strides of a quarter of the run; undone: share of the damage at the end, and when 90 % "
        "were"
    )


def rows(summary: dict[str, Any]) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Yields scenario, controller and the cells of the columns `HEAD`."""
    for scenario, controllers in summary["results"].items():
        for controller, cell in controllers.items():
            failed, runs = len(cell["failures"]), cell["runs"]
            early = f", failed {failed}/{runs}" if failed else ""
            cells = (
                interval(cell["before_rad"], 1e3, 2),
                interval(cell["after_rad"], 1e3, 2) + early,
                interval(cell["ratio"], 1.0, 3),
                interval(cell["end_rad"], 1e3, 2),
                interval(cell["recovered"], 100.0, 0),
                _undone(cell),
            )
            yield scenario, controller, cells


def failures(summary: dict[str, Any]) -> list[str]:
    """Returns the reasons why runs of a comparison failed, one line per reason and controller."""
    lines = []
    for scenario, controllers in summary["results"].items():
        for controller, cell in controllers.items():
            for reason, count in Counter(cell["failures"]).items():
                runs = f"{count} of {cell['runs']} runs"
                lines.append(f"{scenario}, {controller}: {runs} failed: {reason}")
    return lines


def untold(summary: dict[str, Any]) -> list[str]:
    """Returns the reasons for missing adaptation metrics, one line per scenario and reason."""
    who: dict[tuple[str, str], list[str]] = {}
    for scenario, controllers in summary["results"].items():
        for controller, cell in controllers.items():
            for reason, count in Counter(cell.get("untold", ())).items():
                runs = controller if count == cell["runs"] else f"{controller} ({count} runs)"
                who.setdefault((scenario, reason), []).append(runs)
    return [
        f"{scenario}, {listed(tuple(names))}: what was undone cannot be told: {reason}"
        for (scenario, reason), names in who.items()
        if reason != NOTHING_CHANGES
    ]


def seeds(summary: dict[str, Any]) -> str:
    """Returns the number of seeds in words."""
    return f"{summary['seeds']} seed{'s' * (summary['seeds'] != 1)}"


def drawn(summary: dict[str, Any]) -> str:
    """Describes in which random properties the seeds differ."""
    tolerance = summary["tolerance"]
    found = [f"machine (tolerance {tolerance:g})"] if tolerance else []
    found += ["time of the change and phase"] if summary["vary"] else []
    if not found:
        return "sensor noise alone (--tolerance 0.1 --vary draws machine, time and phase)"
    return ", ".join([*found, "sensor noise"])


def ranked(summary: dict[str, Any], scenario: str) -> tuple[list[str], list[str]]:
    """Ranks the controllers by their error after the change, the smallest first.

    Returns:
        First the best controller, with all controllers whose intervals overlap with its interval;
        second the other controllers. Controllers without a completed run are in neither list.
    """
    known = {
        name: (cell["after_rad"]["mean"], cell["after_rad"]["half_width"] or 0.0)
        for name, cell in summary["results"][scenario].items()
        if cell["after_rad"]["mean"] is not None
    }
    order = sorted(known, key=lambda name: known[name][0])
    if not order:
        return [], []
    top = sum(known[order[0]])
    alike = [name for name in order if known[name][0] - known[name][1] <= top]
    return alike, [name for name in order if name not in alike]


def closest(summary: dict[str, Any], scenario: str) -> str:
    """Names the controller of least error, and controllers whose intervals overlap with its."""
    alike, _ = ranked(summary, scenario)
    if not alike:
        return "no run came to the end"
    best, *others = (_told(summary, scenario, name) for name in alike)
    return f"{best}, not told apart from {listed(tuple(others))}" if others else best


def farther(summary: dict[str, Any], scenario: str) -> str:
    """Names up to `_MOST_TOLD` controllers that are worse than the best; may be empty."""
    _, rest = ranked(summary, scenario)
    told = [_told(summary, scenario, name) for name in rest[:_MOST_TOLD]]
    told += [f"{len(rest) - _MOST_TOLD} more"] * (len(rest) > _MOST_TOLD)
    return listed(tuple(told))


def _told(summary: dict[str, Any], scenario: str, name: str) -> str:
    error = summary["results"][scenario][name]["after_rad"]
    return f"{name} {interval(error, 1e3, 2)} {summary['unit']}"


def interval(estimate: dict[str, Any], unit: float, digits: int) -> str:
    """Formats a mean and the half width of its 95 % interval; "-" if there is no mean."""
    if estimate["mean"] is None:
        return "-"
    # Adding 0.0 removes the sign of -0.0.
    text = f"{round(unit * estimate['mean'], digits) + 0.0:.{digits}f}"
    if estimate["half_width"] is not None:
        text += f" ± {_half(unit * estimate['half_width'], digits)}"
    return text


def with_half(middle: float, half: float) -> str:
    """Formats mean and half width of an interval, rounded to four digits of the larger value."""
    size = max(abs(middle), half)
    decimals = max(0, 3 - math.floor(math.log10(size))) if size else 0
    return f"{round(middle, decimals) + 0.0:.{decimals}f} ± {_half(half, decimals)}"


def _half(half: float, decimals: int) -> str:
    least = 10.0**-decimals
    return f"{half:.{decimals}f}" if half == 0 or half >= least / 2 else f"<{least:g}"


def _undone(cell: dict[str, Any]) -> str:
    text, never = interval(cell["t90_s"], 1.0, 2), cell["never_undone"]
    if not never:
        return text
    of_all = f"never {never}/{cell['runs']}"
    return of_all if text == "-" else f"{text}, {of_all}"
