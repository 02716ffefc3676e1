"""Consoles, exit statuses, progress bars and tables of the commands."""

import json
import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.errors import MarkupError
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from leglab.base.tables import print_whole

if TYPE_CHECKING:
    from leglab.base.recording import Recording
    from leglab.runs.record import RunMetrics

DONE, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130

# Escapes of terminal control characters: C0 except tab and newline, DEL, C1, and text direction.
_COMMANDS = {
    code: f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"
    for code in (
        *(c for c in range(0x20) if chr(c) not in "\t\n"),
        *range(0x7F, 0xA0),
        *range(0x202A, 0x202F),
        *range(0x2066, 0x206A),
    )
}


class _Harmless(Console):
    """Console that prints terminal control characters as escapes; all commands print through it."""

    def render(self, *args: Any, **options: Any) -> Iterable[Segment]:
        for segment in super().render(*args, **options):
            if segment.control:
                yield segment
            else:
                yield Segment(segment.text.translate(_COMMANDS), segment.style)

    def render_str(self, text: str, **options: Any) -> Text:
        try:
            return super().render_str(text, **options)
        except MarkupError:  # Brackets in a name are no valid markup.
            return super().render_str(text, **{**options, "markup": False})


errors = _Harmless(stderr=True, highlight=False, soft_wrap=True)
output = _Harmless(highlight=False)


def tell(text: str) -> None:
    """Prints a line on standard output without markup and without wrapping it."""
    output.print(text, markup=False, highlight=False, soft_wrap=True)


def complain(text: str, kind: str = "error") -> None:
    """Prints one line on standard error.

    Args:
        text: The message, which may contain any characters.
        kind: "error" or "warning".
    """
    color = {"error": "red", "warning": "yellow"}[kind]
    line = " ".join(text.split("\n"))
    errors.print(Text.assemble((f"{kind}:", color), " ", line))


def tell_of_models(folders: Iterable[Path]) -> None:
    """Warns of each run whose model file has changed since the run."""
    from leglab.runs.folder import model_note
    from leglab.runs.record import CONFIGURATION

    files = [folder / CONFIGURATION for folder in folders]
    notes = [model_note(file) for file in files if file.is_file()]
    for note in dict.fromkeys(filter(None, notes)):
        complain(note, "warning")


def read_and_warn(
    paths: Sequence[Path],
    *,
    columns: Path | None,
    span: tuple[float | None, float | None],
    salvage: bool,
) -> "dict[str, Recording]":
    """Reads recordings by name; prints a warning for each file that `read_recordings` skips."""
    from leglab.diagnosis.intake.recordings import read_recordings

    warn = partial(complain, kind="warning")
    return read_recordings(paths, columns, span=span, salvage=salvage, tell=warn)


_WIDE = 120  # width that wide tables may have on any terminal [characters]
_SILENCE = 30.0  # interval between progress lines in a file or pipe [s]
_NAME = 30  # maximum length of a name that a table keeps on one line [characters]
_Made = TypeVar("_Made")


def print_table(table: Table, usual: int = 0) -> None:
    """Prints a table in full by `leglab.base.tables.print_whole`."""
    print_whole(output, table, usual=usual)


def print_wide(table: Table) -> None:
    """Prints a table in full, with lines of up to 120 characters even on a narrower terminal."""
    print_table(table, _WIDE)


def print_answer(names: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Prints rows as a table, or with one field per line if the table would be too wide."""
    table = plain_table(names, rows)
    console = _Harmless(highlight=False, width=max(output.width, _WIDE))
    unbound = console.options.update_width(1_000_000)
    if Measurement.get(console, unbound, table).maximum <= console.width:
        console.print(table)
        return
    space = max(map(len, names))
    for number, row in enumerate(rows, 1):
        tell(f"row {number} of {len(rows)}")
        for name, value in zip(names, row, strict=True):
            tell(f"  {name:{space}}  {value}".rstrip())


def tell_or_print(text: str, content: Any, *, as_json: bool) -> None:
    """Prints content as JSON if this is wanted, and a line of text otherwise."""
    if as_json:
        print_json(content)
    else:
        tell(text)


def print_json(content: Any, *, ascii_only: bool = True) -> None:
    """Prints content as JSON on standard output."""
    plain = ascii_only or "utf" not in (sys.stdout.encoding or "").lower()
    text = json.dumps(content, indent=2, ensure_ascii=plain)
    # Control characters that remain are inside strings, where JSON allows \\u escapes.
    typer.echo(text.translate({code: f"\\u{code:04x}" for code in _COMMANDS}))


@contextmanager
def progress(
    label: str, total: float | None = None, unit: str = ""
) -> Iterator[Callable[..., None]]:
    """Shows the progress of a command on standard error.

    A terminal shows a bar, which is removed at the end; a file or pipe gets a line every 30 s.

    Args:
        label: Name of the activity.
        total: Amount at the end; None if it is not known.
        unit: Name of the counted things, such as "runs"; if empty, progress is shown in per cent.

    Yields:
        A function that updates the progress by keywords: `completed`, `total`, `description`.
    """
    state = _State(label=label, total=total, unit=unit)
    if not errors.is_terminal:
        spoken = time.monotonic()

        def line(**changes: Any) -> None:
            nonlocal spoken
            state.change(**changes)
            if time.monotonic() - spoken >= _SILENCE:
                spoken = time.monotonic()
                errors.print(state.told(), markup=False)

        yield line
        return
    from rich import progress as rich  # help and completion do without it

    columns = (rich.TextColumn("{task.description}", markup=False), rich.BarColumn())
    with rich.Progress(*columns, console=errors, transient=True) as bar:
        task = bar.add_task(state.told(), total=total)

        def update(**changes: Any) -> None:
            state.change(**changes)
            bar.update(task, description=state.told(), completed=state.completed, total=state.total)

        yield update


@contextmanager
def told_stages(label: str) -> Iterator[Callable[[str], None]]:
    """Shows the `progress` of an activity; yields a function that shows the name of its stage."""
    with progress(label) as show:
        yield lambda stage: show(description=stage)


@contextmanager
def told_shares(label: str) -> Iterator[Callable[[float], None]]:
    """Shows the `progress` of an activity; yields a function that shows which share is done."""
    with progress(label, 1.0) as show:
        yield lambda share: show(completed=share)


@dataclass
class _State:
    """Progress of a command; `begun` is the time [s] and the amount at its first update."""

    label: str
    total: float | None
    unit: str
    completed: float = 0.0
    begun: tuple[float, float] | None = None

    def change(
        self,
        *,
        completed: float | None = None,
        total: float | None = None,
        description: str | None = None,
    ) -> None:
        self.label = self.label if description is None else description
        self.total = self.total if total is None else total
        if completed is not None:
            self.completed = completed
            if self.begun is None:  # Earlier results took no time in this call.
                self.begun = time.monotonic(), completed

    def told(self) -> str:
        """Formats the progress, for example "seal_wear, pd: 13 of 28 runs, 2 min left"."""
        parts = []
        if self.total and self.unit:
            parts.append(f"{self.completed:g} of {self.total:g} {self.unit}")
        elif self.total and self.completed:
            parts.append(f"{self.completed / self.total:.0%}")
        if left := self._left():
            parts.append(left)
        return f"{self.label}: {', '.join(parts)}" if parts else self.label

    def _left(self) -> str:
        if self.begun is None or self.total is None or self.completed <= self.begun[1]:
            return ""
        took, made = time.monotonic() - self.begun[0], self.completed - self.begun[1]
        seconds = took / made * (self.total - self.completed)
        if seconds < 1 or took < 1:
            return ""
        for limit, unit, name in ((90, 1, "s"), (5400, 60, "min"), (math.inf, 3600, "h")):
            if seconds < limit:
                return f"{math.ceil(seconds / unit)} {name} left"
        return ""


def make_many(
    label: str, total: int, make: Callable[..., _Made], unit: str = "runs", *, resumes: bool = True
) -> _Made:
    """Makes many runs and shows how many are done.

    Args:
        label: Name of the activity.
        total: Number of runs.
        make: Function that makes the runs. It calls its argument `progress` with the number of
            finished runs, the number of all runs, and the name of the last run.
        unit: Word for the runs in messages.
        resumes: Whether the same command continues an interrupted one; the message says so.

    Raises:
        typer.Exit: The user interrupts; the number of finished runs is printed.
    """
    finished, whole = 0, total
    try:
        with progress(label, total, unit) as show:

            def tell(done: int, total: int, name: str) -> None:
                nonlocal finished, whole
                finished, whole = done, total
                show(completed=done, total=total, description=name or label)

            return make(progress=tell)
    except KeyboardInterrupt:
        on = ": the same command goes on from there" if resumes else ""
        errors.print(f"[red]interrupted[/red] after {finished} of {whole} {unit}{on}")
        raise typer.Exit(INTERRUPTED) from None


def plain_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Table:
    """Builds a table of text without markup; columns that contain only numbers are aligned right.

    If the terminal is too narrow, text is folded and not cut, because a shortened name could be
    mistaken for another name.
    """
    rows = list(rows)
    short = all(len(row[0]) <= _NAME for row in rows)
    table = Table(box=SIMPLE_HEAD)
    for i, name in enumerate(head):
        numbers = all(_is_number(row[i]) for row in rows)
        table.add_column(
            Text(name),
            justify="right" if numbers else "left",
            overflow="fold",
            no_wrap=i == 0 and short,
        )
    for row in rows:
        table.add_row(*map(Text, row))
    return table


def _is_number(text: str) -> bool:
    try:
        return not text or isinstance(float(text), float)
    except ValueError:
        return False


def metrics_table(metrics: "RunMetrics") -> Table:
    """Builds a table of the tracking error of one run by joint and phase."""
    from leglab.report.page.outcome import milli, outcome, sentence
    from leglab.runs.clock import NOTHING_CHANGES

    unit = metrics.error_unit()
    joints = [name for name in metrics.phases[0].rms_rad if name != "all"]
    table = Table(title=f"tracking error, RMS / peak, {unit}", title_justify="left", min_width=46)
    table.add_column(f"{metrics.scenario}, {metrics.controller}")
    for phase in metrics.phases:
        table.add_column(f"{phase.name} {phase.start:g}-{phase.end:g} s", justify="right")
    for name in joints if len(joints) == 1 else [*joints, "all"]:
        errors = ((1e3 * p.rms_rad[name], 1e3 * p.peak_rad[name]) for p in metrics.phases)
        own = unit if name == "all" else metrics.error_unit(name)
        label = Text(name if own == unit else f"{name} [{own}]")
        table.add_row(label, *(f"{_short(rms)} / {_short(peak)}" for rms, peak in errors))
    found = metrics.adaptation
    if found.before_rad and found.end_rad:
        table.caption = (
            f"RMS of all joints: {milli(found.before_rad['all'], unit)} in the {found.span_s:g} s "
            f"before the change, {milli(found.end_rad['all'], unit)} in the last "
            f"{found.span_s:g} s\n"
            f"{outcome(found, unit)}"
        )
        table.caption_justify = "left"
    elif found.reason != NOTHING_CHANGES:
        table.caption, table.caption_justify = sentence(found, unit), "left"
    return table


_LATE = 0.01  # minimum share of late commands for a warning; an operating system delays a few


def _short(value: float) -> str:
    """Formats a number with one decimal, or with two significant digits if it is less than 1."""
    return f"{value:.1f}" if abs(value) >= 1 or value == 0 else f"{value:.2g}"


def slow_lines(metrics: "RunMetrics", period: float) -> list[str]:
    """Returns one line if many commands took longer than the control period, else no line.

    Args:
        metrics: Metrics of the run.
        period: Control period [s].
    """
    times = metrics.command_time_s
    if times is None or times.late < _LATE:
        return []
    return [
        f"{times.late:.0%} of the commands of {metrics.controller!r} take longer than the control "
        f"period of {1e3 * period:g} ms: {1e3 * times.median:.2g} ms in the median, "
        f"{1e3 * times.worst:.2g} ms at worst"
    ]


def comparison_table(summary: dict[str, Any]) -> Table:
    """Builds a table of error and re-adaptation by scenario and controller from `compare.json`."""
    from leglab.report.comparison import words

    table = Table(
        title=words.title(summary),
        caption=words.explained(summary),
        title_justify="left",
        caption_justify="left",
        box=SIMPLE_HEAD,
    )
    table.add_column("", no_wrap=True, min_width=max(map(len, summary["controllers"])) + 2)
    for name in words.HEAD:
        table.add_column(name, justify="right", no_wrap=True)
    before = None
    for scenario, controller, cells in words.rows(summary):
        if scenario != before:
            table.add_section()
            table.add_row(Text(scenario, "bold"))
            before = scenario
        table.add_row(Text(f"  {controller}"), *cells)
    return table


def reference_lines(settings: Mapping[str, Any], joints: Sequence[str]) -> list[str]:
    """Returns a line on which joints follow which columns of a reference file, if there is a file.

    Args:
        settings: Settings of the run, from the content of `run.json`.
        joints: Names of the machine's joints.
    """
    from leglab.references.from_file import NAME, played

    if settings["reference"] != NAME:
        return []
    file = settings["reference_config"]["file"]
    found = played(file, joints)[1]
    moved = ", ".join(f"{joint} follows {column.stem!r}" for joint, column in found.items())
    still = ", ".join(joint for joint in joints if joint not in found)
    return [f"{Path(file).name}: {moved}" + (f"; at rest: {still}" if still else "")]


def timing_lines(asked: Mapping[str, Any], settings: Mapping[str, Any]) -> list[str]:
    """Returns a line if the loop's timing was rounded up to whole time steps, else no line.

    Args:
        asked: Sensor settings that the user gave.
        settings: Settings of the run, from the content of `run.json`.
    """
    from leglab.machine.sensors import SensorConfiguration

    usual, used = SensorConfiguration(), settings["sensors"]
    names = [
        name
        for name in ("control_period", "latency")
        if name not in asked and used[name] != getattr(usual, name)
    ]
    if not names:
        return []
    told = " and ".join(f"{name} is {used[name]:g} s" for name in names)
    return [
        f"{told}: rounded up to whole steps of the model's timestep {settings['timestep']:g} s "
        "(--timestep, --set sensors.NAME=VALUE)"
    ]
