"""`leglab identify`: a model of anyone's data."""

import hashlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from leglab.base.errors import LeglabError
from leglab.base.output import check_apart, new_folder
from leglab.cli.options import Columns, From, Json, Overwrite, Salvage, To, check_jobs
from leglab.cli.terminal import complain, plain_table, print_json, print_wide, progress, tell

if TYPE_CHECKING:
    from leglab.base.recording import Recording
    from leglab.identification.structure import Identified
    from leglab.identification.structure.journal import Journal


_Inputs = Annotated[
    list[str] | None,
    typer.Option("--input", metavar="COLUMN", help="Input, repeatable; default: u..."),
]
_Outputs = Annotated[
    list[str] | None,
    typer.Option("--output", metavar="COLUMN", help="Output, repeatable; default: y..."),
]


def identify(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            metavar="DATA...",
            help="Recordings to learn from: .csv, .parquet, .mat, .npz, .mcap, or folders of them.",
        ),
    ],
    input_: _Inputs = None,
    output_: _Outputs = None,
    test: Annotated[
        list[Path] | None,
        typer.Option(help="Recording to test with, repeatable; nothing is chosen by it."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Output folder.")] = Path("out/identify"),
    period: Annotated[
        float | None,
        typer.Option(metavar="S", help="Resample to this period; period of data without a time."),
    ] = None,
    columns: Columns = None,
    since: From = None,
    until: To = None,
    salvage: Salvage = False,
    jobs: Annotated[int, typer.Option(help="Threads; -1: one a core.")] = -1,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Identifies a dynamic model from measured inputs and outputs.

    Delays, lags and nonlinear features are chosen by the free run over parts of the data that no
    fit has seen; linear models are always among the candidates. Writes identify.json, a page, the
    model (model.leglab, which goes on learning online) and a C header. An interrupted search goes
    on where it was.
    """
    from leglab.identification.structure.signals import columns_of
    from leglab.report.identification import output as results

    check_jobs(jobs)
    check_apart(out, [*recordings, *(test or [])])
    span = (since, until)
    learned = _read(recordings, columns, span, salvage, period)
    tested = _read(test or [], columns, span, salvage, period)
    named = columns_of(learned, _with_units(input_, learned), _with_units(output_, learned))
    stems = ("model", *map(results.stem_of, named[1]))
    made = (results.PAGE, *(f"{name}{end}" for name in stems for end in (".leglab", ".h")))
    with new_folder(out, mark=results.RESULT, made=made, overwrite=overwrite) as folder:
        threads = (os.cpu_count() or 1) if jobs == -1 else jobs
        models, journal = _identified(learned, tested, named, period, threads, out)
        missing = results.write_all(models, folder)
    journal.done()
    for name, why in missing.items():
        complain(f"{name} is missing: {why}", "warning")
    if as_json:
        print_json(results.summary(models))
        return
    _show(models, out)


def _with_units(
    names: Sequence[str] | None, recordings: "Mapping[str, Recording]"
) -> tuple[str, ...]:
    """Completes names that lack their unit: `pump` for the only column `pump [V]`."""
    from leglab.data.units_in_names import split

    known = {column for recording in recordings.values() for column in recording.columns}
    out = []
    for name in names or ():
        same = [column for column in known if split(column).stem == name]
        out.append(same[0] if name not in known and len(same) == 1 else name)
    return tuple(out)


def _identified(
    learned: "Mapping[str, Recording]",
    tested: "Mapping[str, Recording]",
    named: tuple[tuple[str, ...], tuple[str, ...]],
    period: float | None,
    threads: int,
    out: Path,
) -> "tuple[dict[str, Identified], Journal]":
    """Returns models by output, and the journal next to `out` by which the search can resume."""
    from leglab.identification.structure import identify as run_identify
    from leglab.identification.structure.journal import Journal
    from leglab.jobs.fingerprint import own_fingerprint

    inputs, outputs = named
    place = Path(os.path.realpath(out))
    key = _digest(learned, inputs, outputs, period, own_fingerprint())
    journal = Journal(place.with_name(f".{place.name}.search"), key)
    if journal.kept:
        count = sum(map(len, journal.kept.values()))
        complain(f"{count} structures of an interrupted search are taken over", "warning")
    try:
        with progress("identify") as show:
            models = run_identify(
                learned,
                inputs=inputs,
                outputs=outputs,
                tests=tested or None,
                period=period,
                jobs=threads,
                progress=lambda n, total, stage: show(description=stage, completed=n, total=total),
                kept=journal.kept,
                keep=journal.keep,
            )
    except KeyboardInterrupt:
        kept = journal.path.exists()
        text = f"the same command goes on from {journal.path}" if kept else "no result is kept yet"
        complain(text, "warning")
        raise
    return models, journal


def _read(
    paths: Sequence[Path],
    columns: Path | None,
    span: tuple[float | None, float | None],
    salvage: bool,
    period: float | None,
) -> "dict[str, Recording]":
    """Returns recordings by name; without a time column, rows are a period or 1 s apart."""
    import numpy as np

    from leglab import data
    from leglab.data.checks import to_recording
    from leglab.diagnosis.intake.recordings import recording_files

    out: dict[str, Recording] = {}
    files, notes = recording_files(paths)
    for note in notes:
        complain(note, "warning")
    for path in files:
        tables = data.read_tables(path, columns=columns, partial=True, timed=False, salvage=salvage)
        for name, (table, metadata) in tables.items():
            source = f"{path.name}: {name}" if name else path.name
            if "time" not in table:
                apart = period or metadata.get("period", 1.0)
                if period is None:
                    text = f"{source} has no time: samples count as {apart:g} s apart; "
                    complain(text + "--period S sets another period", "warning")
                length = len(next(iter(table.values()), ()))
                table = {"time": np.arange(length) * apart, **table}
            recording = to_recording(table, metadata, source=str(path), repair=True)
            for column, why in metadata.get("unreadable", {}).items():
                complain(f"{source}: {column!r} is left out: {why}", "warning")
            if span != (None, None):
                try:
                    recording = recording.between(*span)
                except LeglabError as error:
                    raise error.at(path) from error
            while source in out:
                source += "'"
            out[source] = recording
    return out


def _digest(
    recordings: "Mapping[str, Recording]",
    inputs: Sequence[str],
    outputs: Sequence[str],
    period: float | None,
    code: str,
) -> str:
    digest = hashlib.sha256(repr((inputs, outputs, period, code)).encode())
    for name, recording in recordings.items():
        digest.update(name.encode())
        digest.update(recording.time.tobytes())
        for column, values in recording.columns.items():
            digest.update(column.encode() + values.tobytes())
    return digest.hexdigest()


def _show(models: "Mapping[str, Identified]", out: Path) -> None:
    from leglab.report.identification import output as results

    for found in models.values():
        tell(results.headline(found))
        for section in results.sections(found):
            for line in section.lines:
                tell(f"{section.title}: {line}")
        table = results.errors_table(found)
        print_wide(plain_table(table.head, table.rows))
    files = "the model and its C header" if len(models) == 1 else "the models and their C headers"
    tell(f"written to {out}: {results.PAGE}, {results.RESULT}, {files}")
