"""Figures of a run, tracking, pressures and valve commands, and of a comparison of runs.

Panels have fixed positions so that their axes line up; automatic layouts would shift each panel by
the width of its tick labels.
"""

import io
import itertools
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator
from tsdownsample import MinMaxDownsampler

from leglab.base.errors import RecordingError
from leglab.base.output import write_atomically
from leglab.base.recording import Recording
from leglab.base.scenario import Phase
from leglab.report.page.wording import readable
from leglab.report.style import BLACK, BLUE, DARK_GREY, LIGHT_GREY, ORANGE, SERIES, VERMILION, style
from leglab.runs.comparison import unit_of_results
from leglab.runs.metrics import phase_table, sliding_rms
from leglab.runs.run import Result

_BAR = 1e5  # Pa
_MILLI = 1e3
_PAGE_DPI = 130  # resolution of figures on a page [dots per inch]
_CLOSE_UP = 3.0  # number of strides before and after the change in the close-up
# Dimensions of panels [inch].
_LEFT = 0.75  # axis label and tick labels
_RIGHT = 0.12
_HEAD = 0.6  # title and legend of the figure
_TITLE = 0.4  # title of a panel, and the space to the panel above
_GAP = 0.12  # between the axes of one panel
_FOOT = 0.5  # time axis
_ONE_COLUMN = 7.2
_TWO_COLUMNS = 4.9
# Dash patterns of lines in a comparison; the next pattern is used when all colours are used up.
_DASHES: tuple[Literal["-", "--", ":"], ...] = ("-", "--", ":")
_LEGEND_COLUMNS = 4
_SUBDIVISIONS = (1.0, 2.0, 5.0)
# Number of pieces of a line, about ten per pixel of the widest panel. A line of more than twice as
# many samples is drawn through the minimum and the maximum of each piece only.
_PIECES = 10_000


def tracking_figure(
    recording: Recording,
    *,
    phases: Sequence[Phase] = (),
    window: float | None = None,
    span: tuple[float, float] | None = None,
    title: str = "",
) -> Figure:
    """Draws reference and measured position of every joint, and the tracking error below.

    Args:
        recording: Recording with columns `<joint>_position` and `<joint>_reference` [rad] of every
            joint that is to be shown.
        phases: Phases of the run; the change of the machine is marked at the end of "before".
        window: Length of the window of the moving RMS error [s]; None leaves it out.
        span: First and last time shown [s]; None shows all.
        title: Name of the run or scenario, shown as title.

    Raises:
        LeglabError: No joint has both columns, or nothing lies in the span.
    """
    joints = recording.tracked
    if not joints:
        raise RecordingError("no tracking to draw: no joint has '_position' and '_reference'")
    # Columns of long runs are large and may be read from a file, so few are kept in memory.
    error = recording.stack(joints, "reference")
    error -= recording.stack(joints, "position")
    table = phase_table(recording.time, error, joints, phases) if phases else []
    part = _rows_in(recording, span)
    time = recording.time[part]
    with style():
        figure, panels = add_panels(len(joints), heights=(1.35, 0.85))
        for i, (joint, (top, bottom)) in enumerate(zip(joints, panels, strict=True)):
            _draw(top, time, recording[f"{joint}_reference"][part], color=LIGHT_GREY, linewidth=2.6)
            _draw(top, time, recording[f"{joint}_position"][part], color=BLUE)
            unit = recording.error_unit((joint,))
            top.set_ylabel(f"position [{unit.removeprefix('m')}]")
            top.set_title(readable(joint), fontweight="bold")
            told = ", ".join(
                f"{row['start']:.4g} to {row['end']:.4g} s {_MILLI * row['rms_rad'][joint]:.3g}"
                for row in table
            )
            if told:
                top.set_title(f"RMS [{unit}]: {told}", loc="right", color=DARK_GREY, fontsize=8)
            _draw(bottom, time, error[part, i], scale=_MILLI, color=BLUE, linewidth=0.6)
            if window is not None:
                moving = sliding_rms(recording.time, error[:, [i]], window)
                _draw(bottom, time, moving[part], scale=_MILLI, color=BLACK, linewidth=1.4)
            bottom.set_ylabel(f"error [{unit}]")
            for axes in (top, bottom):
                _finish(axes, phases)
        lines = [_line("reference", LIGHT_GREY, 2.6), _line("measured, error", BLUE)]
        if window is not None:
            lines.append(_line(f"RMS error over {window:g} s", BLACK, 1.4))
        add_head(figure, title, lines, phases=phases)
    return figure


def _rows_in(recording: Recording, span: tuple[float, float] | None) -> slice:
    """Returns the rows in a time span [s], which must not be empty; all rows if it is None."""
    if span is None:
        return slice(None)
    first, last = np.searchsorted(recording.time, span)
    if first >= last:
        recording.between(*span)  # raises; the message has the recorded times
    return slice(int(first), int(last))


def pressure_figure(
    recording: Recording, *, phases: Sequence[Phase] = (), title: str = ""
) -> Figure:
    """Draws both chamber pressures of every joint, and the supply pressure if it was recorded.

    Args:
        recording: Recording with columns `<joint>_pressure_a` and `<joint>_pressure_b` [Pa].
        phases: See `tracking_figure`.
        title: Name of the run or scenario, shown as title.

    Raises:
        LeglabError: A column is missing, or no pressure was recorded.
    """
    joints = _joints_with_pressures(recording)
    if not joints:
        raise RecordingError("no pressures to draw: no column ends in '_pressure_a'")
    looks = [("{}_pressure_a", BLUE, "A, cap side"), ("{}_pressure_b", ORANGE, "B, rod side")]
    supply = [("supply_pressure", LIGHT_GREY, "supply")] * ("supply_pressure" in recording)
    names = [name.format(joint) for joint in joints for name, *_ in looks + supply]
    highest = max(float(np.nanmax(recording[name], initial=_BAR)) for name in names) / _BAR
    with style():
        figure, panels = add_panels(len(joints), heights=(1.25,))
        for joint, (axes,) in zip(joints, panels, strict=True):
            for name, color, _ in supply + looks:
                values = recording[name.format(joint)]
                _draw(axes, recording.time, values, scale=1 / _BAR, color=color)
            axes.set_title(readable(joint), fontweight="bold")
            axes.set_ylabel("pressure [bar]")
            axes.set_ylim(0, 1.05 * highest)
            _finish(axes, phases)
        lines = [_line(label, color) for _, color, label in looks + supply]
        add_head(figure, title, lines, phases=phases)
    return figure


def command_figure(
    recording: Recording, *, phases: Sequence[Phase] = (), title: str = ""
) -> Figure:
    """Draws the command of every joint; commands at the limit are drawn in another colour.

    Args:
        recording: Columns `<actuator>_command`; a native actuator's are shares of its range.
        phases: See `tracking_figure`.
        title: Name of the run or scenario, shown as title.

    Raises:
        LeglabError: No command was recorded.
    """
    largest = {
        joint: float(np.nanmax(np.abs(values), initial=0.01))
        for joint in recording.joints
        if (values := recording.command_of(joint)) is not None
    }
    if not largest:
        raise RecordingError("no commands to draw: no column ends in '_command'")
    actuators = [str(recording.actuator_of(joint)) for joint in largest]
    limit = min(1.08, 1.1 * max(largest.values()))
    with style():
        figure, panels = add_panels(len(actuators), heights=(1.25,))
        for joint, actuator, (axes,) in zip(largest, actuators, panels, strict=True):
            values = recording.command_of(joint)
            assert values is not None
            command = np.clip(values, -1, 1)
            saturated = np.abs(command) >= 1
            _draw(axes, recording.time, command, color=BLUE, linewidth=0.8)
            if saturated.any():
                ends = _ends(saturated)
                at_limit = np.where(saturated[ends], command[ends], np.nan)
                axes.plot(
                    recording.time[ends], at_limit, color=ORANGE, linewidth=3, solid_capstyle="butt"
                )
                share = f"at the limit {100 * saturated.mean():.1f} % of the time"
                axes.set_title(share, loc="right", color=DARK_GREY, fontsize=8)
            axes.set_ylim(-limit, limit)
            axes.set_title(readable(actuator), fontweight="bold")
            axes.set_ylabel("command [share of the limit]")
            _finish(axes, phases)
        lines = [_line("command", BLUE)]
        if max(largest.values()) >= 1:
            lines.append(_line("at its limit", ORANGE, 3))
        add_head(figure, title, lines, phases=phases)
    return figure


def draw_run(run: Result, folder: Path) -> tuple[Path, ...]:
    """Draws a run into a folder; see `save_run_figures`."""
    settings = run.settings
    return save_run_figures(
        run.recording,
        folder,
        phases=run.scenario.phases,
        window=run.window,
        title=f"{settings.scenario}, {settings.controller}, {Path(settings.model).stem}, "
        f"seed {settings.seed}",
    )


def save_run_figures(
    recording: Recording,
    folder: str | Path,
    *,
    phases: Sequence[Phase] = (),
    window: float | None = None,
    title: str = "",
) -> tuple[Path, ...]:
    """Writes all figures for which the recording has columns, as PNG.

    Args:
        recording: Recording of the run.
        folder: Existing folder to write to.
        phases: Phases of the run.
        window: Duration of a stride [s], for the moving RMS error and the close-up of the change.
        title: Name of the run, shown as title.

    Returns:
        Paths of the written files: `tracking.png`; if the machine changes, `tracking_change.png`;
        if recorded, `pressures.png` and `commands.png`.

    Raises:
        LeglabError: No joint has position and reference, or the folder cannot be written to.
    """
    tracking = partial(tracking_figure, recording, phases=phases, window=window, title=title)
    figures = {"tracking": tracking()}
    change = _change(phases)
    if change is not None:
        margin = _CLOSE_UP * (window or 1.0)
        figures["tracking_change"] = tracking(span=(change[0] - margin, change[1] + margin))
    if _joints_with_pressures(recording):
        figures["pressures"] = pressure_figure(recording, phases=phases, title=title)
    if recording.actuators:
        figures["commands"] = command_figure(recording, phases=phases, title=title)
    return tuple(_save(f, Path(folder) / f"{name}.png") for name, f in figures.items())


def _joints_with_pressures(recording: Recording) -> list[str]:
    return [joint for joint in recording.joints if f"{joint}_pressure_a" in recording]


def _finish(axes: Axes, phases: Sequence[Phase]) -> None:
    for axis, most in ((axes.xaxis, 10), (axes.yaxis, 5)):
        axis.set_major_locator(MaxNLocator(nbins=most, steps=[1, 2, 5, 10], min_n_ticks=3))
    change = _change(phases)
    if change is not None:
        axes.axvline(change[0], color=VERMILION, linewidth=1.0, zorder=1)
        if change[1] > change[0]:
            axes.axvspan(*change, color=VERMILION, alpha=0.12, linewidth=0, zorder=0)


def _change(phases: Sequence[Phase]) -> tuple[float, float] | None:
    """Returns start and end of the change of the machine [s]; None if it does not change."""
    after = [phase.start for phase in phases if phase.name == "after"]
    if not after:
        return None
    during = [phase.start for phase in phases if phase.name == "during"]
    return (during or after)[0], after[0]


def _line(label: str, color: str, width: float = 1.4) -> Line2D:
    return Line2D([], [], color=color, linewidth=width, label=label)


def comparison_figure(results: Sequence[dict[str, Any]], *, title: str = "") -> Figure:
    """Draws each controller's windowed RMS error: mean over seeds, and range from best to worst.

    Args:
        results: Runs of one scenario, each with `metrics` (of which `controller` is read),
            `changes`, `window` and `time` [s], `windowed_error_rad`. The order is kept.
        title: Name of the run or scenario, shown as title.

    Raises:
        LeglabError: There is no run, or no run lasts as long as a window.
    """
    controllers = list(dict.fromkeys(result["metrics"]["controller"] for result in results))
    if not any(value for result in results for value in result["windowed_error_rad"]):
        raise RecordingError("no windowed error to draw: no run lasts a window")
    looks = itertools.cycle(itertools.product(_DASHES, SERIES))
    lines = []
    with style():
        figure, ((axes,),) = add_panels(1, heights=(3.0,))
        for controller, (dashes, color) in zip(controllers, looks, strict=False):
            own = [r for r in results if r["metrics"]["controller"] == controller]
            count = min(len(result["time"]) for result in own)  # end of the shortest run
            time = np.array(own[0]["time"][:count])
            kept = [result["windowed_error_rad"][:count] for result in own]
            errors = _MILLI * np.array(kept, dtype=np.float64)
            axes.plot(time, errors.mean(axis=0), color=color, linestyle=dashes, linewidth=1.4)
            if len(errors) > 1:
                low, high = errors.min(axis=0), errors.max(axis=0)
                axes.fill_between(time, low, high, color=color, alpha=0.2, linewidth=0)
            lines.append(Line2D([], [], color=color, linestyle=dashes, label=controller))
        if changes := results[0]["changes"]:
            for change in changes:
                axes.axvline(change, color=VERMILION, linewidth=1.0, zorder=1)
            axes.axvspan(changes[0], changes[-1], color=VERMILION, alpha=0.12, linewidth=0)
            lines.append(_line("change of the machine", VERMILION, 1.0))
        axes.set_xlim(0, max(result["time"][-1] for result in results))
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=_SUBDIVISIONS))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_formatter("")
        axes.xaxis.set_major_locator(MaxNLocator(nbins=10, steps=[1, 2, 5, 10]))
        axes.set_ylabel(f"RMS error over {results[0]['window']:g} s [{unit_of_results(results)}]")
        add_head(figure, title, lines, columns=_LEGEND_COLUMNS)
    return figure


def save_comparison_figure(results: Sequence[dict[str, Any]], path: Path, *, title: str) -> None:
    """Writes `comparison_figure` as PNG.

    Raises:
        LeglabError: As `comparison_figure`, or the file cannot be written.
    """
    _save(comparison_figure(results, title=title), path)


def outline(values: np.ndarray, pieces: int = _PIECES) -> np.ndarray:
    """Selects samples such that a line through them looks like the line through all samples.

    Matplotlib's memory grows with the vertices; for a long run it would exceed the run's memory.

    Args:
        values: Samples, shape (n,); NaN where missing.
        pieces: Number of pieces into which the samples are cut.

    Returns:
        Increasing indices: all n if n is at most twice the number of pieces; otherwise the first
        and the last index, and the indices of the minimum and maximum of each piece.
    """
    if len(values) <= 2 * pieces:
        return np.arange(len(values))
    rows = MinMaxDownsampler().downsample(np.ascontiguousarray(values), n_out=2 * pieces)
    return np.union1d(rows.astype(np.int64), [0, len(values) - 1])


def _ends(marked: np.ndarray) -> np.ndarray:
    """Returns the first and last index of each sequence of equal values in `marked`, (n,)."""
    differs = np.concatenate([[True], marked[1:] != marked[:-1], [True]])
    return np.flatnonzero(differs[1:] | differs[:-1])


def _draw(
    axes: Axes, time: np.ndarray, values: np.ndarray, *, scale: float = 1.0, **look: Any
) -> None:
    rows = outline(values)
    axes.plot(time[rows], scale * values[rows], **look)


def png(figure: Figure) -> bytes:
    """Renders a figure as PNG at the resolution of the pages."""
    stream = io.BytesIO()
    with style():
        figure.savefig(stream, format="png", dpi=_PAGE_DPI)
    return stream.getvalue()


def _save(figure: Figure, path: Path) -> Path:
    with style():
        write_atomically(path, partial(figure.savefig, format="png"))
    return path


def add_panels(count: int, heights: Sequence[float]) -> tuple[Figure, list[tuple[Axes, ...]]]:
    """Makes a figure with equal panels: one or two in one column, more in two columns.

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
            # All axis labels have the same distance from the axes, whatever the tick labels' width.
            axes.yaxis.set_label_coords(-0.53 / width, 0.5)
            stack.append(axes)
            top -= height + _GAP
        if row == rows - 1 or index == count - 1:
            stack[-1].tick_params(labelbottom=True)
            stack[-1].set_xlabel("time [s]")
        panels.append(tuple(stack))
    return figure, panels


def add_head(
    figure: Figure,
    title: str,
    lines: Sequence[Line2D],
    *,
    phases: Sequence[Phase] = (),
    columns: int | None = None,
    **legend: float,
) -> None:
    """Puts the title and one legend for all panels above them.

    Args:
        figure: The figure.
        title: Name of the run, or another title.
        lines: A labelled sample of each kind of line; empty for no legend.
        phases: Phases of a run; if the machine changes, the legend has an entry for the change.
        columns: Number of entries per row of the legend; None puts all entries into one row.
        legend: Further spacings of the legend, as arguments of Matplotlib's `legend`.
    """
    if _change(phases) is not None:
        lines = [*lines, _line("change of the machine", VERMILION)]
    width, height = figure.get_size_inches()
    left = 0.1 / width
    figure.text(left, 1 - 0.08 / height, title, va="top", fontsize=12, fontweight="bold")
    if lines:
        figure.legend(
            handles=list(lines),
            loc="upper left",
            bbox_to_anchor=(left, 1 - 0.36 / height),
            ncols=min(columns or len(lines), len(lines)),
            borderpad=0,
            borderaxespad=0,
            **legend,
        )
