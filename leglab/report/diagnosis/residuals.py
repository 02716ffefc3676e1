"""Residuals of a diagnosis: errors of the replays over state and time, before and after."""

import math
import re
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from leglab.diagnosis.result import Diagnosis, ResidualTrace
from leglab.report.diagnosis.figures import WIDTH, Picture, look, short
from leglab.report.diagnosis.words import rms, shown_unit
from leglab.report.page.wording import number, readable
from leglab.report.style import BLACK, BLUE, DARK_GREY, VERMILION

_MOST_CHANNELS = 6
_MOST_RECORDINGS = 6
_MOST_POINTS = 3000
_INNER = 0.99  # share of the points within the axes of a cloud: outliers would set the scale
_BINS = 20
_FEWEST = 8  # points of a bin whose median is drawn
_BAR = 1e-5  # bar/Pa
# Both rows share their scale unless the errors shrink by more than this factor.
_ALIKE = 4.0


def residual_pictures(result: Diagnosis) -> tuple[Picture, ...]:
    """Two figures a channel, over state and over time; channels that gained most come first."""
    grouped: dict[str, list[ResidualTrace]] = {}
    for trace in result.traces:
        if np.isfinite(trace.before).any() and np.isfinite(trace.after).any():
            grouped.setdefault(trace.channel, []).append(trace)
    chosen = sorted(grouped.values(), key=lambda traces: -_gain(traces))[:_MOST_CHANNELS]
    lengths = {
        trace.channel.removesuffix("_position"): trace.unit
        for trace in result.traces
        if trace.channel.endswith("_position")
    }
    pictures = []
    for i, traces in enumerate(chosen, start=1):
        name = f"{i}_{re.sub(r'[^A-Za-z0-9]+', '_', traces[0].channel)[:40].strip('_')}"
        joint = re.sub(r"_(position|pressure_[ab])$", "", traces[0].channel)
        pictures += [
            _over_state(traces, name, lengths.get(joint, "SI")),
            _over_time(traces, name, {r.name for r in result.recordings if r.held_out}),
        ]
    return tuple(pictures)


def _gain(traces: Sequence[ResidualTrace]) -> float:
    after = rms([t.after for t in traces])
    return rms([t.before for t in traces]) / after if after > 0.0 else math.inf


def _over_state(traces: Sequence[ResidualTrace], name: str, length: str) -> Picture:
    """Errors of all recordings over position, velocity and, where measured, pressure."""
    factor, unit = shown_unit(traces[0].unit)
    before = factor * np.concatenate([t.before for t in traces])
    after = factor * np.concatenate([t.after for t in traces])
    states = [
        (f"position [{length}]", np.concatenate([t.position for t in traces])),
        (f"velocity [{length}/s]", np.concatenate([t.velocity for t in traces])),
    ]
    measured = [t.pressure for t in traces if t.pressure is not None]
    if len(measured) == len(traces):
        states.append(("pressure difference [bar]", _BAR * np.concatenate(measured)))
    limits = _limits(before, after, _INNER)
    with look():
        figure = Figure(figsize=(WIDTH, 4.5))
        grid = figure.subplots(2, len(states), sharey="row", sharex="col", squeeze=False)
        for row, values, color, limit in zip(
            grid, (before, after), (VERMILION, BLUE), limits, strict=True
        ):
            for axes, (_, state) in zip(row, states, strict=True):
                _cloud(axes, state, values, color)
                axes.set_ylim(-limit, limit)
                axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
                axes.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
            row[0].set_ylabel(f"error [{unit}]")
        for axes, (label, _) in zip(grid[1], states, strict=True):
            axes.set_xlabel(label)
        _titles(grid[0][0], grid[1][0], before, after, unit, limits)
        _finish(figure, f"{short(readable(traces[0].channel))}: error over state")
    return Picture(
        name=f"residual_state_{name}",
        figure=figure,
        caption=f"Replay error of {traces[0].channel} in all recordings against the state, before "
        "(top) and after (bottom); black lines are medians, the outermost 1 % is cut off, and what "
        "is left over should show no shape.",
        alt=_alt(traces[0].channel, before, after, unit),
    )


def _over_time(traces: Sequence[ResidualTrace], name: str, held: set[str]) -> Picture:
    """Errors over time, a row a recording."""
    factor, unit = shown_unit(traces[0].unit)
    shown = sorted(traces, key=lambda t: (t.recording not in held, -rms([t.before])))
    shown = shown[:_MOST_RECORDINGS]
    before = factor * np.concatenate([t.before for t in shown])
    after = factor * np.concatenate([t.after for t in shown])
    limits = _limits(before, after, 1.0)
    with look():
        figure = Figure(figsize=(WIDTH, 1.5 + 0.95 * len(shown)))
        grid = figure.subplots(len(shown), 2, sharey="col", sharex=True, squeeze=False)
        for row, trace in zip(grid, shown, strict=True):
            pairs = zip(row, (trace.before, trace.after), (VERMILION, BLUE), limits, strict=True)
            for axes, values, color, limit in pairs:
                axes.plot(*_broken(trace.time, factor * values), color=color, linewidth=0.7)
                axes.set_ylim(-limit, limit)
                axes.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
                axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
            star = " *" if trace.recording in held else ""
            # On the right, where no tick labels are.
            row[1].yaxis.set_label_position("right")
            row[1].set_ylabel(short(trace.recording, 16) + star, rotation=0, ha="left", va="center")
            row[0].set_ylabel(f"[{unit}]")
        for axes in grid[-1]:
            axes.set_xlabel("time [s]")
        _titles(grid[0][0], grid[0][1], before, after, unit, limits)
        _finish(figure, f"{short(readable(traces[0].channel))}: error over time")
    return Picture(
        name=f"residual_time_{name}",
        figure=figure,
        caption=f"Replay error of {traces[0].channel} over time, before (left) and after (right); "
        "every replay starts anew from the measured state after a fraction of a second, hence the "
        "teeth" + ("; * was kept from all fits." if held else "."),
        alt=_alt(traces[0].channel, before, after, unit),
    )


def _limits(before: np.ndarray, after: np.ndarray, share: float) -> tuple[float, float]:
    """Half heights of the axes for a share of the points; common where both errors are alike."""
    ends = []
    for values in (before, after):
        finite = np.abs(values[np.isfinite(values)])
        ends.append(1.1 * float(np.quantile(finite, share)) or 1.0)
    if max(ends) < _ALIKE * min(ends):
        return max(ends), max(ends)
    return ends[0], ends[1]


def _broken(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """In the order of time, with a NaN where windows are missing: no line over a gap."""
    order = np.argsort(time, kind="stable")
    time, values = time[order], values[order]
    steps = np.diff(time)
    usual = steps[steps > 0.0]
    longest = 3.0 * float(np.median(usual)) if usual.size else math.inf
    gaps = np.flatnonzero(steps > longest) + 1
    return np.insert(time, gaps, np.nan), np.insert(values, gaps, np.nan)


def _cloud(axes: Axes, state: np.ndarray, values: np.ndarray, color: str) -> None:
    """Points, thinned evenly, and the median of equally filled bins of the state."""
    finite = np.isfinite(state) & np.isfinite(values)
    state, values = state[finite], values[finite]
    step = max(1, math.ceil(state.size / _MOST_POINTS))
    axes.plot(
        state[::step],
        values[::step],
        ".",
        color=color,
        markersize=2,
        alpha=0.35,
        markeredgewidth=0,
        rasterized=True,
    )
    axes.axhline(0.0, color=DARK_GREY, linewidth=0.6)
    parts = np.array_split(np.argsort(state, kind="stable"), _BINS)
    parts = [part for part in parts if part.size >= _FEWEST]
    middle = [float(np.median(state[part])) for part in parts]
    axes.plot(middle, [float(np.median(values[part])) for part in parts], color=BLACK)
    if state.size:
        low, high = np.quantile(state, [1.0 - _INNER, _INNER])
        room = 0.05 * (high - low) or 1.0
        axes.set_xlim(low - room, high + room)


def _titles(
    first: Axes,
    second: Axes,
    before: np.ndarray,
    after: np.ndarray,
    unit: str,
    limits: tuple[float, float],
) -> None:
    first.set_title(f"before: {number(rms([before]))} {unit} RMS", color=VERMILION, fontsize=9)
    text = f"after: {number(rms([after]))} {unit} RMS"
    finer = limits[0] / limits[1]
    if finer > 1.0:
        text += f", scale {number(finer, 2)} times finer"
    second.set_title(text, color=BLUE, fontsize=9)


def _alt(channel: str, before: np.ndarray, after: np.ndarray, unit: str) -> str:
    return (
        f"Errors of {channel}: {number(rms([before]))} {unit} RMS before, "
        f"{number(rms([after]))} {unit} after."
    )


def _finish(figure: Figure, title: str) -> None:
    width, height = figure.get_size_inches()
    figure.text(0.1 / width, 1 - 0.08 / height, title, va="top", fontsize=12, fontweight="bold")
    figure.tight_layout(rect=(0, 0, 1, 1 - 0.3 / height))
    figure.align_ylabels()
