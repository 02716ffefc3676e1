"""`leglab convert` and `leglab inspect`: recordings of one format in another, and at a glance."""

import json
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from leglab.base.errors import FileError, SettingsError
from leglab.base.output import new_file
from leglab.cli.options import Columns, Json
from leglab.cli.terminal import errors, output, print_json, print_wide, tell

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np

    from leglab.data import Summary


# Formats that show a machine.
_SHOWING = ("mcap", "rerun")


def convert(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="IN", help=".parquet, .csv, .mcap, .mat, .npz, a ROS 2 bag, or a run's folder."
        ),
    ],
    target: Annotated[
        Path, typer.Argument(metavar="OUT", help=".parquet, .csv, .mcap, .mat, .npz or .rrd.")
    ],
    to: Annotated[
        str | None, typer.Option(metavar="FORMAT", help="Format; default: by the suffix of OUT.")
    ] = None,
    columns: Columns = None,
    model: Annotated[
        str | None,
        typer.Option(
            metavar="MODEL",
            help="Machine that OUT shows, .mcap or .rrd; of a run's folder it is known.",
        ),
    ] = None,
    layout: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Layout for PlotJuggler, XML: a tab a joint."),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace OUT.")] = False,
    as_json: Json = False,
) -> None:
    """Converts a recording to another format and says what is lost.

    Samples keep every bit; docs/reference/data_formats.md says what else survives in which format.
    A run's folder as .mcap or .rrd shows the machine too: links, poses, meshes.
    """
    from leglab import data
    from leglab.data import plotjuggler
    from leglab.machine.scene import scene_of
    from leglab.machine.simulation import load_model
    from leglab.runs.folder import RECORDING, read_run

    # First of all what costs nothing to check.
    if to is not None and to not in data.FORMATS:
        raise FileError.unknown("format", to, data.FORMATS)
    form = to or data.format_of(target)
    for file in filter(None, (target, layout)):
        if file.exists() and not overwrite:
            raise FileError(f"{file} exists; --overwrite replaces it", given=file)
    if layout is not None and form not in ("csv", "plotjuggler"):
        told = f"--layout goes with csv and plotjuggler, not with {form}"
        raise SettingsError(told, given=form, allowed=("csv", "plotjuggler"))
    timestep = None
    if (source / RECORDING).is_file():
        run = read_run(source)
        if form in _SHOWING and model is None:
            model = str(run.configuration.settings["model"])
            timestep = run.configuration.settings.get("timestep")
        source = source / RECORDING
    if model is not None and form not in _SHOWING:
        told = f"{form} cannot show a machine; --model goes with {' or '.join(_SHOWING)}"
        raise SettingsError(told, given=form, allowed=_SHOWING)
    recording = data.read(source, columns=columns)
    lost = data.losses(recording, target, form)
    scene = None
    if model is not None:
        scene = scene_of(load_model(model, timestep=timestep), recording)
    with new_file(layout) if layout is not None else nullcontext() as place:
        if place is not None:
            plotjuggler.write_layout(recording, place)
        data.write(recording, target, form, scene=scene)
    repairs = list(recording.metadata.get("repairs", ()))
    if as_json:
        found = {
            "source": str(source),
            "target": str(target),
            "format": form,
            "samples": len(recording),
            "columns": list(recording.columns),
            "lost": list(lost),
            "repairs": repairs,
        }
        print_json(found, ascii_only=False)
        return
    for word, lines in (("repaired", repairs), ("lost", lost)):
        for line in lines:
            errors.print(f"{word}: {line}", markup=False)
    count = len(recording.columns)
    tell(f"written to {target}: {form}, {len(recording)} samples of {count} columns")


def inspect(
    file: Annotated[
        Path, typer.Argument(help=".parquet, .csv, .mcap, .mat, .npz, or the folder of a bag.")
    ],
    columns: Columns = None,
    as_json: Json = False,
) -> None:
    """Shows what is in a recording: columns, units, rate, duration, gaps, what is wrong."""
    from leglab import data

    table, metadata = data.read_table(file, columns=columns, partial=True, timed=False)
    unreadable = metadata.pop("unreadable", {})
    summary = data.summarise(table, metadata)
    if as_json:
        print_json({"file": str(file), **summary.to_json(), "unreadable": unreadable})
        return
    tell(f"{file}: {_axis(summary)}")
    if said := metadata.pop("time", None):
        tell(f"time: {said}")
    print_wide(_table(summary))
    for finding in summary.findings:
        label = "error" if finding.fatal else finding.kind
        tell(f"{label}: {finding.message}")
    for name, why in unreadable.items():
        tell(f"unreadable: {name}: {why}")
    if "time" not in table or not any(column.unit for column in summary.columns):
        for line in _map_of({name: x for name, x in table.items() if name != "time"}):
            tell(line)
    if "time" in table and not summary.findings:
        output.print("no gap, nothing missing, no constant column")
    for key, value in metadata.items():
        text = json.dumps(value, ensure_ascii=False)
        short = text if len(text) <= 100 else f"{text[:97]}..."
        tell(f"{key} = {short}")


def _map_of(table: "Mapping[str, np.ndarray]") -> list[str]:
    """A column map to be completed, for a table whose columns have other names."""
    lines = ["a file for --columns, to be completed:", "[columns]"]
    lines += [f'{json.dumps(n)} = {{name = "JOINT_position", factor = 1.0}}' for n in table]
    return [
        *lines,
        "names here: time [s], JOINT_position [rad or m], JOINT_velocity, JOINT_pressure_a and _b "
        "[Pa], ACTUATOR_command [-1 to 1]; factor: ours per theirs, of degrees 0.0174533",
    ]


def _axis(summary: "Summary") -> str:
    text = f"{summary.samples} samples"
    if summary.duration is not None:
        text += f" over {summary.duration:g} s from {summary.start:g} s"
    if summary.rate is not None and summary.period is not None:
        text += f", {summary.rate:.6g} Hz ({summary.period:.6g} s)"
    if summary.duration is None:
        return text
    count = len(summary.gaps)
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
