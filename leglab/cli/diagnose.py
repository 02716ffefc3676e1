"""`leglab diagnose`: names what the simulation is missing."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from leglab.base.errors import SettingsError
from leglab.base.output import check_apart, check_folder, new_folder, piece
from leglab.cli.options import (
    Columns,
    FixBase,
    From,
    HeldOut,
    Json,
    Load,
    Overwrite,
    Salvage,
    To,
    check_order,
)
from leglab.cli.terminal import output, print_json, print_table, progress, read_and_warn, tell

if TYPE_CHECKING:
    from leglab.diagnosis.result import Diagnosis


def diagnose(
    model: Annotated[str | None, typer.Argument(help="Machine.")] = None,
    recordings: Annotated[
        list[Path] | None,
        typer.Argument(help="Recordings: .parquet, .csv, .mcap, .mat, .npz, or folders of them."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Output folder.")] = Path("out/diagnosis"),
    held_out: HeldOut = None,
    healthy: Annotated[
        list[Path] | None,
        typer.Option(
            help="Recordings of the same machine while it was healthy: names what changed since."
        ),
    ] = None,
    columns: Columns = None,
    since: From = None,
    until: To = None,
    salvage: Salvage = False,
    effect: Annotated[
        list[str] | None,
        typer.Option(
            help="Effect to consider, of docs/reference/effects.md, repeatable; default: all."
        ),
    ] = None,
    why: Annotated[
        list[str] | None,
        typer.Option(
            help="Effect whose verdict to explain, repeatable: its evidence alone and added to "
            "good sets, the fitted sets with it, the most probable set."
        ),
    ] = None,
    fix_base: FixBase = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
    load: Load = None,
) -> None:
    """Finds the physical effect that a simulation lacks, from measured recordings.

    Writes diagnosis.json, improved.xml (the model with the effect), figures and the page
    diagnosis.html, and shows the gap on recordings that were not used to find it.
    """
    if asked := [*(effect or []), *(why or [])]:
        _check_effects(asked)
    if model is None or not recordings:
        raise SettingsError("diagnose needs a model and at least one recording")
    check_order(model, recordings)
    from leglab.diagnosis.improve import improved_model
    from leglab.diagnosis.intake.recordings import split_held_out
    from leglab.diagnosis.plant.model import Machine
    from leglab.diagnosis.search.pipeline import DiagnosisSettings
    from leglab.diagnosis.verdict import output as results
    from leglab.diagnosis.verdict.verdict import diagnose as run_diagnosis
    from leglab.report.diagnosis.page import write_page
    from leglab.report.diagnosis.why import why as explained

    check_folder(out, overwrite=overwrite, mark="diagnosis.json")
    check_apart(out, [Path(model), *recordings, *(healthy or [])])
    _check_given_once(recordings, healthy or [])
    read = partial(read_and_warn, columns=columns, span=(since, until), salvage=salvage)
    machine = Machine(model, fix_base=fix_base)
    named, held = split_held_out(machine, read(recordings), held_out or [])
    before = read(healthy) if healthy else None
    settings = DiagnosisSettings(effects=tuple(effect) if effect else None)
    made = ("diagnosis.html", "improved.xml", "figures")
    with new_folder(out, mark="diagnosis.json", made=made, overwrite=overwrite) as folder:
        with progress("diagnosis") as show:
            result, found = run_diagnosis(
                machine,
                named,
                held_out=held,
                healthy=before,
                settings=settings,
                progress=lambda line: show(description=line),
            )
            with piece("improved.xml", result.missing):
                better = improved_model(found, lambda line: show(description=line))
                if better is not None:
                    path, lines = better.write(folder)
                    result = replace(
                        result.with_model(path.name, better.learned, better.errors),
                        changed=lines,
                        moved=better.moved,
                    )
        with piece("diagnosis.html", result.missing):
            write_page(result, folder, model=Path(model).stem)
        results.write_diagnosis(result, folder)
    if as_json:
        print_json(result.to_json(), ascii_only=False)
    else:
        show_diagnosis(result, out)
        for name in why or []:
            for line in explained(result, name, effect or ()):
                output.print(line, markup=False, highlight=False)


def _check_given_once(recordings: list[Path], healthy: list[Path]) -> None:
    """Rejects a recording that is also given as --healthy."""
    from leglab.diagnosis.intake.recordings import recording_files

    now, earlier = (
        {path.resolve() for path in recording_files(paths)[0]} for paths in (recordings, healthy)
    )
    if both := now & earlier:
        told = f"{min(both).name} is given as a recording and as --healthy; allowed: "
        raise SettingsError(told, given=min(both), allowed="one of both")


def show_diagnosis(result: "Diagnosis", out: Path) -> None:
    """Prints the verdict in words and tables."""
    from leglab.diagnosis.verdict import output as results
    from leglab.report.diagnosis.words import facts, headline, smaller_words

    lines = [headline(result), *(f"{term}: {text}" for term, text in facts(result))]
    for line in [*lines, *smaller_words(result)]:
        output.print(line, markup=False, highlight=False)
    for table in results.summary_tables(result):
        print_table(table)
    for line in results.summary_lines(result):
        output.print(line, markup=False)
    page = "diagnosis.json" if "diagnosis.html" in result.missing else "diagnosis.html"
    tell(f"{result.seconds:.1f} s, {result.rollouts:.0f} replays; {out / page}")


def _check_effects(names: list[str]) -> None:
    """Rejects names of effects that neither leglab nor a plug-in has registered."""
    from leglab.diagnosis.effects import all_effects

    known = sorted({effect.name for effect in all_effects() if effect.nameable})
    for name in names:
        if name not in known:
            raise SettingsError.unknown("effect", name, known)
