"""Figure of all columns of a recording over time, one panel each, for `leglab inspect --plot`."""

import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from leglab.base.output import write_atomically
from leglab.base.units import unit_of
from leglab.data import inspect
from leglab.report.figures import outline
from leglab.report.style import BLUE, DARK_GREY, LIGHT_GREY, VERMILION, style

# Sizes [inch], widths for 1 to 4 columns of panels; panels from which 2, 3, 4 columns are used.
_WIDTH, _HEIGHT, _HEAD, _FOOT, _LEFT, _SPACE = (7.2, 3.9, 2.9, 2.3), 0.8, 0.6, 0.5, 0.7, 0.42
_MANY = (5, 25, 60)
# Maximum number of panels, and pieces of a line, whose 900 vertices are below Matplotlib's chunk.
_MOST_PANELS, _PIECES = 120, 450


def signals_figure(
    table: Mapping[str, np.ndarray], metadata: Mapping[str, Any], *, title: str = ""
) -> Figure:
    """Draws columns over time; gaps in time and missing samples are shaded.

    Args:
        table: Arrays of shape (n,) by column name; without a valid `time` column the axis shows the
            numbers of the samples.
        metadata: Metadata of the recording, with units of columns if known.
        title: Title of the figure, such as the name of the recording.
    """
    findings = inspect(table)
    timed = "time" in table and not any(finding.fatal for finding in findings)
    names = [name for name in table if name != "time" or not timed]
    shown, rows_left = names[:_MOST_PANELS], len(names) - _MOST_PANELS
    axis = table["time"] if timed else np.arange(max((x.size for x in table.values()), default=0))
    gaps = [finding.row for finding in findings if timed and finding.kind == "gap"]
    columns = 1 + sum(len(shown) >= count for count in _MANY)
    rows = max(math.ceil(len(shown) / columns), 1)
    width, pitch = _WIDTH[columns - 1], _HEIGHT + _SPACE
    size = (columns * (_LEFT + width) + 0.15, _HEAD + rows * pitch + _FOOT)
    with style():
        figure = Figure(figsize=size)
        for number, name in enumerate(shown):
            row, column = number % rows, number // rows
            left = column * (_LEFT + width) + _LEFT
            bottom = size[1] - _HEAD - (row + 1) * pitch + 0.08
            place = (left / size[0], bottom / size[1], width / size[0], _HEIGHT / size[1])
            panel = figure.add_axes(place)
            _draw(panel, axis, table[name], gaps)
            unit = unit_of(name, metadata)
            panel.set_title(f"{name} [{unit}]" if unit else name, fontsize=8, pad=3)
            is_last = row == rows - 1 or number == len(shown) - 1
            panel.tick_params(labelbottom=is_last)
            if is_last:
                panel.set_xlabel("time [s]" if timed else "row")
        words = [f"shaded: {len(gaps)} gap{'s' * (len(gaps) > 1)}"] * bool(gaps)
        words += [f"{rows_left} more columns are not drawn"] * (rows_left > 0)
        left = 0.1 / size[0]
        figure.text(left, 1 - 0.08 / size[1], title, va="top", fontsize=12, fontweight="bold")
        figure.text(left, 1 - 0.32 / size[1], "; ".join(words), va="top", color=DARK_GREY)
    return figure


def save_signals(
    table: Mapping[str, np.ndarray], metadata: Mapping[str, Any], path: Path, *, title: str
) -> None:
    """Writes the figure that `signals_figure` draws, as PNG.

    Raises:
        LeglabError: The file cannot be written.
    """
    figure = signals_figure(table, metadata, title=title)
    with style():
        write_atomically(path, partial(figure.savefig, format="png"))


def _draw(panel: Any, axis: np.ndarray, samples: np.ndarray, gaps: list[int]) -> None:
    """Draws one column; the line is broken before each sample of `gaps`."""
    finite = np.where(np.isfinite(samples), samples, np.nan)
    starts = [0, *gaps]
    for first, last in zip(starts, [*gaps, samples.size], strict=True):
        rows = first + outline(finite[first:last], pieces=_PIECES)
        panel.plot(axis[rows], finite[rows], color=BLUE, linewidth=0.8)
    for row in gaps:
        panel.axvspan(axis[row - 1], axis[row], color=LIGHT_GREY, alpha=0.5, linewidth=0)
    missing = np.isnan(finite)
    if missing.any():
        edges = np.flatnonzero(np.diff(missing, prepend=False, append=False))
        for first, end in zip(edges[::2], edges[1::2], strict=True):
            ends = axis[[max(first - 1, 0), min(end, samples.size - 1)]]
            panel.axvspan(*ends, color=VERMILION, alpha=0.25, linewidth=0)
    if axis.size > 1:
        panel.set_xlim(axis[0], axis[-1])
    panel.yaxis.get_major_locator().set_params(nbins=3)
    panel.ticklabel_format(axis="y", scilimits=(-3, 4), useOffset=False)
