"""`leglab improve`: a better model from recordings."""

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from leglab.base.output import check_apart, check_folder, new_folder, piece, write_json
from leglab.cli import options
from leglab.cli.terminal import output, print_json, print_table, read_and_warn, told_stages

if TYPE_CHECKING:
    from leglab.diagnosis.improve import Improvement


def improve(
    model: options.MachineArgument,
    recordings: options.Recordings,
    out: options.Out = Path("out/improved"),
    held_out: options.HeldOut = None,
    columns: options.Columns = None,
    since: options.From = None,
    until: options.To = None,
    salvage: options.Salvage = False,
    effects: Annotated[
        bool, typer.Option(help="Look for effects first, and keep those that are sure.")
    ] = True,
    fix_base: options.FixBase = False,
    overwrite: options.Overwrite = False,
    as_json: options.Json = False,
    load: options.Load = None,
) -> None:
    """Improves a model by measured recordings: recalibration, sure effects, a learned remainder.

    Writes improvement.json and, where held-out recordings prove a gain, improved.xml. A remainder
    is a static force of joints, or command offset of cylinders, in `leglab.residual` elements.
    """
    from leglab.diagnosis.improve import improve as run_improvement
    from leglab.diagnosis.intake.recordings import split_held_out
    from leglab.diagnosis.plant.model import Machine

    options.check_order(model, recordings)
    check_folder(out, overwrite=overwrite, mark="improvement.json")
    check_apart(out, [Path(model), *recordings])
    found = read_and_warn(recordings, columns=columns, span=(since, until), salvage=salvage)
    machine = Machine(model, fix_base=fix_base)
    named, held = split_held_out(machine, found, held_out or [])
    made = ("improved.xml",)
    with new_folder(out, mark="improvement.json", made=made, overwrite=overwrite) as partial:
        with told_stages("improvement") as show:
            result, better = run_improvement(
                machine, named, held_out=held, effects=effects, progress=show
            )
        if better is not None:
            with piece("improved.xml", result.missing):
                result = replace(result, model=better.write(partial)[0].name)
        write_json(partial / "improvement.json", result.to_json(), ascii_only=False)
    if as_json:
        print_json(result.to_json(), ascii_only=False)
        return
    output.print(result.words, markup=False, highlight=False)
    print_table(_table(result))
    text = "no improved.xml: no gain on held-out recordings"
    if better is not None:
        place = f"; {out}/improved.xml" if result.model else ""
        text = f"{result.closed_fraction:.0%} of the held-out gap closed{place}"
    for line in (text, *(f"{name} is missing: {why}" for name, why in result.missing.items())):
        output.print(line, markup=False)


def _table(result: "Improvement") -> Table:
    """Builds a table of the replay errors of all recordings before and after the improvement."""
    from leglab.diagnosis.result import shown_unit

    title = f"replay error, RMS before > after; of channels after {result.horizon:.3g} s"
    table = Table(title=title, title_justify="left")
    table.add_column("recording")
    table.add_column("noise levels")
    units = dict.fromkeys(result.units.values())
    for si in units:
        what = "pressures" if si == "Pa" else "positions"
        table.add_column(f"{what} \\[{shown_unit(si)[1]}]")
    table.add_column("")
    for row in result.recordings:
        cells = []
        for si in units:
            errors = [e for c, e in row.at_horizon.items() if result.units[c] == si]
            before, after = (
                shown_unit(si)[0] * math.sqrt(sum(e[k] ** 2 for e in errors) / len(errors))
                for k in (0, 1)
            )
            cells.append(f"{before:.3g} > {after:.3g}")
        before, after = row.noise_levels
        held = "held out" if row.held_out else ""
        table.add_row(row.recording, f"{before:.3g} > {after:.3g}", *cells, held)
    return table
