"""Panels of a figure, placed to the millimetre so that all axes line up.

Automatic layouts move each panel by the width of its own tick labels.
"""

import math
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

# Inches.
_LEFT = 0.75  # axis label and tick labels
_RIGHT = 0.12
_HEAD = 0.6  # title and legend of the figure
_TITLE = 0.4  # title of a panel, and the space to the one above
_GAP = 0.12  # between the axes of one panel
_FOOT = 0.5  # time axis
_ONE_COLUMN = 7.2
_TWO_COLUMNS = 4.9


def add_panels(count: int, heights: Sequence[float]) -> tuple[Figure, list[tuple[Axes, ...]]]:
    """Makes a figure with equal panels: up to two below each other, more in two columns.

    Args:
        count: Number of panels.
        heights: Heights of the axes of each panel, from top to bottom [inch].

    Returns:
        The figure, and the axes of each panel, which share their time axis.
    """
    rows = count if count <= 2 else math.ceil(count / 2)
    columns = math.ceil(count / rows)
    width = _ONE_COLUMN if columns == 1 else _TWO_COLUMNS
    panel_height = _TITLE + sum(heights) + _GAP * (len(heights) - 1)
    size = (columns * (_LEFT + width + _RIGHT), _HEAD + rows * panel_height + _FOOT)
    figure = Figure(figsize=size)
    panels = []
    for index in range(count):
        row, column = index % rows, index // rows
        left = column * (_LEFT + width + _RIGHT) + _LEFT
        top = size[1] - _HEAD - row * panel_height - _TITLE
        stack: list[Axes] = []
        for height in heights:
            place = (left / size[0], (top - height) / size[1], width / size[0], height / size[1])
            axes = figure.add_axes(place, sharex=stack[0] if stack else None)
            axes.tick_params(labelbottom=False)
            # At one distance from all axes, whatever the width of the tick labels.
            axes.yaxis.set_label_coords(-0.53 / width, 0.5)
            stack.append(axes)
            top -= height + _GAP
        if row == rows - 1 or index == count - 1:
            stack[-1].tick_params(labelbottom=True)
            stack[-1].set_xlabel("time [s]")
        panels.append(tuple(stack))
    return figure, panels


def add_head(
    figure: Figure, title: str, lines: Sequence[Line2D], *, columns: int | None = None
) -> None:
    """Puts the title and one legend for all panels above them.

    Args:
        figure: The figure.
        title: What was run.
        lines: A sample of each kind of line, with its label.
        columns: Entries in a row of the legend; None puts all into one.
    """
    width, height = figure.get_size_inches()
    left = 0.1 / width
    figure.text(left, 1 - 0.08 / height, title, va="top", fontsize=12, fontweight="bold")
    figure.legend(
        handles=list(lines),
        loc="upper left",
        bbox_to_anchor=(left, 1 - 0.36 / height),
        ncols=min(columns or len(lines), len(lines)),
        borderpad=0,
        borderaxespad=0,
    )
