"""`leglab convert` and `leglab inspect`: recordings of one format in another, and at a glance."""

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from leglab.base.errors import FileError, RecordingError, SettingsError
from leglab.cli import options, terminal

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    import numpy as np

    from leglab.base.recording import Recording
    from leglab.data import ColumnMap, Summary
    from leglab.diagnosis.intake.proposal import Proposal
    from leglab.diagnosis.plant.model import Machine

_ANY = ".parquet, .csv, .mcap, .mat, .npz, a ROS 2 bag, a dataset of LeRobot, or a run's folder."
_In = Annotated[Path, typer.Argument(metavar="IN", help=_ANY)]
_Target = Annotated[
    Path, typer.Argument(metavar="OUT", help=".parquet, .csv, .mcap, .mat or .npz.")
]
_To = Annotated[
    str | None,
    typer.Option(
        "--to",
        metavar="FORMAT_OR_S",
        help="Format, by default that of the suffix of OUT; or a time in seconds, "
        "from which on samples are ignored.",
    ),
]
_Shown = Annotated[
    str | None,
    typer.Option(
        metavar="MODEL", help="Machine that OUT shows, an .mcap; of a run's folder it is known."
    ),
]
_Model = Annotated[
    str | None, typer.Option(metavar="MODEL", help="Machine for which a column map is proposed.")
]
_Map = Annotated[
    Path | None,
    typer.Option(metavar="MAP.toml", help="File for the proposed map, as --columns takes it."),
]
_Plot = Annotated[
    Path | None,
    typer.Option(metavar="[FILE.png]", help="Draws the columns; default: named as the file."),
]


def convert(
    source: _In,
    target: _Target,
    to: _To = None,
    since: options.From = None,
    columns: options.Columns = None,
    recording: options.Which = None,
    salvage: options.Salvage = False,
    model: _Shown = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace OUT.")] = False,
    as_json: options.Json = False,
) -> None:
    """Converts a recording to another format and says what is lost.

    Samples keep every bit; docs/reference/data_formats.md says what else survives in which format.
    A run's folder as .mcap shows the machine too, in Foxglove, PlotJuggler and rerun: links, poses,
    meshes.
    """
    from leglab import data
    from leglab.machine.scene import scene_of
    from leglab.machine.simulation import load_model
    from leglab.runs.folder import RECORDING

    # Checks that take no time come first.
    until, to = _as_second(to)
    form = to or data.format_of(target)
    _check_new([target], overwrite=overwrite)
    timestep = None
    if (source / RECORDING).is_file():
        model, timestep = _machine_of_run(source, model, form)
        source = source / RECORDING
    if model is not None and form != "mcap":
        text = f"{form} cannot show a machine; --model goes with mcap"
        raise SettingsError(text, given=form, allowed="mcap")
    measured = data.read(source, columns=columns, recording=recording, salvage=salvage)
    measured = _between(measured, since, until, source)
    lost = data.losses(measured, target, form)
    scene = None
    if model is not None:
        scene = scene_of(load_model(model, timestep=timestep), measured)
    data.write(measured, target, form, scene=scene)
    found: dict[str, Any] = {
        "source": str(source),
        "target": str(target),
        "format": form,
        "samples": len(measured),
        "columns": list(measured.columns),
        "lost": list(lost),
        "repairs": list(measured.metadata.get("repairs", ())),
        "salvaged": list(measured.metadata.get("salvaged", ())),
    }
    if as_json:
        terminal.print_json(found, ascii_only=False)
        return
    for word, name in (("salvaged", "salvaged"), ("repaired", "repairs"), ("lost", "lost")):
        for line in found[name]:
            terminal.errors.print(f"{word}: {line}", markup=False)
    text = f"written to {target}: {form}, {len(measured)} samples"
    terminal.tell(f"{text} of {len(measured.columns)} columns")


def _check_new(paths: "Iterable[Path | None]", *, overwrite: bool) -> None:
    """Raises `FileError` if one of the files exists and may not be replaced."""
    for path in filter(None, paths):
        if path.exists() and not overwrite:
            raise FileError(f"{path} exists; --overwrite replaces it", given=path)


def _machine_of_run(folder: Path, model: str | None, form: str) -> tuple[str | None, float | None]:
    """Returns model and time step [s] of the scene of a run: the run's own if no model is given."""
    from leglab.runs.folder import model_of, read_run

    run = read_run(folder)
    if form != "mcap" or model is not None:
        return model, None
    terminal.tell_of_models([folder])
    return model_of(folder, run.configuration), run.setting("timestep")


def _between(
    recording: "Recording", since: float | None, until: float | None, source: Path
) -> "Recording":
    """Returns the part of a recording from `since` to `until` [s]; errors name its source."""
    try:
        return recording.between(since, until)
    except RecordingError as error:
        raise error.at(source) from error


def _as_second(text: str | None) -> tuple[float | None, str | None]:
    """Returns a number as (time [s], None), and the name of a format as (None, name)."""
    from leglab.data import FORMATS

    try:
        return (None, None) if text is None else (float(text), None)
    except ValueError:
        if text not in FORMATS:
            raise FileError.unknown("format", text, FORMATS) from None
        return None, text


def inspect(
    file: Annotated[Path, typer.Argument(help=_ANY)],
    columns: options.Columns = None,
    model: _Model = None,
    out: _Map = None,
    plot: _Plot = None,
    fix_base: options.FixBase = False,
    since: options.From = None,
    until: options.To = None,
    recording: options.Which = None,
    salvage: options.Salvage = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace map and plot.")] = False,
    as_json: options.Json = False,
) -> None:
    """Shows a recording: columns, units, rate, duration, gaps and defects.

    With --model it proposes how the columns are called in the model and in which unit they are.
    Ends with status 2 where the file cannot be used as a recording.
    """
    from leglab import data

    if out is not None and model is None:
        text = "--out writes the map that is proposed for a model; allowed: "
        raise SettingsError(text, given=out, allowed="--out with --model")
    if plot == Path("-"):
        plot = Path(f"{file.resolve().stem}.png")
    _check_new((out, plot), overwrite=overwrite)
    source = _one_recording(file)
    known = data.read_column_map(columns) if columns is not None else None
    tables = data.read_tables(source, columns=known, partial=True, timed=False, salvage=salvage)
    if recording is not None and recording not in tables:
        raise RecordingError.unknown("recording", recording, tables)
    table, metadata = tables[recording or next(iter(tables))]
    table = _cut(table, since, until, file)
    unreadable = metadata.pop("unreadable", {})
    summary = data.summarise(table, metadata)
    proposal = None
    if model is not None or not any(name.endswith("_position") for name in table):
        proposal = _proposal(table, metadata, model, known, fix_base=fix_base)
    if out is not None:
        data.write_atomically(out, lambda stream: stream.write(f"{proposal}\n".encode()))
    if plot is not None:
        from leglab.report.signals import save_signals

        save_signals(table, metadata, plot, title=file.name)
    if as_json:
        found = {"file": str(file), "recordings": [n for n in tables if n], **summary.to_json()}
        found["unreadable"] = unreadable
        terminal.print_json({**found, **({"map": proposal.to_json()} if proposal else {})})
    else:
        if len(tables) > 1:
            names = ", ".join(f"{name} ({_rows(part)})" for name, (part, _) in tables.items())
            terminal.tell(f"{len(tables)} recordings, --recording NAME shows another: {names}")
        _show(file, summary, unreadable)
        for path in filter(None, (out, plot)):
            terminal.tell(f"written to {path}")
        if proposal is not None:
            _show_map(proposal, out, model)
    if any(finding.fatal for finding in summary.findings):
        raise typer.Exit(terminal.BAD_INPUT)


def _rows(table: "Mapping[str, np.ndarray]") -> int:
    return max((samples.size for samples in table.values()), default=0)


def _one_recording(path: Path) -> Path:
    """Returns the path of the only recording in a folder, or the path of a file unchanged."""
    if not path.is_dir():
        return path
    from leglab.diagnosis.intake.recordings import recording_files

    files = list(recording_files([path])[0])
    if len(files) > 1:
        text = f"{path}: {len(files)} recordings, one at a time; allowed: "
        raise FileError(text, given=path, allowed=map(str, files))
    return files[0]


def _cut(
    table: "dict[str, np.ndarray]", since: float | None, until: float | None, source: Path
) -> "dict[str, np.ndarray]":
    """Returns the rows of a table from `since` to `until` [s]; None for no limit."""
    from leglab.data.checks import to_recording

    if since is None and until is None:
        return table
    if "time" not in table:
        raise RecordingError(f"{source}: no column 'time', by which --from and --to cut")
    whole = to_recording(table, {}, source=str(source), repair=False)
    part = _between(whole, since, until, source)
    return {"time": part.time, **part.columns}


def _proposal(
    table: "Mapping[str, np.ndarray]",
    metadata: "Mapping[str, Any]",
    model: str | None,
    known: "ColumnMap | None",
    *,
    fix_base: bool,
) -> "Proposal":
    """Proposes a column map for a model, and keeps the rules of the user's map `known`."""
    from leglab.base.units import own_units
    from leglab.diagnosis.intake.proposal import propose

    if model is None:
        return propose(table, own_units(metadata), given=known)
    from leglab.diagnosis.plant.columns import usable_columns
    from leglab.diagnosis.plant.model import Machine

    machine = Machine(model, fix_base=fix_base)
    units, usable = own_units(metadata), usable_columns(machine)
    proposal = propose(table, units, usable, machine.columns, known)
    # Joints whose positions follow from an equality constraint need no column.
    machine = machine.measured_by({line.ours for line in proposal.lines if line.sure})
    needed = {"time", *machine.columns}
    proposal = replace(proposal, missing=tuple(n for n in proposal.missing if n in needed))
    return proposal if proposal.missing else _tried(proposal, machine, table)


def _tried(
    proposal: "Proposal", machine: "Machine", table: "Mapping[str, np.ndarray]"
) -> "Proposal":
    """Returns the proposal with those column factors by which the model fits the motion better."""
    from leglab.data.checks import to_recording
    from leglab.data.files import LeftOut
    from leglab.diagnosis.balance.units import doubts
    from leglab.diagnosis.intake.admission import admit

    mapped = proposal.column_map.apply(table, "", LeftOut(partial=True))
    for _ in machine.columns:  # one pass per doubt, because a doubt hides the next one
        try:
            recording = to_recording(mapped, {}, source="", repair=True)
            admitted = admit(machine, {"": recording}).recordings
        except RecordingError as error:
            return replace(proposal, doubt=str(error).removeprefix(": "))
        found = doubts(machine, admitted)
        if not found:
            break
        (doubt,) = found
        # The data do not show which of several columns has the wrong sign: change none.
        factor = 1.0 if doubt.alike else doubt.factor
        for column in (*doubt.columns, *doubt.alike):
            proposal = proposal.asked(column, factor, doubt.words.partition(": ")[0])
            mapped[column] = factor * mapped[column]
        if doubt.alike:
            break
    return proposal


def _show(file: Path, summary: "Summary", unreadable: "Mapping[str, str]") -> None:
    """Prints the summary of a file and its findings."""
    terminal.tell(f"{file}: {_axis(summary)}")
    metadata = dict(summary.metadata)
    if said := metadata.pop("time", None):
        terminal.tell(f"time: {said}")
    terminal.print_wide(_table(summary))
    for finding in summary.findings:
        label = "error" if finding.fatal else finding.kind
        terminal.tell(f"{label}: {finding.message}")
    for name, why in unreadable.items():
        terminal.tell(f"unreadable: {name}: {why}")
    if not summary.findings:
        terminal.output.print("no gap, nothing missing, no constant column")
    for key, value in metadata.items():
        text = json.dumps(value, ensure_ascii=False)
        short = text if len(text) <= 100 else f"{text[:97]}..."
        terminal.tell(f"{key} = {short}")


def _show_map(proposal: "Proposal", out: Path | None, model: str | None) -> None:
    """Prints the lines of a column map that are to be checked; the whole map if it has no file."""
    if out is None:
        terminal.tell(f"a file for --columns{'' if model else ', to be completed'}:\n{proposal}")
        return
    for line in proposal.doubtful:
        terminal.tell(f"check in {out}: {line}")


def _axis(summary: "Summary") -> str:
    text = f"{summary.samples} samples"
    if summary.duration is not None:
        text += f" over {summary.duration:g} s from {summary.start:g} s"
    if summary.rate is not None and summary.period is not None:
        text += f", {summary.rate:.6g} Hz ({summary.period:.6g} s)"
    if summary.duration is None or any(finding.fatal for finding in summary.findings):
        return text
    count = summary.gaps
    return f"{text}, {count or 'no'} gap{'s' * (count != 1)}"


def _table(summary: "Summary") -> Table:
    table = Table(box=SIMPLE_HEAD)
    table.add_column("column")
    table.add_column("unit")
    for heading in ("smallest", "largest", "missing"):
        table.add_column(heading, justify="right")
    for column in summary.columns:
        limits = (column.smallest, column.largest)
        cells = ("-" if value is None else f"{value:.6g}" for value in limits)
        missing = str(column.missing) if column.missing else "-"
        table.add_row(escape(column.name), column.unit, *cells, missing)
    return table
