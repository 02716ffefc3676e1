"""Figures of the self-test on rough specimens: are confidences true, and what is taken for what."""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from benchmarks.self_test.rough import (
    EDGES,
    NOTHING,
    Bin,
    RoughOutcome,
    confusions,
    interval,
    reliability,
)
from leglab.base.output import write_atomically
from leglab.report.figures import add_head
from leglab.report.page.wording import readable
from leglab.report.style import BLUE, DARK_GREY, GRID, LIGHT_GREY, VERMILION, style
from rigs.rough_bench import FAULTS, effect_of

_LEGEND: dict[str, Any] = {"columnspacing": 1.4, "handletextpad": 0.5}
_WIDTH, _HEIGHT = 6.6, 5.5  # inch; as wide as the figures of a diagnosis
_FEW = 5  # names in a bin below which its share says little
# Confusion matrix [inch].
_CELL, _LETTER, _HEAD = 0.23, 0.058, 0.78


def save_figures(outcomes: Sequence[RoughOutcome], folder: Path, prefix: str) -> list[Path]:
    """Writes both figures as PNG and SVG; those that have nothing to show are left out."""
    folder.mkdir(parents=True, exist_ok=True)
    figures = {
        "reliability": reliability_figure(reliability(outcomes)),
        "confusion": confusion_figure(confusions(outcomes)),
    }
    paths = []
    for name, figure in figures.items():
        for kind in ("png", "svg") if figure else ():
            path = folder / f"{prefix}-{name}.{kind}"
            with style():
                write_atomically(path, partial(figure.savefig, format=kind))  # type: ignore[union-attr]
            paths.append(path)
    return paths


def reliability_figure(bins: Sequence[Bin]) -> Figure | None:
    """Share of right names over the confidence they were given with; None without any name."""
    filled = [one for one in bins if one.count]
    if not filled:
        return None
    with style():
        figure = Figure(figsize=(_WIDTH, _HEIGHT))
        left, width = 0.62 / _WIDTH, 4.6 / _WIDTH
        top = figure.add_axes((left, 1.78 / _HEIGHT, width, 3.0 / _HEIGHT))
        counts = figure.add_axes((left, 0.5 / _HEIGHT, width, 1.05 / _HEIGHT))
        top.plot([0, 1], [0, 1], color=DARK_GREY, linestyle="--", linewidth=1.0, zorder=1)
        for one in filled:
            _draw_bin(top, one)
        _draw_counts(counts, bins)
        for axes in (top, counts):
            axes.set_xlim(-0.02, 1.02)
            axes.set_xticks(EDGES)
            axes.set_xticklabels([f"{edge:g}" for edge in EDGES])
        top.tick_params(axis="x", labelbottom=False)
        top.set_ylim(-0.03, 1.03)
        top.set_yticks(np.linspace(0.0, 1.0, 6))
        top.set_ylabel("share that is right")
        counts.set_xlabel("confidence that the diagnosis gives")
        _beside(figure, left + width, bins)
        marks = [
            Line2D([], [], color=BLUE, marker="o", label="names, 95 % interval"),
            Line2D([], [], color=DARK_GREY, linestyle="--", label="as often as claimed"),
        ]
        if any(one.count < _FEW for one in filled):
            marks.insert(1, _hollow(f"fewer than {_FEW} names"))
        add_head(figure, "Are names as often right as they claim?", marks, **_LEGEND)
    return figure


def _hollow(label: str) -> Line2D:
    return Line2D([], [], color=BLUE, marker="o", markerfacecolor="white", label=label)


def _draw_bin(axes: Axes, one: Bin) -> None:
    share = one.right / one.count
    low, high = interval(one.right, one.count)
    axes.plot([one.mean, one.mean], [low, high], color=BLUE, linewidth=1.6, zorder=2)
    face = BLUE if one.count >= _FEW else "white"
    axes.plot(one.mean, share, "o", color=BLUE, markerfacecolor=face, markersize=7, zorder=3)


def _draw_counts(axes: Axes, bins: Sequence[Bin]) -> None:
    for one in bins:
        middle, width = 0.5 * (one.low + one.high), 0.92 * (one.high - one.low)
        axes.bar(middle, one.right, width, color=BLUE)
        axes.bar(middle, one.count - one.right, width, bottom=one.right, color=VERMILION)
        if one.count:
            place: dict[str, Any] = {
                "xytext": (0, 2),
                "textcoords": "offset points",
                "ha": "center",
            }
            text = f"{one.right}/{one.count}"
            axes.annotate(text, (middle, one.count), fontsize=7.5, color=DARK_GREY, **place)
    axes.set_ylabel("names")
    axes.yaxis.set_major_locator(MaxNLocator(3, integer=True))
    axes.set_ylim(0, 1.25 * max(one.count for one in bins))


def _beside(figure: Figure, right: float, bins: Sequence[Bin]) -> None:
    """A column of figures beside the panels: what the bars are, and the total."""
    handles = [Patch(color=BLUE, label="right"), Patch(color=VERMILION, label="wrong")]
    figure.legend(
        handles=handles[::-1],
        loc="upper left",
        bbox_to_anchor=(right + 0.02, 1.55 / _HEIGHT),
        borderaxespad=0,
        handlelength=1.0,
    )
    total, good = sum(one.count for one in bins), sum(one.right for one in bins)
    text = f"{total} names,\n{good} right"
    figure.text(right + 0.025, 0.52 / _HEIGHT, text, va="bottom", fontsize=9, color=DARK_GREY)


def confusion_figure(counts: Mapping[tuple[str, str], int]) -> Figure | None:
    """Hidden effect against first name, a number a cell; None without any case."""
    if not counts:
        return None
    rows = _ordered({hidden for hidden, _ in counts})
    columns = _ordered({name for _, name in counts} | set(rows))
    table = np.array([[counts.get((row, column), 0) for column in columns] for row in rows])
    left = _LETTER * max(len(name) for name in rows) + 0.45
    above = _LETTER * max(len(name) for name in columns) + 0.12
    across, down = _CELL * len(columns), _CELL * len(rows)
    width, height = max(left + across + 0.6, 4.8), _HEAD + above + down + 0.12
    with style():
        figure = Figure(figsize=(width, height))
        axes = figure.add_axes((left / width, 0.12 / height, across / width, down / height))
        axes.imshow(_inks(table, rows, columns), aspect="auto")
        for i, j in np.argwhere(table):
            dark = table[i, j] > 0.4 * table[i].sum() and columns[j] != NOTHING
            ink = "white" if dark or rows[i] == columns[j] else "black"
            axes.text(j, i, str(table[i, j]), ha="center", va="center", fontsize=7.5, color=ink)
        for i, row in enumerate(rows):
            text = f"{counts.get((row, row), 0)} of {table[i].sum()}"
            axes.text(len(columns) - 0.35, i, text, va="center", fontsize=7.5, color=DARK_GREY)
        axes.set_xticks(range(len(columns)), [readable(n) for n in columns], rotation=90)
        axes.set_yticks(range(len(rows)), [readable(n) for n in rows])
        axes.set_xticks(np.arange(-0.5, len(columns)), minor=True)
        axes.set_yticks(np.arange(-0.5, len(rows)), minor=True)
        axes.xaxis.tick_top()
        axes.tick_params(which="both", length=0, pad=2, labelsize=7.5)
        axes.grid(False)
        axes.grid(True, which="minor", axis="both", color=GRID)
        axes.set_axisbelow(False)
        for side in axes.spines.values():
            side.set_visible(False)
        figure.text(0.1 / width, 0.5 * down / height, "hidden", rotation=90, color=DARK_GREY)
        place = (left / width, 1 - (_HEAD - 0.08) / height)
        figure.text(*place, "named first", va="top", color=DARK_GREY)
        marks = [Patch(color=BLUE, label="right"), Patch(color=VERMILION, label="wrong name")]
        marks.append(Patch(color=LIGHT_GREY, label="no name"))
        add_head(figure, "What is taken for what", marks, **_LEGEND)  # type: ignore[arg-type]
    return figure


def _ordered(names: Iterable[str]) -> list[str]:
    """Names in the order of the bench's faults, others behind them, nothing last."""
    order = list(dict.fromkeys(effect_of(fault) for fault in FAULTS))
    known = {name: i for i, name in enumerate(order)}
    return sorted(names, key=lambda name: (name == NOTHING, known.get(name, len(order)), name))


def _inks(table: np.ndarray, rows: Sequence[str], columns: Sequence[str]) -> np.ndarray:
    """Colours of the cells, (rows, columns, 3): the darker the larger a row's share."""
    inks = np.ones((*table.shape, 3))
    for i, j in np.argwhere(table):
        right, nothing = rows[i] == columns[j], columns[j] == NOTHING
        ink = np.array(to_rgb(BLUE if right else LIGHT_GREY if nothing else VERMILION))
        depth = 1.0 if right or nothing else 0.45 + 0.55 * table[i, j] / table[i].sum()
        inks[i, j] = 1.0 - depth * (1.0 - ink)
    return inks
