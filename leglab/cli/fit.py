"""`leglab fit`: parameters of the user's choice, from recordings."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from leglab.base.output import check_apart, check_folder, new_folder, piece
from leglab.cli.diagnose import show_diagnosis
from leglab.cli.options import (
    Columns,
    FixBase,
    From,
    HeldOut,
    Json,
    Load,
    Overwrite,
    Recordings,
    Salvage,
    To,
    check_order,
)
from leglab.cli.terminal import print_json, progress, read_and_warn


def fit(
    model: Annotated[str, typer.Argument(help="Machine.")],
    recordings: Recordings,
    parameter: Annotated[
        list[str],
        typer.Option(
            metavar="ELEMENT:NAME[=LOWER:UPPER]",
            help="Parameter to fit, with bounds in SI units, repeatable; names are those of "
            "docs/reference/effect_table.md.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="Output folder.")] = Path("out/fit"),
    held_out: HeldOut = None,
    columns: Columns = None,
    since: From = None,
    until: To = None,
    salvage: Salvage = False,
    fix_base: FixBase = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
    load: Load = None,
) -> None:
    """Fits parameters that you choose to measured recordings; nothing is searched or named.

    Writes diagnosis.json with estimates and covariance, improved.xml, figures and a page.
    """
    from leglab.diagnosis.fit import Wanted
    from leglab.diagnosis.fit import fit as run_fit
    from leglab.diagnosis.intake.recordings import split_held_out
    from leglab.diagnosis.plant.model import Machine
    from leglab.diagnosis.verdict import output as results
    from leglab.report.diagnosis.page import write_page

    check_order(model, recordings)
    wanted = [Wanted.parse(text) for text in parameter]
    check_folder(out, overwrite=overwrite, mark="diagnosis.json")
    check_apart(out, [Path(model), *recordings])
    found = read_and_warn(recordings, columns=columns, span=(since, until), salvage=salvage)
    machine = Machine(model, fix_base=fix_base)
    named, held = split_held_out(machine, found, held_out or [])
    made = ("diagnosis.html", "improved.xml", "figures")
    with new_folder(out, mark="diagnosis.json", made=made, overwrite=overwrite) as folder:
        with progress("fit") as show:
            fitted = run_fit(
                machine,
                named,
                wanted,
                held_out=held,
                progress=lambda line: show(description=line),
            )
        result = fitted.result
        with piece("improved.xml", result.missing):
            path, lines = results.write_model(fitted.problem, fitted.hypothesis, folder)
            result = replace(result, model=path.name, changed=lines)
        with piece("diagnosis.html", result.missing):
            write_page(result, folder, model=Path(model).stem)
        results.write_diagnosis(result, folder)
    if as_json:
        print_json(result.to_json(), ascii_only=False)
        return
    show_diagnosis(result, out)
