"""`leglab fit`: parameters of the user's choice, from recordings."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from leglab.base.output import check_apart, check_folder, new_folder, piece
from leglab.cli import options
from leglab.cli.diagnose import MADE, MARK, show_diagnosis, write_diagnosis
from leglab.cli.terminal import read_and_warn, told_stages


def fit(
    model: options.MachineArgument,
    recordings: options.Recordings,
    parameter: Annotated[
        list[str],
        typer.Option(
            metavar="ELEMENT:NAME[=LOWER:UPPER]",
            help="Parameter to fit, with bounds in SI units, repeatable; names are those of "
            "docs/reference/effect_table.md.",
        ),
    ],
    out: options.Out = Path("out/fit"),
    held_out: options.HeldOut = None,
    columns: options.Columns = None,
    since: options.From = None,
    until: options.To = None,
    salvage: options.Salvage = False,
    fix_base: options.FixBase = False,
    overwrite: options.Overwrite = False,
    as_json: options.Json = False,
    load: options.Load = None,
) -> None:
    """Fits parameters that you choose to measured recordings; nothing is searched or named.

    Writes diagnosis.json with estimates and covariance, improved.xml, figures and a page.
    """
    from leglab.diagnosis.fit import Wanted
    from leglab.diagnosis.fit import fit as run_fit
    from leglab.diagnosis.intake.recordings import split_held_out
    from leglab.diagnosis.plant.model import Machine
    from leglab.diagnosis.verdict.output import write_model

    options.check_order(model, recordings)
    wanted = [Wanted.parse(text) for text in parameter]
    check_folder(out, overwrite=overwrite, mark=MARK)
    check_apart(out, [Path(model), *recordings])
    found = read_and_warn(recordings, columns=columns, span=(since, until), salvage=salvage)
    machine = Machine(model, fix_base=fix_base)
    named, held = split_held_out(machine, found, held_out or [])
    with new_folder(out, mark=MARK, made=MADE, overwrite=overwrite) as folder:
        with told_stages("fit") as show:
            fitted = run_fit(machine, named, wanted, held_out=held, progress=show)
        result = fitted.result
        with piece("improved.xml", result.missing):
            path, lines = write_model(fitted.problem, fitted.hypothesis, folder)
            result = replace(result, model=path.name, changed=lines)
        write_diagnosis(result, folder, model)
    show_diagnosis(result, out, as_json=as_json)
