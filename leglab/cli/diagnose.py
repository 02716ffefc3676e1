"""`leglab diagnose`: names what the simulation is missing."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from leglab.base.errors import SettingsError
from leglab.base.output import check_apart, check_folder, new_folder, piece
from leglab.cli import options
from leglab.cli.terminal import output, print_json, print_table, read_and_warn, tell, told_stages

if TYPE_CHECKING:
    from leglab.diagnosis.result import Diagnosis
    from leglab.diagnosis.verdict.outcome import Outcome

MARK = "diagnosis.json"
KEPT = "sets.json"
MADE = ("diagnosis.html", "improved.xml", "figures", KEPT)
"""What `leglab diagnose` and `leglab fit` write besides `MARK`."""

_Healthy = Annotated[
    list[Path] | None,
    typer.Option(
        help="Recordings of the same machine while it was healthy: names what changed since."
    ),
]
_Effect = Annotated[
    list[str] | None,
    typer.Option(
        help="Effect to consider, of docs/reference/effects.md, repeatable; default: all."
    ),
]
_Why = Annotated[
    list[str] | None,
    typer.Option(
        help="Effect whose verdict to explain, repeatable: its evidence alone and added to good "
        "sets, the fitted sets with it, the most probable set."
    ),
]
_Keep = Annotated[
    bool,
    typer.Option(
        "--keep",
        help="Also write sets.json: all sets of effects with their evidence, by which "
        "leglab.diagnosis.verdict.confidence.judge gives the verdict anew, without replays.",
    ),
]


def diagnose(
    model: Annotated[str | None, typer.Argument(help="Machine.")] = None,
    recordings: options.SomeRecordings = None,
    out: options.Out = Path("out/diagnosis"),
    held_out: options.HeldOut = None,
    healthy: _Healthy = None,
    columns: options.Columns = None,
    since: options.From = None,
    until: options.To = None,
    salvage: options.Salvage = False,
    effect: _Effect = None,
    why: _Why = None,
    keep: _Keep = False,
    fix_base: options.FixBase = False,
    overwrite: options.Overwrite = False,
    as_json: options.Json = False,
    load: options.Load = None,
) -> None:
    """Finds the physical effect that a simulation lacks, from measured recordings.

    Writes diagnosis.json, improved.xml (the model with the effect), figures and the page
    diagnosis.html, and shows the gap on recordings that were not used to find it.
    """
    if asked := [*(effect or []), *(why or [])]:
        _check_effects(asked)
    if model is None or not recordings:
        raise SettingsError("diagnose needs a model and at least one recording")
    options.check_order(model, recordings)
    from leglab.diagnosis.intake.recordings import split_held_out
    from leglab.diagnosis.plant.model import Machine
    from leglab.diagnosis.search.pipeline import DiagnosisSettings
    from leglab.diagnosis.verdict.verdict import diagnose as run_diagnosis

    check_folder(out, overwrite=overwrite, mark=MARK)
    check_apart(out, [Path(model), *recordings, *(healthy or [])])
    _check_given_once(recordings, healthy or [])
    read = partial(read_and_warn, columns=columns, span=(since, until), salvage=salvage)
    machine = Machine(model, fix_base=fix_base)
    named, held = split_held_out(machine, read(recordings), held_out or [])
    before = read(healthy) if healthy else None
    settings = DiagnosisSettings(effects=tuple(effect) if effect else None)
    run = partial(run_diagnosis, machine, named, held_out=held, healthy=before, settings=settings)
    with new_folder(out, mark=MARK, made=MADE, overwrite=overwrite) as folder:
        with told_stages("diagnosis") as show:
            result, found = run(progress=show)
            result = _with_improved_model(result, found, folder, show)
        if keep:
            found.table.write(folder / KEPT)
        write_diagnosis(result, folder, model)
    show_diagnosis(result, out, as_json=as_json, why=why or (), effects=effect or ())


def _with_improved_model(
    result: "Diagnosis", found: "Outcome", folder: Path, progress: Callable[[str], None]
) -> "Diagnosis":
    """Writes DIR/improved.xml if a model is better; returns the result with what is in the file."""
    from leglab.diagnosis.improve import improved_model

    with piece("improved.xml", result.missing):
        better = improved_model(found, progress)
        if better is not None:
            path, lines = better.write(folder)
            told = result.with_model(path.name, better.learned, better.errors)
            return replace(told, changed=lines, moved=better.moved)
    return result


def write_diagnosis(result: "Diagnosis", folder: Path, model: str) -> None:
    """Writes DIR/diagnosis.json, and the page of a model's diagnosis with its figures."""
    from leglab.diagnosis.verdict import output as results
    from leglab.report.diagnosis.page import write_page

    with piece("diagnosis.html", result.missing):
        write_page(result, folder, model=Path(model).stem)
    results.write_diagnosis(result, folder)


def _check_given_once(recordings: list[Path], healthy: list[Path]) -> None:
    """Rejects a recording that is also given as --healthy."""
    from leglab.diagnosis.intake.recordings import recording_files

    now, earlier = (
        {path.resolve() for path in recording_files(paths)[0]} for paths in (recordings, healthy)
    )
    if both := now & earlier:
        text = f"{min(both).name} is given as a recording and as --healthy; allowed: "
        raise SettingsError(text, given=min(both), allowed="one of both")


def show_diagnosis(
    result: "Diagnosis",
    out: Path,
    *,
    as_json: bool,
    why: Sequence[str] = (),
    effects: Sequence[str] = (),
) -> None:
    """Prints the verdict in words and tables, or as JSON.

    `why` are effects whose verdict is explained as well, `effects` those that were considered.
    """
    from leglab.diagnosis.verdict import output as results
    from leglab.report.diagnosis.why import why as explained
    from leglab.report.diagnosis.words import facts, headline, smaller_words

    if as_json:
        print_json(result.to_json(), ascii_only=False)
        return
    lines = [headline(result), *(f"{term}: {text}" for term, text in facts(result))]
    for line in [*lines, *smaller_words(result)]:
        output.print(line, markup=False, highlight=False)
    for table in results.summary_tables(result):
        print_table(table)
    for line in results.summary_lines(result):
        output.print(line, markup=False)
    page = "diagnosis.json" if "diagnosis.html" in result.missing else "diagnosis.html"
    if not result.model and "improved.xml" not in result.missing:
        tell("no improved.xml: no change of the model is sure")
    elif any(line.startswith("+") and "leglab." in line for line in result.changed):
        tell("improved.xml needs leglab's plugins: leglab.machine.plugin.load_plugin() loads them")
    tell(f"{result.seconds:.1f} s, {result.rollouts:.0f} replays; {out / page}")
    for name in why:
        for line in explained(result, name, effects):
            output.print(line, markup=False, highlight=False)


def _check_effects(names: list[str]) -> None:
    """Rejects names of effects that neither leglab nor a plug-in has registered."""
    from leglab.diagnosis.effects import all_effects

    known = sorted({effect.name for effect in all_effects() if effect.nameable})
    for name in names:
        if name not in known:
            raise SettingsError.unknown("effect", name, known)
