"""Speed and accuracy beside their peers, in one go: `python -m benchmarks bench`.

Peers are padasip, river, SysIdentPy, NumPy, SciPy, mujoco.sysid, dm_control, Gymnasium and bare
MuJoCo. Interrupted, it goes on; what is not installed is left out and named.
"""

import json
import sys
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.suite import history, suite
from benchmarks.suite.page import HEAD, page, summary
from leglab.base.errors import SettingsError
from leglab.base.output import claimed_folder, write_atomically
from leglab.cli.conventions import execute
from leglab.cli.options import Json
from leglab.cli.terminal import (
    FAILED,
    complain,
    make_many,
    plain_table,
    print_json,
    print_wide,
    progress,
    tell,
)


def bench(
    part: Annotated[
        list[str] | None, typer.Option(help="Benchmark; repeatable; default: all.")
    ] = None,
    repeat: Annotated[int, typer.Option(help="Times that each is run.")] = 3,
    quick: Annotated[
        bool, typer.Option("--quick", help="Few samples: for a look, not to be kept.")
    ] = False,
    stored: Annotated[
        bool, typer.Option("--stored", help="Measure nothing: take what docs/data keeps.")
    ] = False,
    keep: Annotated[
        bool, typer.Option("--keep", help="Add the ratios to docs/data/bench_history.jsonl.")
    ] = False,
    check: Annotated[
        bool,
        typer.Option("--check", help="Status 1 where a ratio is 10 % worse than the kept ones."),
    ] = False,
    out: Annotated[Path, typer.Option(help="Folder of bench.json and bench.html.")] = Path(
        "out/bench"
    ),
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Repeat what the folder holds.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Measures speed and accuracy beside their peers, and writes a page."""
    if not 1 <= repeat <= 100:
        raise SettingsError(f"repeat is {repeat}; allowed: ", given=repeat, allowed="1 to 100")
    if quick and keep:
        raise SettingsError("--keep is for figures of whole measurements; here it is with --quick")
    parts = suite.chosen_parts(part)
    with claimed_folder(out):
        if stored:
            measured = suite.stored(parts)
        else:
            make = partial(
                suite.measure, parts, out, repeat=repeat, quick=quick, overwrite=overwrite
            )
            measured = make_many("measuring", repeat * len(parts), make)
        found, entries = suite.values(measured), history.read_history()
        here = history.this_machine()
        content = suite.as_json(measured, found)
        with progress("writing"):
            text = json.dumps(content, indent=1, allow_nan=False) + "\n"
            write_atomically(out / "bench.json", lambda stream: stream.write(text.encode()))
            shown = page(measured, found, entries, here)
            write_atomically(out / "bench.html", lambda stream: stream.write(shown.encode()))
    for one in {m.part: m for m in measured if m.problem}.values():
        complain(f"{one.part} is not measured: {one.problem}", "warning")
    if keep:
        place = history.add(history.entry_of(measured, found))
    if as_json:
        print_json(content)
    else:
        print_wide(plain_table(HEAD, summary(found, entries, here)))
        tell(f"written to {out / 'bench.html'}" + (f", kept in {place}" if keep else ""))
    if check:
        lines = history.worse(found, entries, here)
        for line in lines:
            complain(line)
        if lines or not found:
            raise typer.Exit(FAILED)


def main(arguments: list[str] | None = None) -> None:
    """Measures, or shows what is kept; errors are one line."""
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command()(bench)
    execute(app, sys.argv[1:] if arguments is None else arguments)


if __name__ == "__main__":
    main()
