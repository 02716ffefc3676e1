"""Figure of a comparison: windowed error over time, one line a controller."""

import itertools
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator

from leglab.base.errors import LeglabError
from leglab.data import write_atomically
from leglab.report.panels import add_head, add_panels
from leglab.report.style import SERIES, VERMILION, style

_DASHES: tuple[Literal["-", "--", ":"], ...] = ("-", "--", ":")
_MILLI = 1e3
_LEGEND_COLUMNS = 4
_SUBDIVISIONS = (1.0, 2.0, 5.0)


def comparison_figure(results: Sequence[dict[str, Any]], *, title: str = "") -> Figure:
    """Draws the mean over seeds and the range between the best and the worst seed.

    Args:
        results: Runs of one scenario: `metrics` (its `controller`), `changes` [s], `window` [s],
            `time` [s] and `windowed_error_rad`; lines come in the order of the controllers.
        title: What was run.

    Raises:
        LeglabError: There is no run, or none lasts a window.
    """
    controllers = list(dict.fromkeys(result["metrics"]["controller"] for result in results))
    if not any(value for result in results for value in result["windowed_error_rad"]):
        raise LeglabError("no windowed error to draw: no run lasts a window")
    looks = itertools.cycle(itertools.product(_DASHES, SERIES))
    lines = []
    with style():
        figure, (panel,) = add_panels(1, heights=(3.0,))
        (axes,) = panel
        for controller, (dashes, color) in zip(controllers, looks, strict=False):
            time, errors = _stack([r for r in results if r["metrics"]["controller"] == controller])
            axes.plot(time, errors.mean(axis=0), color=color, linestyle=dashes, linewidth=1.4)
            if len(errors) > 1:
                low, high = errors.min(axis=0), errors.max(axis=0)
                axes.fill_between(time, low, high, color=color, alpha=0.2, linewidth=0)
            lines.append(Line2D([], [], color=color, linestyle=dashes, label=controller))
        changes = results[0]["changes"]
        for change in changes:
            axes.axvline(change, color=VERMILION, linewidth=1.0, zorder=1)
        if changes:
            axes.axvspan(changes[0], changes[-1], color=VERMILION, alpha=0.12, linewidth=0)
            lines.append(Line2D([], [], color=VERMILION, label="change of the machine"))
        axes.set_xlim(0, max(result["time"][-1] for result in results))
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=_SUBDIVISIONS))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_formatter("")
        axes.xaxis.set_major_locator(MaxNLocator(nbins=10, steps=[1, 2, 5, 10]))
        axes.set_ylabel(f"RMS error over {results[0]['window']:g} s [mrad]")
        add_head(figure, title, lines, columns=_LEGEND_COLUMNS)
    return figure


def save_comparison_figure(results: Sequence[dict[str, Any]], path: Path, *, title: str) -> None:
    """Writes `comparison_figure` as PNG.

    Raises:
        LeglabError: As `comparison_figure`, or the file cannot be written.
    """
    figure = comparison_figure(results, title=title)
    with style():
        write_atomically(path, partial(figure.savefig, format="png"))


def _stack(results: Sequence[dict[str, Any]]) -> tuple[np.ndarray, np.ndarray]:
    """Times [s], (n,), and errors [mrad], (runs, n), of the time that all of the runs reached."""
    count = min(len(result["time"]) for result in results)
    errors = [result["windowed_error_rad"][:count] for result in results]
    return np.array(results[0]["time"][:count]), _MILLI * np.array(errors, dtype=np.float64)
