"""A comparison in words and numbers, for the terminal and the page alike."""

from collections import Counter
from collections.abc import Iterator
from typing import Any

from leglab.report.page.wording import listed

HEAD = ("before", "after", "ratio", "end", "undone, %", "90 % undone, s")
# More controllers than this make no sentence.
_MOST_TOLD = 3


def title(summary: dict[str, Any]) -> str:
    """Meaning of the numbers of the table."""
    return (
        f"RMS tracking error of all joints in {summary['unit']}, mean and half of the 95 % "
        f"interval, {seeds(summary)}: {drawn(summary)}"
    )


def explained(summary: dict[str, Any]) -> str:
    """Columns of the table that their names do not explain."""
    return (
        f"ratio: error after the change, of {summary['controllers'][0]}'s; end: the last whole "
        "strides of a quarter of the run; undone: share of the damage at the end, and when 90 % "
        "were"
    )


def rows(summary: dict[str, Any]) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Scenario, controller and the cells below `HEAD`."""
    for scenario, controllers in summary["results"].items():
        for controller, cell in controllers.items():
            failed, runs = len(cell["failures"]), cell["runs"]
            early = f", failed {failed}/{runs}" if failed else ""
            yield (
                scenario,
                controller,
                (
                    interval(cell["before_rad"], 1e3, 2),
                    interval(cell["after_rad"], 1e3, 2) + early,
                    interval(cell["ratio"], 1.0, 3),
                    interval(cell["end_rad"], 1e3, 2),
                    interval(cell["recovered"], 100.0, 0),
                    _undone(cell),
                ),
            )


def failures(summary: dict[str, Any]) -> list[str]:
    """Why runs of a comparison failed, a line a reason."""
    lines = []
    for scenario, controllers in summary["results"].items():
        for controller, cell in controllers.items():
            for reason, count in Counter(cell["failures"]).items():
                runs = f"{count} of {cell['runs']} runs"
                lines.append(f"{scenario}, {controller}: {runs} failed: {reason}")
    return lines


def seeds(summary: dict[str, Any]) -> str:
    """Number of seeds."""
    return f"{summary['seeds']} seed{'s' * (summary['seeds'] != 1)}"


def drawn(summary: dict[str, Any]) -> str:
    """Differences between seeds."""
    tolerance = summary["tolerance"]
    found = [f"machine (tolerance {tolerance:g})"] if tolerance else []
    found += ["time of the change and phase"] if summary["vary"] else []
    if not found:
        return "sensor noise alone (--tolerance 0.1 --vary draws machine, time and phase)"
    return ", ".join([*found, "sensor noise"])


def closest(summary: dict[str, Any], scenario: str) -> str:
    """Who follows most closely after the change, and whether the intervals tell it apart."""
    known = {
        name: cell["after_rad"]
        for name, cell in summary["results"][scenario].items()
        if cell["after_rad"]["mean"] is not None
    }
    if not known:
        return "no run came to the end"
    best, *others = sorted(known, key=lambda name: known[name]["mean"])

    def told(name: str) -> str:
        return f"{name} {interval(known[name], 1e3, 2)} {summary['unit']}"

    top = known[best]["mean"] + (known[best]["half_width"] or 0.0)
    alike = tuple(n for n in others if known[n]["mean"] - (known[n]["half_width"] or 0.0) <= top)
    text = told(best)
    if alike:
        text += f", not told apart from {listed(tuple(told(name) for name in alike))}"
    rest = tuple(told(name) for name in others if name not in alike)
    shown = listed(rest[:_MOST_TOLD]) if len(rest) <= _MOST_TOLD else ", ".join(rest[:_MOST_TOLD])
    more = f" and {len(rest) - _MOST_TOLD} more" if len(rest) > _MOST_TOLD else ""
    return f"{text}; {shown}{more}" if rest else text


def interval(estimate: dict[str, Any], unit: float, digits: int) -> str:
    """Mean and half of the 95 % interval; "-" for none."""
    if estimate["mean"] is None:
        return "-"
    # Rounding leaves no negative zero.
    text = f"{round(unit * estimate['mean'], digits) + 0.0:.{digits}f}"
    if estimate["half_width"] is not None:
        text += f" ± {unit * estimate['half_width']:.{digits}f}"
    return text


def _undone(cell: dict[str, Any]) -> str:
    text = interval(cell["t90_s"], 1.0, 2)
    never = cell["never_undone"]
    if not never:
        return text
    of_all = f"never {never}/{cell['runs']}"
    return of_all if text == "-" else f"{text}, {of_all}"
