"""The commands `leglab sweep` and `leglab query`: many runs from a file, and questions to them."""

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from leglab.base.errors import SettingsError
from leglab.cli import options, terminal

if TYPE_CHECKING:
    from leglab.runs.sweeps.engine import SweepResult
    from leglab.runs.sweeps.plan import SweepPlan


def sweep(
    file: Annotated[
        Path, typer.Argument(help="TOML file: what is varied, and how; or a sweep.json.")
    ],
    out: Annotated[Path, typer.Option(help="Folder of the dataset.")],
    workers: options.Jobs = -1,
    scheduler: options.Scheduler = None,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Make runs that failed again.")
    ] = False,
    overwrite: options.ReplaceSweep = False,
    record: Annotated[
        list[int] | None,
        typer.Option(
            help="Make nothing but the folder of the run of this number, with its recording, below "
            "OUT/recordings; repeatable."
        ),
    ] = None,
    report: Annotated[
        bool, typer.Option("--report", help="Write OUT/report.html at the end.")
    ] = False,
    as_json: options.Json = False,
    load: options.Load = None,
) -> None:
    """Makes all runs of a sweep that its folder does not hold yet.

    One row a run is kept in Parquet files below OUT/runs, failed runs included. Interrupted or
    killed, the same command makes exactly the runs that are missing. `leglab query` asks the rows.
    """
    from leglab.runs.sweeps.engine import run_sweep
    from leglab.runs.sweeps.plan import read_plan

    options.check_jobs(workers, "workers")
    plan = read_plan(file)
    if record:
        _record(plan, out, record, as_json=as_json)
        return
    make = partial(
        run_sweep,
        plan,
        out,
        workers=workers,
        scheduler=scheduler,
        retry_failed=retry_failed,
        overwrite=overwrite,
    )
    result = terminal.make_many("sweeping", len(plan), make)
    for line in result.damaged:
        terminal.complain(line, "warning")
    written = None
    if report:
        from leglab.report.sweep.page import write_sweep_page

        with terminal.progress("writing"):
            written = write_sweep_page(out)
    _show(result, written, as_json=as_json)
    if result.failed == len(plan):
        raise typer.Exit(terminal.FAILED)


def _record(plan: "SweepPlan", out: Path, numbers: list[int], *, as_json: bool) -> None:
    """Makes the folders of the runs of these numbers, with recordings, and tells which."""
    from leglab.runs.sweeps.engine import record_runs

    make = partial(record_runs, plan, out, numbers)
    places = [str(place) for place in terminal.make_many("recording", len(numbers), make)]
    lines = "\n".join(f"written to {place}" for place in places)
    terminal.tell_or_print(lines, {"folders": places}, as_json=as_json)


def _show(result: "SweepResult", page: Path | None, *, as_json: bool) -> None:
    """Tells how many runs of a sweep were made and have failed, and what was tuned."""
    count, found = len(result.plan), result.tuned() if result.plan.tuned else []
    again = result.done - result.made
    there = f", {again} were there" if again else ""
    text = f"{result.made} of {count} runs made{there}; written to {page or result.folder}"
    content = {
        "folder": str(result.folder),
        "runs": count,
        "made": result.made,
        "done": result.done,
        "failed": result.failed,
        "page": None if page is None else str(page),
        "tuned": [asdict(one) for one in found],
    }
    terminal.tell_or_print("\n".join([text, *map(str, found)]), content, as_json=as_json)
    if result.failed:
        terminal.complain(
            f"{result.failed} of {count} runs failed; leglab query {result.folder} "
            "\"SELECT failure, count(*), any_value(error) FROM runs WHERE status = 'failed' "
            'GROUP BY failure" tells why, --retry-failed makes them again',
            "warning",
        )


def query(
    folder: Annotated[Path, typer.Argument(help="Folder of a sweep.")],
    sql: Annotated[str, typer.Argument(help="A SELECT of the table `runs`, in DuckDB's SQL.")],
    csv: Annotated[
        Path | None, typer.Option(help="Write the result to this CSV file; -: print it.")
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Answers a question to the rows of a sweep, also while it is being made.

    The table is called runs: a row a run. Nothing can be changed, and no other file be read.
    """
    from leglab.runs.sweeps.query import ask

    if csv is not None and as_json:
        raise SettingsError("query takes --csv or --json, not both")
    answer = ask(folder, sql)
    if as_json:
        terminal.print_json(answer.records())
    elif csv is not None:
        answer.write_csv(None if str(csv) == "-" else csv)
    else:
        terminal.print_answer(answer.names, answer.cells())
