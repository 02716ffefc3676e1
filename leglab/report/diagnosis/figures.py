"""Figures of a diagnosis: gaps, screening, rivals. Residuals are in `residuals`."""

import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from leglab.diagnosis.result import Diagnosis, Rank, Rivals
from leglab.report.page.wording import number, readable, shortened
from leglab.report.style import BLUE, DARK_GREY, LIGHT_GREY, ORANGE, VERMILION, style

WIDTH = 6.6  # inch: readable on a page and, scrolled sideways, on a phone
_ROW = 0.24  # inch a line of text and marks
_HEAD, _FOOT = 0.62, 0.5  # inch: title and legend; axis
_MOST_RECORDINGS = 30
_MOST_RANKS = 12
_LONGEST = 28  # characters of a label


@dataclass(frozen=True, kw_only=True, eq=False)
class Picture:
    """A figure with the words that belong to it.

    Attributes:
        name: Of the file, without suffix.
        figure: As drawn.
        caption: One sentence.
        alt: What one would see.
    """

    name: str
    figure: Figure
    caption: str
    alt: str


@contextmanager
def look() -> Iterator[None]:
    """The common style; names are drawn as they are, a "$" in them starts no formula."""
    with style(), mpl.rc_context({"text.parse_math": False}):
        yield


def short(name: str, most: int = _LONGEST) -> str:
    """A name that fits beside an axis: without its file type, cut in the middle."""
    name = "".join(c if c.isprintable() else "\ufffd" for c in " ".join(name.split()))
    name = re.sub(r"\.(parquet|csv|mcap)$", "", name)
    return shortened(name, most)


def gap_picture(result: Diagnosis) -> Picture | None:
    """Replay error of every recording before, recalibrated and after; None without any."""
    rows = [r for r in result.recordings if math.isfinite(r.before) and math.isfinite(r.after)]
    rows = sorted(rows, key=lambda r: (not r.held_out, -r.before))[:_MOST_RECORDINGS]
    if not rows:
        return None
    floor = result.gap.noise_floor
    with look():
        figure, axes = _rows([short(r.name, 44) + " *" * r.held_out for r in rows], 1.5)
        _log(axes, [floor, *(v for r in rows for v in (r.before, r.baseline, r.after))])
        axes.axvline(floor, color=DARK_GREY, linestyle="--", linewidth=1.0, zorder=1)
        for i, row in enumerate(rows):
            axes.plot([row.before, row.after], [i, i], color=LIGHT_GREY, linewidth=1.6, zorder=2)
            axes.plot(row.baseline, i, "d", color=DARK_GREY, markersize=5, zorder=3)
            axes.plot(row.before, i, "o", color=VERMILION, markersize=7, zorder=4)
            axes.plot(row.after, i, "o", color=BLUE, markersize=7, zorder=5)
            sides = (6, -6) if row.before >= row.after else (-6, 6)
            for value, side in zip((row.before, row.after), sides, strict=True):
                axes.annotate(
                    number(value),
                    (value, i),
                    xytext=(side, 0),
                    textcoords="offset points",
                    ha="left" if side > 0 else "right",
                    va="center",
                    fontsize=8,
                    color=DARK_GREY,
                    bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},
                )
        axes.set_xlabel("replay error [noise levels]")
        _head(
            figure,
            "Gap between simulation and recording",
            [
                _mark("as it was", VERMILION),
                _mark("recalibrated", DARK_GREY, "d"),
                _mark("with what was found", BLUE),
                Line2D([], [], color=DARK_GREY, linestyle="--", label="noise alone"),
            ],
        )
    held = "; * was kept from all fits" if any(r.held_out for r in rows) else ""
    return Picture(
        name="gap",
        figure=figure,
        caption=f"How far each recording is from its replay; noise alone gives {floor:g}{held}.",
        alt="Replay error in noise levels. "
        + " ".join(f"{r.name}: {number(r.before)} before, {number(r.after)} after." for r in rows),
    )


def ranking_picture(result: Diagnosis) -> Picture | None:
    """What each effect saves, one panel a round, beside what chance saves; None if none does."""
    rounds = [
        (number_, [r for r in result.ranking if r.round == number_])
        for number_ in sorted({r.round for r in result.ranking})
    ]
    shown = [(n, _best(ranks)) for n, ranks in rounds if _best(ranks)]
    if not shown:
        return None
    named = {(e.name, e.element) for e in result.effects}
    tied = {name for e in result.effects for name in e.indistinguishable_from}
    with look():
        heights = [_ROW * len(ranks) + 0.2 for _, ranks in shown]
        total = _HEAD + sum(heights) + (0.3 + _FOOT) * len(shown)
        figure = Figure(figsize=(WIDTH, total))
        top = total - _HEAD - 0.3
        labels = [_rank_label(rank) for _, ranks in shown for rank in ranks]
        left = 0.07 * max(len(label) for label in labels) + 0.25
        for (round_, ranks), height in zip(shown, heights, strict=True):
            axes = _axes(figure, (left, top - height, WIDTH - left - 0.35, height))
            _draw_ranks(axes, ranks, named, tied)
            rest = len(dict(rounds)[round_]) - len(ranks)
            axes.set_title(f"round {round_}" + (f", best {len(ranks)}" if rest else ""))
            axes.set_xlabel("chi-square saved on first trial")
            top -= height + 0.3 + _FOOT
        others = [_mark("not told apart", ORANGE)] * bool(tied) + [_mark("other", LIGHT_GREY)]
        chance = Line2D([], [], color=VERMILION, linestyle="--", label="chance, 1 in 100")
        _head(figure, "Which effect helps, on first trial", [_mark("named", BLUE), *others, chance])
    return Picture(
        name="ranking",
        figure=figure,
        caption="What adding each effect alone saves; left of the dashed line is what the best of "
        "all saves by chance in 1 of 100 cases.",
        alt=" ".join(
            f"Round {n}: best is {ranks[0].name} at {ranks[0].element} with "
            f"{number(ranks[0].gain)}, chance gives {number(ranks[0].threshold)}."
            for n, ranks in shown
        ),
    )


def rivals_picture(result: Diagnosis) -> Picture | None:
    """Share of resampled data in which one effect beats another; None where none had a rival."""
    rounds = [r for r in result.rivals if len(r.names) > 1]
    if not rounds:
        return None
    cell, left = 0.72, 2.35
    longest = max(len(short(name)) for r in rounds for name in r.names)
    above = 0.035 * longest + 0.2  # names at 30 degrees
    heights = [above + 0.36 * len(r.names) for r in rounds]
    total = 0.4 + sum(heights) + 0.15 * len(rounds)
    with look():
        figure = Figure(figsize=(WIDTH, total))
        top = total - 0.4
        for rivals, height in zip(rounds, heights, strict=True):
            count = len(rivals.names)
            width = min(cell * count, WIDTH - left - 0.9)
            axes = _axes(figure, (left, top - height, width, height - above))
            _draw_rivals(axes, rivals)
            figure.text(0.1 / WIDTH, (top - above) / total, f"round {rivals.round}", va="bottom")
            top -= height + 0.15
        _head(figure, "Rivals fitted to the end", [])
    return Picture(
        name="rivals",
        figure=figure,
        caption="Percent of resampled data sets in which the effect of the row explains the "
        "recordings better than that of the column; near 50 they are not told apart.",
        alt=" ".join(
            f"Round {r.round}: {r.names[0]} beats {name} in {share:.0%}."
            for r in rounds
            for name, share in zip(r.names[1:], r.preference[0, 1:], strict=True)
        ),
    )


def _best(ranks: Sequence[Rank]) -> list[Rank]:
    useful = [r for r in ranks if math.isfinite(r.gain) and r.gain > 0.0]
    return sorted(useful, key=lambda r: -r.gain)[:_MOST_RANKS]


def _rank_label(rank: Rank) -> str:
    return f"{short(readable(rank.name))}, {short(rank.element, _LONGEST // 2)}"


def _draw_ranks(
    axes: Axes, ranks: Sequence[Rank], named: set[tuple[str, str]], tied: set[str]
) -> None:
    threshold = ranks[0].threshold
    marked = math.isfinite(threshold) and threshold > 0.0
    _log(axes, [*(r.gain for r in ranks), threshold])
    _label(axes, [_rank_label(r) for r in ranks])
    if marked:
        axes.axvline(threshold, color=VERMILION, linestyle="--", linewidth=1.0)
    for i, rank in enumerate(ranks):
        color = ORANGE if rank.name in tied else LIGHT_GREY
        color = BLUE if (rank.name, rank.element) in named else color
        if marked:
            axes.plot([threshold, rank.gain], [i, i], color=color, linewidth=1.6)
        axes.plot(rank.gain, i, "o", color=color, markersize=6)


def _draw_rivals(axes: Axes, rivals: Rivals) -> None:
    count = len(rivals.names)
    share = 100.0 * np.asarray(rivals.preference, dtype=np.float64)
    np.fill_diagonal(share, np.nan)
    colors = LinearSegmentedColormap.from_list("preference", ["#FFFFFF", BLUE])
    axes.imshow(share, cmap=colors, vmin=0.0, vmax=100.0, aspect="auto")
    for i in range(count):
        for j in range(count):
            if i != j and np.isfinite(share[i, j]):
                ink = "white" if share[i, j] > 60.0 else "black"
                axes.text(j, i, f"{share[i, j]:.0f}", ha="center", va="center", color=ink)
    axes.set_xticks(np.arange(-0.5, count), minor=True)
    axes.set_yticks(np.arange(-0.5, count), minor=True)
    axes.set_facecolor("#E6E6E6")  # the diagonal
    names = [short(readable(name)) for name in rivals.names]
    axes.set_xticks(range(count), names, rotation=30, ha="left", rotation_mode="anchor")
    axes.set_yticks(range(count), names)
    axes.xaxis.tick_top()
    axes.tick_params(which="both", length=0)
    axes.grid(False)
    axes.grid(True, which="minor", axis="both", color=LIGHT_GREY)
    axes.set_axisbelow(False)
    for side in axes.spines.values():
        side.set_visible(False)


def _rows(labels: Sequence[str], left: float) -> tuple[Figure, Axes]:
    """A figure with one labelled line a row, labels on the left margin [inch]."""
    left = max(left, 0.075 * max(len(label) for label in labels) + 0.2)
    height = _ROW * 1.35 * len(labels) + 0.2
    total = _HEAD + height + _FOOT
    figure = Figure(figsize=(WIDTH, total))
    axes = _axes(figure, (left, _FOOT, WIDTH - left - 0.25, height))
    _label(axes, labels)
    return figure, axes


def _axes(figure: Figure, place: tuple[float, float, float, float]) -> Axes:
    """Axes at left, bottom, width and height [inch]."""
    width, height = figure.get_size_inches()
    left, bottom, across, up = place
    return figure.add_axes((left / width, bottom / height, across / width, up / height))


def _label(axes: Axes, labels: Sequence[str]) -> None:
    axes.set_yticks(range(len(labels)), labels)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)


def _log(axes: Axes, values: Sequence[float]) -> None:
    """A logarithmic axis with plain numbers that holds all values and room for their labels."""
    held = [v for v in values if math.isfinite(v) and v > 0.0] or [1.0]
    axes.set_xscale("log")
    # An eighth of the axis on both sides, of half a decade at least.
    pad = 10.0 ** max(math.log10(max(held) / min(held)) / 6.0, 0.08)
    axes.set_xlim(min(held) / pad, max(held) * pad)
    decades = math.log10(max(held) / min(held) * pad * pad)
    subs = (1.0, 2.0, 5.0) if decades < 2.2 else (1.0,)
    axes.xaxis.set_major_locator(LogLocator(subs=subs, numticks=12))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(True, axis="x")
    axes.grid(False, axis="y")


def _mark(label: str, color: str, marker: str = "o") -> Line2D:
    return Line2D([], [], color=color, marker=marker, linestyle="", label=label)


def _head(figure: Figure, title: str, lines: Sequence[Line2D]) -> None:
    width, height = figure.get_size_inches()
    left = 0.1 / width
    figure.text(left, 1 - 0.08 / height, title, va="top", fontsize=12, fontweight="bold")
    if lines:
        figure.legend(
            handles=list(lines),
            loc="upper left",
            bbox_to_anchor=(left, 1 - 0.36 / height),
            ncols=len(lines),
            borderpad=0,
            borderaxespad=0,
            columnspacing=1.4,
            handletextpad=0.5,
        )
