"""The commands `tune`, and `benchmark`, `replicate` and `verify`, whose code only a clone has."""

import importlib
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from leglab.base.errors import LeglabError
from leglab.base.output import claimed_folder
from leglab.cli.options import Jobs, Json, Load, Model, ReplaceSweep, Scheduler, check_jobs, split
from leglab.cli.terminal import (
    FAILED,
    complain,
    errors,
    make_many,
    output,
    plain_table,
    print_json,
    print_wide,
    progress,
    tell,
)


def tune(
    models: Annotated[
        list[str] | None,
        typer.Option("--model", help="Repeatable; default: the shipped ones."),
    ] = None,
    write: Annotated[
        bool, typer.Option(help="Store the gains in the package; others stay.")
    ] = False,
    as_json: Json = False,
    load: Load = None,
) -> None:
    """Finds the PD gains that keep 6 dB and 45 degrees of margin on the linearised plant."""
    from leglab.commissioning.pd_gains import PD, TUNED_MODELS, tuned_tables

    names = models or list(TUNED_MODELS)
    make = partial(tuned_tables, names)
    tables = make_many("tuning", 0, make, "joints", resumes=False)
    if write:
        PD.store(tables)
        (errors if as_json else output).print(f"written to {PD.path}")
    if as_json:
        print_json(tables)
    elif not write:
        typer.echo(PD.text(tables), nl=False)


def _from_clone(module: str) -> Any:
    """Imports a module that a clone of leglab has and an installed wheel lacks.

    Raises:
        LeglabError: The package of the module is not installed.
    """
    package = module.partition(".")[0]
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != package:
            raise
        raise LeglabError(
            f"the package {package} is missing: it comes with leglab's source tree, not with a "
            "wheel; run `pip install --editable .` in a clone of leglab",
            given=package,
        ) from error


def replicate(
    instances: Annotated[int, typer.Option(help="Instances of each model.")] = 100,
    seed: Annotated[int | None, typer.Option(help="Default: the seed of the paper mode.")] = None,
    out: Annotated[Path, typer.Option(help="Folder of page and figures.")] = Path(
        "out/replication"
    ),
    as_json: Json = False,
) -> None:
    """Replicates the BSNN-ARX paper: Table 1, figures, sensitivities, on one page."""
    replication = _from_clone("replication")
    chosen = replication.paper.SEED if seed is None else seed
    with claimed_folder(out), progress("replicating") as show:
        result = replication.replicate(
            instances, out, chosen, progress=lambda line: show(description=line)
        )
    if as_json:
        print_json(result.to_json())
        return
    output.print(result.table, soft_wrap=True)
    output.print(f"largest deviation of a validation mean: {result.worst_deviation:.1%}")
    tell(f"written to {result.page}")


class Benchmark(StrEnum):
    """Benchmarks of controllers."""

    ADAPTATION = "adaptation"


def benchmark(
    name: Annotated[Benchmark, typer.Argument(help="Which one.")],
    controllers: Annotated[str, typer.Option(help="Names, separated by commas.")] = "bsnn_arx",
    model: Model = "leg",
    specimens: Annotated[int, typer.Option(help="Machines off the drawing, a seed each.")] = 10,
    faults: Annotated[
        str | None, typer.Option(help="Scenarios, separated by commas; default: all sixteen.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder of the dataset.")] = Path("out/adaptation"),
    workers: Jobs = -1,
    scheduler: Scheduler = None,
    by_fault: Annotated[
        bool, typer.Option("--by-fault", help="Print a line for each fault as well.")
    ] = False,
    overwrite: ReplaceSweep = False,
    as_json: Json = False,
    load: Load = None,
) -> None:
    """Compares controllers, anybody's, on sixteen faults in three sizes on many specimens.

    All meet the same machines, motions, times of the fault and noise; static_feedforward and pd
    run beside them. OUT is the folder of a sweep: an interrupted benchmark goes on where it was,
    and leglab query and report know it.
    """
    from leglab.runs.sweeps.engine import run_sweep

    adaptation = _from_clone("benchmarks.adaptation_faults")
    check_jobs(workers, "workers")
    plan, missing = adaptation.adaptation_plan(
        split(controllers),
        model=model,
        specimens=specimens,
        only=None if faults is None else split(faults),
    )
    make = partial(run_sweep, plan, out, workers=workers, scheduler=scheduler, overwrite=overwrite)
    result = make_many(name.value, len(plan), make)
    found = adaptation.scores(result.table().to_pylist())
    if missing:
        complain(f"{Path(model).stem} cannot have {', '.join(missing)}: left out", "warning")
    if as_json:
        print_json({"runs": len(plan), "left_out": missing, "scores": adaptation.as_json(found)})
        return
    groups = dict.fromkeys(score.fault for score in found)
    for fault in groups if by_fault else ("all",):
        lines = [adaptation.cells(score) for score in found if score.fault == fault]
        table = plain_table(adaptation.HEAD, lines)
        table.title, table.title_justify = "all faults" if fault == "all" else fault, "left"
        print_wide(table)
    tell(f"{len(plan)} runs in {out}")


def verify(as_json: Json = False) -> None:
    """Checks the physics against closed forms and recordings; status 1 where a check fails."""
    verification = _from_clone("benchmarks.verification")
    if as_json:
        found = verification.checks_as_json()
        print_json(found)
        passed = found["passed"]
    else:
        passed = verification.verify()
    if not passed:
        raise typer.Exit(FAILED)
