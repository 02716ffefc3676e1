"""Figures of a diagnosis: replay errors, gains of single effects, and comparisons of sets."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from leglab.base.output import piece
from leglab.diagnosis.balance.regions import equally_filled
from leglab.diagnosis.result import Diagnosis, ResidualTrace, shown_unit
from leglab.report.diagnosis import words
from leglab.report.figures import add_head
from leglab.report.page.wording import number, printable, readable, shortened
from leglab.report.style import BLACK, BLUE, DARK_GREY, GRID, LIGHT_GREY, ORANGE, VERMILION, style

_WIDTH = 6.6  # width of figures [inch], readable on a page and, with scrolling, on a phone
_ROW = 0.24  # height of a line of text and marks [inch]
_HEAD, _FOOT = 0.62, 0.5  # heights [inch] of title with legend, and of the x axis with its labels
_MOST_RECORDINGS = 30
_MOST_RANKS = 12
_LEAST_GAIN = 1e-2  # smallest gain in log probability that is drawn [nats]
_LONGEST = 28  # maximum number of characters of a label
_LEGEND: dict[str, Any] = {"columnspacing": 1.4, "handletextpad": 0.5}
_VALUE: dict[str, Any] = {
    "textcoords": "offset points",
    "va": "center",
    "fontsize": 8,
    "color": DARK_GREY,
    "bbox": {"facecolor": "white", "edgecolor": "none", "pad": 0.6},
}
# Residual figures: maximum numbers of channels, recordings per channel, points of a scatter plot.
_MOST_CHANNELS, _MOST_ROWS = 6, 6
_MOST_POINTS = 3000
_INNER = 0.99  # share of points within a scatter plot's axes; outliers are cut off
_BAR = 1e-5  # bar/Pa
# Absolute value in SI units at which a replay has diverged and is not drawn.
_DIVERGED = 1e11
# Approximate maximum number of points of a curve over a whole recording.
_MOST_SAMPLES = 3000
_BEFORE_AFTER: tuple[dict[str, Any], ...] = (
    {"color": VERMILION, "linestyle": "--", "linewidth": 1.0},
    {"color": BLUE, "linewidth": 1.0},
)
# Ratio of error before to error after up to which both axes have the same scale.
_ALIKE = 4.0


@dataclass(frozen=True, kw_only=True, eq=False)
class CaptionedFigure:
    """A figure with its caption, its file name without suffix, and its alternative text."""

    name: str
    figure: Figure
    caption: str
    alt: str


def short(name: str, most: int = _LONGEST) -> str:
    """Shortens a name for an axis: removes the file suffix, and cuts out the middle."""
    name = re.sub(r"\.(parquet|csv|mcap)$", "", printable(" ".join(name.split())))
    return shortened(name, most)


def pictures(result: Diagnosis) -> tuple[CaptionedFigure, ...]:
    """Draws all figures for which the diagnosis has data, in the order of the page."""
    makers = (overlay_picture, whole_picture, gap_picture, ranking_picture, rivals_picture)
    found: list[CaptionedFigure] = []
    for make in (*makers, residual_pictures):
        with piece(f"figures/{make.__name__.rpartition('_')[0]}*.png", result.missing):
            made = make(result)
            found += made if isinstance(made, tuple) else [made] if made else []
    return tuple(found)


def overlay_picture(result: Diagnosis) -> CaptionedFigure | None:
    """Draws measured and simulated signals in the worst and median held-out window, if any.

    Windows are ranked by the original model's error of the first channel at the window's end. The
    worst window of the improved model is added if it is a different window.
    """
    channels = words.main_channels(result)
    held = set(result.gap.held_out) or {r.name for r in result.recordings}
    windows = _windows(result, channels, held)
    if not windows:
        return None
    before, after = (
        np.array([abs(float(getattr(w[channels[0]], which)[-1])) for w in windows])
        for which in ("before", "after")
    )
    order = np.argsort(before, kind="stable")
    chosen = [("worst before", int(order[-1])), ("median before", int(order[order.size // 2]))]
    if (last := int(np.argmax(after))) not in {place for _, place in chosen}:
        chosen.append(("worst after", last))
    with style():
        rows = max(2, len(channels))  # A single channel has room for its error.
        figure = Figure(figsize=(_WIDTH, 0.85 + 1.55 * rows + 0.4))
        grid = figure.subplots(rows, len(chosen), sharex=True, squeeze=False)
        told = []
        for column, (title, place) in enumerate(chosen):
            for row, channel in enumerate(channels):
                axes, window = grid[row, column], windows[place][channel]
                told.append(_draw_overlay(axes, window, first=column == 0))
                if row == 0:
                    name = short(window.recording, 14)
                    axes.set_title(f"{title}\n{name}, {window.time[0]:.1f} s", fontsize=9)
            if len(channels) < rows:
                _draw_window_error(grid[-1, column], windows[place][channels[0]], first=not column)
            grid[-1, column].set_xlabel("time [s]")
        _lay_out(figure, "Measured over simulated", result)
    length = result.remaining[0].horizon if result.remaining else _length(windows[0][channels[0]])
    kept = " that no fit has seen" if result.gap.held_out else ""
    return CaptionedFigure(
        name="overlay",
        figure=figure,
        caption=f"Simulations of {length:.3g} s from {words.start(result)}, driven by the measured "
        f"command, in recordings{kept}; positions from where the window starts. Points are means "
        f"over {number(1e3 * length / windows[0][channels[0]].bins, 2)} ms: what changes faster is "
        "apart from the first point on. Worst and median "
        f"are by the error of {readable(channels[0])} at the end. Numbers: error at the end, "
        "before and after.",
        alt="Measured over simulated. " + " ".join(told),
    )


def _windows(
    result: Diagnosis, channels: Sequence[str], held: set[str]
) -> list[dict[str, ResidualTrace]]:
    """Returns, per window in which all channels are finite, the trace of each channel."""
    found: dict[tuple[str, int], dict[str, ResidualTrace]] = {}
    for trace in result.traces:
        if trace.recording not in held or trace.channel not in channels:
            continue
        for i in range(trace.time.size // trace.bins):
            part = slice(i * trace.bins, (i + 1) * trace.bins)
            kept = ("time", "position", "velocity", "before", "after", "measured")
            window = replace(trace, **{name: getattr(trace, name)[part] for name in kept})
            shown = np.concatenate([window.measured, window.before, window.after])
            if np.isfinite(shown).all() and float(np.abs(shown).max()) < _DIVERGED:
                found.setdefault((trace.recording, i), {})[trace.channel] = window
    return [w for w in found.values() if len(w) == len(channels)]


def _lay_out(figure: Figure, title: str, result: Diagnosis) -> None:
    """Adds title and legend to a figure of measured and simulated signals; fits the axes."""
    lines = [
        Line2D([], [], color=LIGHT_GREY, linewidth=4.0, label="measured"),
        Line2D([], [], **_BEFORE_AFTER[0], label="simulated, model as it was"),
        Line2D([], [], **_BEFORE_AFTER[1], label=f"simulated, {words.after_words(result)}"),
    ]
    add_head(figure, title, lines, **_LEGEND)
    figure.tight_layout(rect=(0, 0, 1, 1 - 0.52 / figure.get_figheight()))
    figure.align_ylabels()


def _length(window: ResidualTrace) -> float:
    step = float(np.median(np.diff(window.time))) if window.time.size > 1 else 0.0
    return round(step * window.bins, 3)


def _draw_overlay(axes: Axes, window: ResidualTrace, *, first: bool) -> str:
    """Draws one channel in one window; returns a description for the alternative text."""
    factor, unit = shown_unit(window.unit)
    measured = factor * window.measured
    errors = [factor * e for e in (window.before, window.after)]
    origin = measured[0] if window.channel.endswith("_position") else 0.0
    time = window.time - window.time[0]
    axes.plot(time, measured - origin, color=LIGHT_GREY, linewidth=4.0)
    for look, error in zip(_BEFORE_AFTER, errors, strict=True):
        axes.plot(time, measured - error - origin, **{**look, "linewidth": 1.3})
    axes.margins(y=0.22)
    ends = [abs(float(error[-1])) for error in errors]
    text = f"{number(ends[0], 2)} \u2192 {number(ends[1], 2)} {unit}"
    axes.annotate(
        text, (0.02, 0.97), xycoords="axes fraction", ha="left", va="top", fontsize=8, zorder=9,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8, "alpha": 0.8},
    )  # fmt: skip
    _tick(axes, 4, 4)
    if first:
        kind = window.channel.removeprefix(f"{words.joint_of(window.channel)}_") or window.channel
        axes.set_ylabel(f"{readable(short(kind, 14))} [{unit}]")
    return (
        f"{window.channel} in {window.recording} at {window.time[0]:.1f} s: {number(ends[0])} "
        f"{unit} off at the end before, {number(ends[1])} {unit} after."
    )


def _draw_window_error(axes: Axes, window: ResidualTrace, *, first: bool) -> None:
    """Draws simulated minus measured signals of a window, before and after."""
    factor, unit = shown_unit(window.unit)
    axes.axhline(0.0, color=LIGHT_GREY, linewidth=4.0)
    for look, error in zip(_BEFORE_AFTER, (window.before, window.after), strict=True):
        axes.plot(window.time - window.time[0], -factor * error, **{**look, "linewidth": 1.3})
    _tick(axes, None, 4)
    if first:
        axes.set_ylabel(f"simulated less\nmeasured [{unit}]")


def _tick(axes: Axes, across: int | None, up: int) -> None:
    """Sets the approximate number of ticks in x (`across`; None: unchanged) and y (`up`)."""
    for axis, most in ((axes.xaxis, across), (axes.yaxis, up)):
        if most is not None:
            axis.set_major_locator(MaxNLocator(most, steps=[1, 2, 5, 10]))


def whole_picture(result: Diagnosis) -> CaptionedFigure | None:
    """Draws a held-out recording with its closed-loop simulations; None if there are none."""
    whole = result.whole
    if whole is None or not np.isfinite(whole.after).all():
        return None
    factor, unit = shown_unit(whole.unit)
    every = max(1, whole.time.size // _MOST_SAMPLES)
    time = (whole.time - whole.time[0])[::every]
    measured = whole.measured[::every]
    simulated = [which[::every] for which in (whole.before, whole.after)]
    corrections = [c[::every] for c in (whole.correction_before, whole.correction_after)]
    drawn = (
        (f"position [{unit}]", [factor * s for s in simulated]),
        (f"simulated less\nmeasured [{unit}]", [factor * (s - measured) for s in simulated]),
        ("correction\n[%]", [100.0 * c for c in corrections]),
    )
    with style():
        figure = Figure(figsize=(_WIDTH, 5.2))
        rows = figure.subplots(3, 1, sharex=True)
        rows[0].plot(time, factor * measured, color=LIGHT_GREY, linewidth=4.0)
        for axes, (label, curves) in zip(rows, drawn, strict=True):
            if axes is not rows[0]:
                axes.axhline(0.0, color=LIGHT_GREY, linewidth=1.6)
            for look, values in zip(_BEFORE_AFTER, curves, strict=True):
                axes.plot(time, values, **look)
            axes.set_ylabel(label)
            _tick(axes, None, 4)
        rows[-1].set_xlabel("time [s]")
        _lay_out(figure, f"The whole of {short(whole.recording, 40)}", result)
    told = whole.to_json()

    def change(key: str, scale: float, unit: str) -> str:
        before, after = (scale * told[f"{key}{which}"] for which in ("before", "after"))
        first = number(before, 2) if math.isfinite(before) else "beyond bounds"
        return f"{first} \u2192 {number(after, 2)} {unit}"

    away, help_ = change("", factor, unit), change("correction_", 100.0, "%")
    return CaptionedFigure(
        name="whole",
        figure=figure,
        caption=f"One simulation over the whole recording: the measured command of "
        f"{readable(whole.actuator)} plus a correction by a slow position loop, without which any "
        f"model drifts away. RMS error of {readable(whole.joint)}: {away}. RMS correction, in per "
        f"cent of the command's standard deviation: {help_}.",
        alt=f"Whole recording {whole.recording} in closed loop. RMS error of {whole.joint} {away}, "
        f"correction {help_}.",
    )


def gap_picture(result: Diagnosis) -> CaptionedFigure | None:
    """Draws each recording's replay error before, recalibrated and after; None if unknown."""
    rows = [r for r in words.in_order(result) if math.isfinite(r.before) and math.isfinite(r.after)]
    rows = rows[:_MOST_RECORDINGS]
    if not rows:
        return None
    floor = result.gap.noise_floor
    with style():
        figure, axes = _rows([short(r.name, 44) + " *" * r.held_out for r in rows])
        _log(axes, [floor, *(v for r in rows for v in (r.before, r.baseline, r.after))])
        axes.axvline(floor, color=DARK_GREY, linestyle="--", linewidth=1.0, zorder=1)
        for i, row in enumerate(rows):
            axes.plot([row.before, row.after], [i, i], color=LIGHT_GREY, linewidth=1.6, zorder=2)
            if result.recalibrated:
                axes.plot(row.baseline, i, "d", color=DARK_GREY, markersize=5, zorder=3)
            axes.plot(row.before, i, "o", color=VERMILION, markersize=7, zorder=4)
            axes.plot(row.after, i, "o", color=BLUE, markersize=7, zorder=5)
            sides = (6, -6) if row.before >= row.after else (-6, 6)
            for value, side in zip((row.before, row.after), sides, strict=True):
                beside = "left" if side > 0 else "right"
                axes.annotate(number(value), (value, i), xytext=(side, 0), ha=beside, **_VALUE)
        axes.set_xlabel("replay error [noise levels]")
        marks = [_mark("as it was", VERMILION)]
        marks += [_mark("recalibrated", DARK_GREY, "d")] if result.recalibrated else []
        noise = Line2D([], [], color=DARK_GREY, linestyle="--", label="noise alone")
        found = "with what was found" if result.recalibrated else words.after_words(result)
        lines = [*marks, _mark(found, BLUE), noise]
        add_head(figure, "Gap between simulation and recording", lines, **_LEGEND)
    held = "; * was kept from all fits" if any(r.held_out for r in rows) else ""
    return CaptionedFigure(
        name="gap",
        figure=figure,
        caption=f"How far each recording is from its replay; noise alone gives {floor:g}{held}.",
        alt="Replay error in noise levels. "
        + " ".join(f"{r.name}: {number(r.before)} before, {number(r.after)} after." for r in rows),
    )


def ranking_picture(result: Diagnosis) -> CaptionedFigure | None:
    """Draws the gain in log probability by each single effect; None if no effect has a gain."""
    # Without a limit, gains as small as rounding errors would stretch the axis to ten decades.
    useful = [r for r in result.ranking if math.isfinite(r.gain) and r.gain > _LEAST_GAIN]
    ranks = sorted(useful, key=lambda r: -r.gain)[:_MOST_RANKS]
    if not ranks:
        return None
    named = {(e.name, e.element) for e in result.effects}
    tied = {name for e in result.effects for name in e.indistinguishable_from}
    with style():
        elements = [short(rank.element, _LONGEST // 2) for rank in ranks]
        names = [short(readable(rank.name)) for rank in ranks]
        figure, axes = _rows([f"{n}, {e}" for n, e in zip(names, elements, strict=True)])
        _log(axes, [rank.gain for rank in ranks])
        axes.grid(True, axis="y")
        for i, rank in enumerate(ranks):
            color = ORANGE if rank.name in tied else LIGHT_GREY
            color = BLUE if (rank.name, rank.element) in named else color
            axes.plot(rank.gain, i, "o", color=color, markersize=7)
        axes.set_xlabel("gain in probability, natural logarithm")
        others = [_mark("not told apart", ORANGE)] * bool(tied) + [_mark("other", LIGHT_GREY)]
        title = f"Which effect explains most alone (best {len(ranks)} of {len(result.ranking)})"
        add_head(figure, title, [_mark("named", BLUE), *others], **_LEGEND)
    return CaptionedFigure(
        name="ranking",
        figure=figure,
        caption="By how much each effect alone makes the recordings more probable than none does, "
        "before anything is fitted to the end. Several may gain by the same error: what is named "
        "is decided among sets that were fitted.",
        alt=f"Best alone is {ranks[0].name} at {ranks[0].element} with {number(ranks[0].gain)}.",
    )


def rivals_picture(result: Diagnosis) -> CaptionedFigure | None:
    """Draws the probability of each set of effects versus each other set; None for one set."""
    rivals = next((r for r in result.rivals if len(r.names) > 1), None)
    if rivals is None:
        return None
    count = len(rivals.names)
    labels = [f"{short(readable(n), 40)}  {i}" for i, n in enumerate(rivals.names, start=1)]
    left = 0.08 * max(map(len, labels)) + 0.2
    height, above = 0.36 * count, 0.75
    share = 100.0 * np.asarray(rivals.preference, dtype=np.float64)
    np.fill_diagonal(share, np.nan)
    colors = LinearSegmentedColormap.from_list("preference", ["#FFFFFF", BLUE])
    with style():
        figure = Figure(figsize=(_WIDTH, above + height + 0.1))
        axes = _axes(figure, (left, 0.1, min(0.72 * count, _WIDTH - left - 0.2), height))
        axes.imshow(share, cmap=colors, vmin=0.0, vmax=100.0, aspect="auto")
        for i, j in np.argwhere(np.isfinite(share)):
            ink = "white" if share[i, j] > 60.0 else "black"
            axes.text(j, i, f"{share[i, j]:.0f}", ha="center", va="center", color=ink)
        axes.set_facecolor(GRID)  # the diagonal
        axes.set_yticks(range(count), labels)
        axes.set_xticks(range(count), [str(i) for i in range(1, count + 1)])
        axes.set_xticks(np.arange(-0.5, count), minor=True)
        axes.set_yticks(np.arange(-0.5, count), minor=True)
        axes.xaxis.tick_top()
        axes.tick_params(which="both", length=0)
        axes.grid(False)
        axes.grid(True, which="minor", axis="both", color=LIGHT_GREY)
        axes.set_axisbelow(False)
        for side in axes.spines.values():
            side.set_visible(False)
        add_head(figure, "Sets of effects that were fitted to the end", [])
    return CaptionedFigure(
        name="rivals",
        figure=figure,
        caption="Probability in per cent of the set in the row against that in the column, by the "
        "recordings as a whole; near 50 they are not told apart.",
        alt=" ".join(
            f"{rivals.names[0]} beats {name} with {one:.0%}."
            for name, one in zip(rivals.names[1:], rivals.preference[0, 1:], strict=True)
        ),
    )


def _rows(labels: Sequence[str]) -> tuple[Figure, Axes]:
    """Makes a figure with one labelled y position per row, top to bottom."""
    left = max(1.5, 0.075 * max(len(label) for label in labels) + 0.2)
    height = _ROW * 1.35 * len(labels) + 0.2
    figure = Figure(figsize=(_WIDTH, _HEAD + height + _FOOT))
    axes = _axes(figure, (left, _FOOT, _WIDTH - left - 0.25, height))
    axes.set_yticks(range(len(labels)), labels)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    return figure, axes


def _axes(figure: Figure, place: tuple[float, float, float, float]) -> Axes:
    """Adds axes to a figure; `place` is left, bottom, width and height [inch]."""
    width, height = figure.get_size_inches()
    left, bottom, across, up = place
    return figure.add_axes((left / width, bottom / height, across / width, up / height))


def _log(axes: Axes, values: Sequence[float]) -> None:
    """Makes the x axis logarithmic, with plain numbers and room for all values and labels."""
    held = [v for v in values if math.isfinite(v) and v > 0.0] or [1.0]
    axes.set_xscale("log")
    # Margins on both sides: a sixth of the decades of the data, at least 0.08 decades.
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


def residual_pictures(result: Diagnosis) -> tuple[CaptionedFigure, ...]:
    """Draws two error figures per channel, over state and over time; most improved ones first."""
    grouped: dict[str, list[ResidualTrace]] = {}
    for trace in result.traces:
        if np.isfinite(trace.before).any() and np.isfinite(trace.after).any():
            grouped.setdefault(trace.channel, []).append(trace)

    def gain(traces: Sequence[ResidualTrace]) -> float:
        before, after = map(words.finite_rms, _errors(traces))
        return before / after if after > 0.0 else math.inf

    lengths = {t.channel: t.unit for t in result.traces if t.channel.endswith("_position")}
    held = {r.name: r.held_out for r in words.in_order(result)}
    pictures = []
    chosen = sorted(grouped.values(), key=gain, reverse=True)[:_MOST_CHANNELS]
    for i, traces in enumerate(chosen, start=1):
        channel = traces[0].channel
        name = f"{i}_{re.sub(r'[^A-Za-z0-9]+', '_', channel)[:40].strip('_')}"
        position = re.sub(r"_(position|pressure_[ab])$", "", channel) + "_position"
        pictures.append(_over_state(traces, name, lengths.get(position, "SI")))
        pictures.append(_over_time(traces, name, held))
    return tuple(pictures)


def _errors(traces: Sequence[ResidualTrace]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    return [t.before for t in traces], [t.after for t in traces]


def _over_state(traces: Sequence[ResidualTrace], name: str, length: str) -> CaptionedFigure:
    """Draws a channel's errors over position, velocity and, if measured, pressure difference."""
    factor, unit = shown_unit(traces[0].unit)
    before, after = (factor * np.concatenate(errors) for errors in _errors(traces))
    states = [
        (f"position [{length}]", np.concatenate([t.position for t in traces])),
        (f"velocity [{length}/s]", np.concatenate([t.velocity for t in traces])),
    ]
    measured = [t.pressure for t in traces if t.pressure is not None]
    if len(measured) == len(traces):
        states.append(("pressure difference [bar]", _BAR * np.concatenate(measured)))
    limits = _limits(before, after, _INNER)
    with style():
        figure = Figure(figsize=(_WIDTH, 4.5))
        grid = figure.subplots(2, len(states), sharey="row", sharex="col", squeeze=False)
        for row, values, color, limit in zip(
            grid, (before, after), (VERMILION, BLUE), limits, strict=True
        ):
            for axes, (_, state) in zip(row, states, strict=True):
                _cloud(axes, state, values, color)
                axes.set_ylim(-limit, limit)
                _tick(axes, 4, 5)
            row[0].set_ylabel(f"error [{unit}]")
        for axes, (label, _) in zip(grid[1], states, strict=True):
            axes.set_xlabel(label)
        alt = _finish(figure, [*grid[:, 0]], traces[0].channel, "state", (before, after), unit)
    return CaptionedFigure(
        name=f"residual_state_{name}",
        figure=figure,
        caption=f"Replay error of {traces[0].channel} in all recordings against the state, before "
        "(top) and after (bottom); the lines are medians, the outermost 1 % is cut off, and what "
        "is left over should show no shape.",
        alt=alt,
    )


def _over_time(
    traces: Sequence[ResidualTrace], name: str, held: dict[str, bool]
) -> CaptionedFigure:
    """Draws errors over time, one row per recording; `held`: whether a recording is held out."""
    factor, unit = shown_unit(traces[0].unit)
    worst = sorted(traces, key=lambda t: (not held.get(t.recording), -words.finite_rms([t.before])))
    places = {name: i for i, name in enumerate(held)}
    shown = sorted(worst[:_MOST_ROWS], key=lambda t: places.get(t.recording, len(places)))
    before, after = (factor * np.concatenate(errors) for errors in _errors(shown))
    limits = _limits(before, after, 1.0)
    with style():
        figure = Figure(figsize=(_WIDTH, 1.5 + 0.95 * len(shown)))
        grid = figure.subplots(len(shown), 2, sharey="col", sharex=True, squeeze=False)
        for row, trace in zip(grid, shown, strict=True):
            pairs = zip(row, (trace.before, trace.after), (VERMILION, BLUE), limits, strict=True)
            for axes, values, color, limit in pairs:
                axes.plot(*_by_window(trace, factor * values), color=color, linewidth=0.7)
                axes.set_ylim(-limit, limit)
                _tick(axes, 6, 3)
            star = " *" * held.get(trace.recording, False)
            # The recording's name is on the right, where there are no tick labels.
            row[1].yaxis.set_label_position("right")
            row[1].set_ylabel(short(trace.recording, 16) + star, rotation=0, ha="left", va="center")
            row[0].set_ylabel(f"[{unit}]")
        for axes in grid[-1]:
            axes.set_xlabel("time [s]")
        alt = _finish(figure, [*grid[0]], traces[0].channel, "time", (before, after), unit)
    return CaptionedFigure(
        name=f"residual_time_{name}",
        figure=figure,
        caption=f"Replay error of {traces[0].channel} over time, before (left) and after (right); "
        "every replay starts anew from the measured state after a fraction of a second, hence the "
        "teeth" + ("; * was kept from all fits." if any(held.values()) else "."),
        alt=alt,
    )


def _limits(before: np.ndarray, after: np.ndarray, share: float) -> tuple[float, float]:
    """Returns half the y range of both axes, from a quantile; equal unless errors differ much."""
    low, high = (
        1.1 * float(np.quantile(np.abs(values[np.isfinite(values)]), share)) or 1.0
        for values in (before, after)
    )
    most = max(low, high)
    return (most, most) if most < _ALIKE * min(low, high) else (low, high)


def _by_window(trace: ResidualTrace, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns time and values with NaN after each window, so that no line connects windows."""
    ends = np.arange(trace.bins, trace.time.size, trace.bins)
    return np.insert(trace.time, ends, np.nan), np.insert(values, ends, np.nan)


def _cloud(axes: Axes, state: np.ndarray, values: np.ndarray, color: str) -> None:
    """Draws a subset of the points, and the medians of all in equally filled bins of the state."""
    finite = np.isfinite(state) & np.isfinite(values)
    state, values = state[finite], values[finite]
    step = max(1, math.ceil(state.size / _MOST_POINTS))
    dots: dict[str, Any] = {"markersize": 2, "alpha": 0.35, "markeredgewidth": 0}
    axes.plot(state[::step], values[::step], ".", color=color, rasterized=True, **dots)
    axes.axhline(0.0, color=DARK_GREY, linewidth=0.6)
    parts = equally_filled(state)
    middle = [float(np.median(state[part])) for part in parts]
    axes.plot(middle, [float(np.median(values[part])) for part in parts], color=BLACK)
    if state.size:
        low, high = np.quantile(state, [1.0 - _INNER, _INNER])
        room = 0.05 * (high - low) or 1.0
        axes.set_xlim(low - room, high + room)


def _finish(
    figure: Figure,
    pair: Sequence[Axes],
    channel: str,
    over: str,
    errors: tuple[np.ndarray, np.ndarray],
    unit: str,
) -> str:
    """Writes titles of figure and axes (`pair`: before, after); returns the alternative text."""
    before, after = (f"{number(words.finite_rms([values]))} {unit}" for values in errors)
    (_, high), (_, low) = (axes.get_ylim() for axes in pair)
    finer = f", scale {number(high / low, 2)} times finer" if high > low else ""
    pair[0].set_title(f"before: {before} RMS", color=VERMILION, fontsize=9)
    pair[1].set_title(f"after: {after} RMS{finer}", color=BLUE, fontsize=9)
    add_head(figure, f"{short(readable(channel))}: error over {over}", ())
    figure.tight_layout(rect=(0, 0, 1, 1 - 0.3 / figure.get_figheight()))
    figure.align_ylabels()
    return f"Errors of {channel}: {before} RMS before, {after} after."
