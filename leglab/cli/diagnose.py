"""`leglab diagnose`: names what the simulation is missing."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from leglab.base.errors import LeglabError, unknown_name
from leglab.base.output import check_apart, check_folder, claimed_folder, new_folder
from leglab.cli.options import (
    Columns,
    HeldOut,
    Json,
    Load,
    Overwrite,
    Scheduler,
    check_jobs,
    load_plugins,
)
from leglab.cli.terminal import output, print_json, progress, tell


def diagnose(
    model: Annotated[str | None, typer.Argument(help="Machine.")] = None,
    recordings: Annotated[
        list[Path] | None, typer.Argument(help="Recordings: .parquet, .csv, .mcap, .mat, .npz.")
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
    effect: Annotated[
        list[str] | None,
        typer.Option(help="Effect to consider, of docs/effects.md, repeatable; default: all."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the self-test's cases.")] = 0,
    self_test: Annotated[
        bool, typer.Option("--self-test", help="Diagnose blind cases with known truth instead.")
    ] = False,
    cases: Annotated[int, typer.Option(help="Single-effect cases of the self-test.")] = 100,
    rough: Annotated[
        bool,
        typer.Option(
            "--rough",
            help="Self-test on specimens that differ from their model everywhere a little, with "
            "recordings from before the fault.",
        ),
    ] = False,
    no_healthy: Annotated[
        bool, typer.Option("--no-healthy", help="Rough self-test without those recordings.")
    ] = False,
    sizes: Annotated[
        str,
        typer.Option(
            help="Of the self-test's faults: gross, or visible for everything from just visible "
            "to gross."
        ),
    ] = "gross",
    jobs: Annotated[
        int, typer.Option(help="Cases of the self-test at a time; -1: one a core.")
    ] = -1,
    scheduler: Scheduler = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
    load: Load = None,
) -> None:
    """Finds the physical effect that a simulation lacks, from measured recordings.

    Writes diagnosis.json, improved.xml (the model with the effect), figures and the page
    diagnosis.html, and shows the gap on recordings that were not used to find it.
    """
    load_plugins(load)
    if seed < 0:
        raise LeglabError(f"seed is {seed}; allowed: 0 or more")
    if effect:
        _check_effects(effect)
    if self_test:
        if cases < 1:
            raise LeglabError(f"cases is {cases}; allowed: 1 or more")
        check_jobs(jobs)
        where = {"processes": jobs, "scheduler": scheduler}
        with claimed_folder(out):
            if rough or sizes != "gross":
                healthy_too = rough and not no_healthy
                _rough_self_test(out, cases, seed, as_json, rough, healthy_too, sizes, where)
            else:
                _self_test(out, cases, seed, as_json, where)
        return
    if rough or no_healthy or sizes != "gross" or jobs != -1 or scheduler is not None:
        raise LeglabError(
            "--rough, --no-healthy, --sizes, --jobs and --scheduler are options of --self-test"
        )
    if model is None or not recordings:
        raise LeglabError("diagnose needs a model and at least one recording, or --self-test")
    from leglab.diagnosis.improve import improved_model
    from leglab.diagnosis.intake.recordings import read_recordings, split_held_out
    from leglab.diagnosis.search.pipeline import DiagnosisSettings
    from leglab.diagnosis.verdict import output as results
    from leglab.diagnosis.verdict.verdict import diagnose as run_diagnosis
    from leglab.report.diagnosis.page import write_page
    from leglab.report.diagnosis.words import facts, headline, smaller_words

    check_folder(out, overwrite=overwrite, mark="diagnosis.json")
    check_apart(out, [Path(model), *recordings, *(healthy or [])])
    named = read_recordings(recordings, columns)
    named, held = split_held_out(model, named, held_out or [])
    before = read_recordings(healthy, columns) if healthy else None
    both = {path.resolve() for path in recordings} & {path.resolve() for path in healthy or []}
    if both:
        raise LeglabError(
            f"{min(both).name} is given as a recording and as --healthy; allowed: one of both"
        )
    settings = DiagnosisSettings(effects=tuple(effect) if effect else None)
    with new_folder(out, mark="diagnosis.json", overwrite=overwrite) as partial:
        with progress("diagnosis") as show:
            result, found = run_diagnosis(
                model,
                named,
                held_out=held,
                healthy=before,
                settings=settings,
                progress=lambda line: show(description=line),
            )
            better = improved_model(found, lambda line: show(description=line))
        if better is not None:
            written = better.write(partial).name
            result = result.with_model(written, better.learned, better.errors)
        results.write_diagnosis(result, partial)
        write_page(result, partial, model=Path(model).stem)
    if as_json:
        print_json(result.to_json(), ascii_only=False)
        return
    output.print(headline(result), markup=False, highlight=False)
    for term, text in facts(result):
        output.print(f"{term}: {text}", markup=False, highlight=False)
    for line in smaller_words(result):
        output.print(line, markup=False, highlight=False)
    for table in results.summary_tables(result):
        output.print(table)
    for line in results.summary_lines(result):
        output.print(line, markup=False)
    tell(f"{result.seconds:.1f} s, {result.rollouts:.0f} replays; {out}/diagnosis.html")


def _rough_self_test(
    folder: Path,
    count: int,
    seed: int,
    as_json: bool,
    rough: bool,
    healthy: bool,
    sizes: str,
    where: dict[str, Any],
) -> None:
    from leglab.studies.blind.rough_figures import save_figures
    from leglab.studies.blind.rough_selftest import (
        RoughTestSettings,
        as_rows,
        confusion_table,
        reliability_table,
        rough_self_test,
        score_table,
    )

    settings = RoughTestSettings(rough=rough, sizes=sizes, healthy=healthy, seed=seed)
    with progress("self-test", count) as show:

        def tell(label: str, done: int, total: int) -> None:
            show(description=label or "self-test", completed=done, total=total)

        outcomes = rough_self_test(folder, count, settings, progress=tell, **where)
    paths = save_figures(outcomes, folder, settings.name)
    if as_json:
        print_json(as_rows(outcomes))
        return
    output.print(score_table(outcomes, settings))
    output.print(reliability_table(outcomes))
    output.print(confusion_table(outcomes))
    for path in paths:
        output.print(str(path), markup=False, highlight=False, soft_wrap=True)


def _self_test(folder: Path, count: int, seed: int, as_json: bool, where: dict[str, Any]) -> None:
    from leglab.studies.blind.selftest import confusion_table, score_table, self_test

    with progress("self-test", count) as show:

        def tell(label: str, done: int, total: int) -> None:
            show(description=label or "self-test", completed=done, total=total)

        outcomes = self_test(folder, count, seed=seed, progress=tell, **where)
    if as_json:
        print_json([asdict(o) for o in outcomes])
        return
    output.print(score_table(outcomes))
    output.print(confusion_table(outcomes))


def _check_effects(names: list[str]) -> None:
    """Refuses names of effects that nothing has registered, a plug-in neither."""
    from leglab.diagnosis.effects import all_effects

    known = sorted({effect.name for effect in all_effects() if effect.nameable})
    for name in names:
        if name not in known:
            raise unknown_name("effect", name, known)
