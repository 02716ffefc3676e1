"""Consoles, exit statuses, progress bars and tables of the commands."""

import json
import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
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

# What a terminal would obey: C0 but tab and newline, DEL, C1, and what turns the reading direction.
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
    """A console that writes out what a terminal would obey; all output of commands passes it."""

    def render(self, *args: Any, **options: Any) -> Iterable[Segment]:
        for segment in super().render(*args, **options):
            if segment.control:
                yield segment
            else:
                yield Segment(segment.text.translate(_COMMANDS), segment.style)

    def render_str(self, text: str, **options: Any) -> Text:
        try:
            return super().render_str(text, **options)
        except MarkupError:  # A name that looks like markup.
            return super().render_str(text, **{**options, "markup": False})


errors = _Harmless(stderr=True, highlight=False, soft_wrap=True)
output = _Harmless(highlight=False)


def tell(text: str) -> None:
    """Prints a line on standard output as it is, however long."""
    output.print(text, markup=False, highlight=False, soft_wrap=True)


def complain(text: str, kind: str = "error") -> None:
    """Prints one line on standard error.

    Args:
        text: What is wrong; may hold anything.
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

    def warn(line: str) -> None:
        complain(line, "warning")

    return read_recordings(paths, columns, span=span, salvage=salvage, tell=warn)


_WIDE = 120  # characters
_SILENCE = 30.0  # s after which a file or pipe gets a line about how far a command is
_NAME = 30  # characters of a name that a table keeps on one line
_Made = TypeVar("_Made")


def print_table(table: Table, usual: int = 0) -> None:
    """Prints a table in full, as `leglab.base.tables.print_whole`."""
    print_whole(output, table, usual=usual)


def print_wide(table: Table) -> None:
    """Prints a table that is better read in long lines, in full."""
    print_table(table, _WIDE)


def print_answer(names: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Prints rows as a table, or one field a line where they are wider than the terminal."""
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


def print_json(content: Any, *, ascii_only: bool = True) -> None:
    """Prints content as JSON on standard output."""
    plain = ascii_only or "utf" not in (sys.stdout.encoding or "").lower()
    text = json.dumps(content, indent=2, ensure_ascii=plain)
    # What is left of it stands within strings, where JSON has \\u for it.
    typer.echo(text.translate({code: f"\\u{code:04x}" for code in _COMMANDS}))


@contextmanager
def progress(
    label: str, total: float | None = None, unit: str = ""
) -> Iterator[Callable[..., None]]:
    """Shows on stderr how far a command is.

    A terminal has a bar that leaves nothing behind, a file or pipe a line every half a minute.

    Args:
        label: What is done.
        total: Amount that is all; None where it is not known.
        unit: What is counted, such as "runs"; without one, the amount is no number of things.

    Yields:
        Tells how far it is; takes `completed`, `total` and `description` by name.
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


@dataclass
class _State:
    """How far a command is, and since when [s]."""

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
            if self.begun is None:  # What was there before took no time now.
                self.begun = time.monotonic(), completed

    def told(self) -> str:
        """Such as "seal_wear, pd: 13 of 28 runs, 2 min left"."""
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
    """Makes many runs and shows how many there are.

    Args:
        label: What is done.
        total: Number of runs.
        make: Makes them; `progress` is called with the number of runs that are done, that of all,
            and the name of the last one.
        unit: What they are.
        resumes: Whether the same command goes on where this one was interrupted.

    Raises:
        typer.Exit: The user interrupts; the number of finished runs is told.
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
    """A table of text as it is; columns that hold nothing but numbers are aligned on the right.

    Where there is too little room, heads are broken and what lines say is folded: a name that is
    cut short could be another's.
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
    """Tracking error of one run by joint and phase."""
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


_LATE = 0.01  # of the commands, from which on it is told: an operating system delays a few


def _short(value: float) -> str:
    """A number with one decimal, or two digits where that would leave fewer."""
    return f"{value:.1f}" if abs(value) >= 1 or value == 0 else f"{value:.2g}"


def slow_lines(metrics: "RunMetrics", period: float) -> list[str]:
    """A line where the controller took longer than its period, else none.

    Args:
        metrics: Of the run.
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
    """Error and re-adaptation by scenario and controller, from the content of `compare.json`."""
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
    """A line on which joints follow which columns of a file, else none.

    Args:
        settings: Of the run, from the content of `run.json`.
        joints: Of the machine.
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
    """A line where the loop's timing was rounded up to whole steps of the model, else none.

    Args:
        asked: Settings of the sensors as they were asked for.
        settings: Of the run, from the content of `run.json`.
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
