"""Figures of one run: tracking, pressures and valve commands over time."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from leglab.base.errors import LeglabError
from leglab.base.recording import Recording
from leglab.base.scenario import Phase
from leglab.data import write_atomically
from leglab.report.panels import add_head, add_panels
from leglab.report.style import BLACK, BLUE, DARK_GREY, LIGHT_GREY, ORANGE, VERMILION, style
from leglab.runs.metrics import phase_table, sliding_rms
from leglab.runs.run import Run

_BAR = 1e5  # Pa
_MILLI = 1e3

# Strides shown before and after the change in its close-up.
_CLOSE_UP = 3.0


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
        recording: With `<joint>_position` [rad] and `<joint>_reference` [rad] of every joint.
        phases: Parts of the run; the change is marked where "before" ends.
        window: Length of the window of the moving RMS error [s]; None leaves it out.
        span: First and last time shown [s]; None shows all.
        title: What was run.

    Raises:
        LeglabError: A column is missing, no joint was recorded, or nothing lies in the span.
    """
    joints = _joints_of(recording)
    error = recording.stack(joints, "reference") - recording.stack(joints, "position")
    table = phase_table(recording.time, error, joints, phases) if phases else []
    shown = recording if span is None else recording.between(*span)
    part = np.isin(recording.time, shown.time)
    with style():
        figure, panels = add_panels(len(joints), heights=(1.35, 0.85))
        for i, (joint, (top, bottom)) in enumerate(zip(joints, panels, strict=True)):
            top.plot(shown.time, shown[f"{joint}_reference"], color=LIGHT_GREY, linewidth=2.6)
            top.plot(shown.time, shown[f"{joint}_position"], color=BLUE)
            top.set_ylabel("position [rad]")
            top.set_title(_readable(joint), fontweight="bold")
            if table:
                top.set_title(_rms_by_phase(table, joint), loc="right", color=DARK_GREY, fontsize=8)
            bottom.plot(shown.time, _MILLI * error[part, i], color=BLUE, linewidth=0.6)
            if window is not None:
                moving = sliding_rms(recording.time, error[:, [i]], window)
                bottom.plot(shown.time, _MILLI * moving[part], color=BLACK, linewidth=1.4)
            bottom.set_ylabel("error [mrad]")
            for axes in (top, bottom):
                _finish(axes, phases)
        lines = [_line("reference", LIGHT_GREY, 2.6), _line("measured, error", BLUE)]
        if window is not None:
            lines.append(_line(f"RMS error over {window:g} s", BLACK, 1.4))
        _head(figure, title, lines, phases)
    return figure


def pressure_figure(
    recording: Recording,
    *,
    phases: Sequence[Phase] = (),
    span: tuple[float, float] | None = None,
    title: str = "",
) -> Figure:
    """Draws both chamber pressures of every joint, and the supply where it was recorded.

    Args:
        recording: With `<joint>_pressure_a` and `<joint>_pressure_b` [Pa].
        phases: As in `tracking_figure`.
        span: As in `tracking_figure`.
        title: What was run.

    Raises:
        LeglabError: A column is missing, or nothing lies in the span.
    """
    joints = [joint for joint in recording.joints if f"{joint}_pressure_a" in recording]
    if not joints:
        raise LeglabError("no pressures to draw: no column ends in '_pressure_a'")
    shown = recording if span is None else recording.between(*span)
    supply = "supply_pressure" in recording
    names = [f"{joint}_pressure_{side}" for joint in joints for side in "ab"]
    names += ["supply_pressure"] * supply
    highest = max(float(np.nanmax(shown[name], initial=_BAR)) for name in names) / _BAR
    with style():
        figure, panels = add_panels(len(joints), heights=(1.25,))
        for joint, (axes,) in zip(joints, panels, strict=True):
            if supply:
                axes.plot(shown.time, shown["supply_pressure"] / _BAR, color=LIGHT_GREY)
            axes.plot(shown.time, shown[f"{joint}_pressure_a"] / _BAR, color=BLUE)
            axes.plot(shown.time, shown[f"{joint}_pressure_b"] / _BAR, color=ORANGE)
            axes.set_title(_readable(joint), fontweight="bold")
            axes.set_ylabel("pressure [bar]")
            axes.set_ylim(0, 1.05 * highest)
            _finish(axes, phases)
        lines = [_line("A, cap side", BLUE), _line("B, rod side", ORANGE)]
        if supply:
            lines.append(_line("supply", LIGHT_GREY))
        _head(figure, title, lines, phases)
    return figure


def command_figure(
    recording: Recording,
    *,
    phases: Sequence[Phase] = (),
    span: tuple[float, float] | None = None,
    title: str = "",
) -> Figure:
    """Draws the command of every valve; commands at the limit are drawn in another colour.

    Args:
        recording: With `<actuator>_command` [1].
        phases: As in `tracking_figure`.
        span: As in `tracking_figure`.
        title: What was run.

    Raises:
        LeglabError: No command was recorded, or nothing lies in the span.
    """
    actuators = recording.actuators
    if not actuators:
        raise LeglabError("no commands to draw: no column ends in '_command'")
    shown = recording if span is None else recording.between(*span)
    commands = shown.stack(actuators, "command")
    limit = min(1.08, 1.1 * float(np.nanmax(np.abs(commands), initial=0.01)))
    with style():
        figure, panels = add_panels(len(actuators), heights=(1.25,))
        for i, (actuator, (axes,)) in enumerate(zip(actuators, panels, strict=True)):
            command = np.clip(commands[:, i], -1, 1)
            saturated = np.abs(command) >= 1
            axes.plot(shown.time, command, color=BLUE, linewidth=0.8)
            if saturated.any():
                at_limit = np.where(saturated, command, np.nan)
                axes.plot(shown.time, at_limit, color=ORANGE, linewidth=3, solid_capstyle="butt")
                share = f"at the limit {100 * saturated.mean():.1f} % of the time"
                axes.set_title(share, loc="right", color=DARK_GREY, fontsize=8)
            axes.set_ylim(-limit, limit)
            axes.set_title(_readable(actuator), fontweight="bold")
            axes.set_ylabel("valve command")
            _finish(axes, phases)
        _head(figure, title, [_line("command", BLUE), _line("at its limit", ORANGE, 3)], phases)
    return figure


def draw_run(run: Run, folder: Path) -> tuple[Path, ...]:
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
    """Draws and writes all figures that the recording has columns for, as PNG.

    Args:
        recording: The run.
        folder: Existing folder to write to.
        phases: Parts of the run.
        window: One stride [s], for the moving RMS error and the close-up of the change.
        title: What was run.

    Returns:
        Paths of `tracking.png`, `tracking_change.png` (with a change), `pressures.png`,
        `commands.png`, as far as they were drawn.

    Raises:
        LeglabError: A joint has no reference column, or the folder cannot be written to.
    """
    figures = {
        "tracking": tracking_figure(recording, phases=phases, window=window, title=title),
    }
    change = _change(phases)
    if change is not None:
        margin = _CLOSE_UP * (window or 1.0)
        span = (change[0] - margin, change[1] + margin)
        figures["tracking_change"] = tracking_figure(
            recording, phases=phases, window=window, span=span, title=title
        )
    if any(f"{joint}_pressure_a" in recording for joint in recording.joints):
        figures["pressures"] = pressure_figure(recording, phases=phases, title=title)
    if recording.actuators:
        figures["commands"] = command_figure(recording, phases=phases, title=title)
    paths = []
    for name, figure in figures.items():
        path = Path(folder) / f"{name}.png"
        with style():
            write_atomically(path, partial(figure.savefig, format="png"))
        paths.append(path)
    return tuple(paths)


def _joints_of(recording: Recording) -> tuple[str, ...]:
    if not recording.joints:
        raise LeglabError("no tracking to draw: no column ends in '_position'")
    return recording.joints


def _finish(axes: Axes, phases: Sequence[Phase]) -> None:
    for axis, most in ((axes.xaxis, 10), (axes.yaxis, 5)):
        axis.set_major_locator(MaxNLocator(nbins=most, steps=[1, 2, 5, 10], min_n_ticks=3))
    change = _change(phases)
    if change is not None:
        axes.axvline(change[0], color=VERMILION, linewidth=1.0, zorder=1)
        if change[1] > change[0]:
            axes.axvspan(*change, color=VERMILION, alpha=0.12, linewidth=0, zorder=0)


def _change(phases: Sequence[Phase]) -> tuple[float, float] | None:
    """Returns when the machine begins and ends to change [s]; None where it does not."""
    after = [phase.start for phase in phases if phase.name == "after"]
    if not after:
        return None
    during = [phase.start for phase in phases if phase.name == "during"]
    return (during or after)[0], after[0]


def _rms_by_phase(table: list[dict], joint: str) -> str:
    parts = [f"{row['name']} {_MILLI * row['rms_rad'][joint]:.3g}" for row in table]
    return f"RMS [mrad]: {', '.join(parts)}"


def _head(figure: Figure, title: str, lines: list[Line2D], phases: Sequence[Phase]) -> None:
    """Puts the title and one legend for all panels above them."""
    if _change(phases) is not None:
        lines = [*lines, _line("change of the machine", VERMILION)]
    add_head(figure, title, lines)


def _line(label: str, color: str, width: float = 1.4) -> Line2D:
    return Line2D([], [], color=color, linewidth=width, label=label)


def _readable(name: str) -> str:
    return name.replace("_", " ")
