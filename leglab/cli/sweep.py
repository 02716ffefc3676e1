"""The commands `leglab sweep` and `leglab query`: many runs from a file, and questions to them."""

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from leglab.base.errors import SettingsError
from leglab.cli import options, terminal


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
    from leglab.runs.sweeps.engine import record_runs, run_sweep
    from leglab.runs.sweeps.plan import read_plan

    options.check_jobs(workers, "workers")
    plan = read_plan(file)
    if record:
        made = partial(record_runs, plan, out, record)
        places = terminal.make_many("recording", len(record), made)
        if as_json:
            terminal.print_json({"folders": [str(place) for place in places]})
        for place in places if not as_json else ():
            terminal.tell(f"written to {place}")
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
    found = result.tuned() if plan.tuned else []
    written = None
    if report:
        from leglab.report.sweep.page import write_sweep_page

        with terminal.progress("writing"):
            written = write_sweep_page(out)
    if as_json:
        content = {
            "folder": str(out),
            "runs": len(plan),
            "made": result.made,
            "done": result.done,
            "failed": result.failed,
            "page": None if written is None else str(written),
            "tuned": [asdict(one) for one in found],
        }
        terminal.print_json(content)
    else:
        again = result.done - result.made
        there = f", {again} were there" if again else ""
        terminal.tell(f"{result.made} of {len(plan)} runs made{there}; written to {written or out}")
        for one in found:
            terminal.tell(str(one))
    if result.failed:
        terminal.complain(
            f"{result.failed} of {len(plan)} runs failed; leglab query {out} "
            "\"SELECT failure, count(*), any_value(error) FROM runs WHERE status = 'failed' "
            'GROUP BY failure" tells why, --retry-failed makes them again',
            "warning",
        )
    if result.failed == len(plan):
        raise typer.Exit(terminal.FAILED)


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
