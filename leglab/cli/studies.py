"""The commands `leglab tune`, `leglab replicate` and `leglab verify`: gains and fixed questions."""

import tomllib
from pathlib import Path
from typing import Annotated

import typer

from leglab.base.output import claimed_folder
from leglab.cli.options import Json, Load, load_plugins
from leglab.cli.terminal import FAILED, errors, output, print_json, progress, tell


def tune(
    models: Annotated[
        list[str] | None,
        typer.Option("--model", help="Repeatable; default: knee_bench, leg, leg_rail."),
    ] = None,
    write: Annotated[bool, typer.Option(help="Write the gains file of the package.")] = False,
    as_json: Json = False,
    load: Load = None,
) -> None:
    """Finds the PD gains that keep 6 dB and 45 degrees of margin on the linearised plant."""
    load_plugins(load)
    from leglab.commissioning.pd_gains import GAINS_FILE, TUNED_MODELS, gains_text

    with progress("tuning") as show:
        text = gains_text(models or list(TUNED_MODELS), lambda label: show(description=label))
    if write:
        GAINS_FILE.write_text(text)
        (errors if as_json else output).print(f"written to {GAINS_FILE}")
    if as_json:
        print_json(tomllib.loads(text))
    elif not write:
        typer.echo(text, nl=False)


def replicate(
    instances: Annotated[int, typer.Option(help="Instances of each model.")] = 100,
    seed: Annotated[int | None, typer.Option(help="Default: the seed of the paper mode.")] = None,
    out: Annotated[Path, typer.Option(help="Folder of page and figures.")] = Path(
        "out/replication"
    ),
    as_json: Json = False,
) -> None:
    """Replicates the BSNN-ARX paper: Table 1, figures, sensitivities, on one page."""
    from leglab.studies.replication import paper
    from leglab.studies.replication import replicate as run_replication

    chosen = paper.SEED if seed is None else seed
    with claimed_folder(out), progress("replicating") as show:
        result = run_replication(
            instances, out, chosen, progress=lambda line: show(description=line)
        )
    if as_json:
        print_json(result.to_json())
        return
    output.print(result.table, soft_wrap=True)
    output.print(f"largest deviation of a validation mean: {result.worst_deviation:.1%}")
    tell(f"written to {result.page}")


def verify(as_json: Json = False) -> None:
    """Checks the physics against closed forms and recordings; status 1 where a check fails."""
    from leglab.studies.verification import checks_as_json
    from leglab.studies.verification import verify as run_checks

    if as_json:
        found = checks_as_json()
        print_json(found)
        passed = found["passed"]
    else:
        passed = run_checks()
    if not passed:
        raise typer.Exit(FAILED)
