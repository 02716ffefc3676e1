"""The commands `leglab report` and `leglab index`."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from leglab.base.errors import LeglabError
from leglab.cli.options import Camera, Jobs, Json
from leglab.cli.terminal import errors, output, progress_bar

if TYPE_CHECKING:
    from leglab.report.run.page import Filmer, Report
    from leglab.runs.folder import ReportedRun


def report(
    folders: Annotated[
        list[Path] | None, typer.Argument(help="Folders of runs, side by side on one page.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Output folder; default: the run's own, or out/report for several."),
    ] = None,
    video: Annotated[bool, typer.Option(help="Film the runs.")] = True,
    start: Annotated[float | None, typer.Option(help="First second of the film.")] = None,
    duration: Annotated[
        float | None, typer.Option(help="Seconds of the film; with --scenario of the runs.")
    ] = None,
    camera: Camera = "three_quarter",
    scenario: Annotated[
        str | None, typer.Option(help="Run this scenario first, once a controller.")
    ] = None,
    controllers: Annotated[
        str | None,
        typer.Option(help="With --scenario: names, by commas; default pd,static_feedforward."),
    ] = None,
    model: Annotated[str | None, typer.Option(help="With --scenario; default: leg.")] = None,
    reference: Annotated[
        str | None, typer.Option(help="With --scenario; default: the scenario's.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="With --scenario; default: 0.")] = None,
    severity: Annotated[
        float | None, typer.Option(help="With --scenario: how bad the change is, in its own unit.")
    ] = None,
    jobs: Jobs = -1,
    overwrite: Annotated[
        bool,
        typer.Option("--overwrite", help="Replace a report; with --scenario repeat its runs."),
    ] = False,
    as_json: Json = False,
) -> None:
    """Writes one page about runs: words, numbers, film and plots in one file.

    Give the folders of runs, or a scenario: its runs are made below OUT/runs, and a run that is
    there with the same settings and code is kept. Writes report.html, which needs no other file,
    and report.mp4.
    """
    from leglab.report.run.page import check_out, write_report
    from leglab.runs.folder import read_runs

    own = {
        "--controllers": controllers,
        "--model": model,
        "--reference": reference,
        "--seed": seed,
        "--severity": severity,
    }
    if scenario is None:
        given = [name for name, value in own.items() if value is not None]
        if given:
            raise LeglabError(f"{given[0]} says what to run: it needs --scenario")
        if not folders:
            raise LeglabError("report needs the folder of at least one run, or --scenario")
        place = out or (folders[0] if len(folders) == 1 else Path("out/report"))
        check_out(place, overwrite=overwrite)
        span = duration
    else:
        if folders:
            raise LeglabError("report takes folders of runs or --scenario, not both")
        if jobs == 0:
            raise LeglabError("jobs is 0; allowed: 1 or more, or -1 for one a core")
        place, span = out or Path("out/report"), None
        check_out(place, overwrite=True)
        folders = _run(scenario, own, duration, place / "runs", jobs=jobs, overwrite=overwrite)
    runs = read_runs(folders)
    with progress_bar() as bar:
        task = bar.add_task("filming" if video else "writing", total=1.0)

        def film(path: Path) -> Path:
            from leglab.report.film import render_film

            return render_film(
                [run.folder for run in runs],
                path,
                start=start,
                duration=span,
                camera=camera,
                progress=lambda share: bar.update(task, completed=share),
            )

        filmer: Filmer | None = film if video else None
        written = write_report(runs, place, filmer=filmer)
    _tell(runs, written, as_json=as_json)


def _run(
    scenario: str,
    own: dict[str, Any],
    duration: float | None,
    folder: Path,
    *,
    jobs: int,
    overwrite: bool,
) -> list[Path]:
    from leglab.runs.folder import make_runs
    from leglab.runs.run import RunSettings

    names = (own["--controllers"] or "pd,static_feedforward").split(",")
    settings = [
        RunSettings(
            scenario=scenario,
            controller=name.strip(),
            model=own["--model"] or "leg",
            reference=own["--reference"],
            seed=own["--seed"] or 0,
            severity=own["--severity"],
            duration=duration,
        )
        for name in names
        if name.strip()
    ]
    finished = 0
    with progress_bar() as bar:
        task = bar.add_task("running", total=len(settings))

        def show(done: int, total: int, label: str) -> None:
            nonlocal finished
            finished = done
            bar.update(task, completed=done, total=total, description=label or "running")

        try:
            return make_runs(settings, folder, jobs=jobs, overwrite=overwrite, progress=show)
        except KeyboardInterrupt:
            bar.stop()
            errors.print(
                f"[red]interrupted[/red] after {finished} of {len(settings)} runs: "
                "the same command goes on from there"
            )
            raise typer.Exit(130) from None


def _tell(runs: Sequence["ReportedRun"], written: "Report", *, as_json: bool) -> None:
    from leglab.report.run.words import headline

    for run in runs:
        if not run.metrics.completed:
            reason = escape(run.metrics.failure or "no reason was stored")
            errors.print(f"[yellow]warning:[/yellow] {escape(run.label)} stopped early: {reason}")
    if written.why_no_film:
        errors.print(f"[yellow]warning:[/yellow] no film: {escape(written.why_no_film)}")
    if as_json:
        content = {
            "page": str(written.page),
            "film": None if written.film is None else str(written.film),
            "why_no_film": written.why_no_film or None,
            "headline": headline(runs),
            "runs": [
                {
                    "folder": str(run.folder),
                    "label": run.label,
                    "completed": run.metrics.completed,
                    "rms_rad": {p.name: p.rms_rad["all"] for p in run.metrics.phases},
                    "readaptation_s": run.metrics.readaptation.time_s,
                }
                for run in runs
            ],
        }
        typer.echo(json.dumps(content, indent=2))
        return
    output.print(headline(runs), markup=False, highlight=False)
    output.print(f"written to {written.page}", markup=False, soft_wrap=True)


def index(
    folder: Annotated[Path, typer.Argument(help="Folder below which runs lie.")],
    out: Annotated[Path | None, typer.Option(help="Page; default FOLDER/index.html.")] = None,
    as_json: Json = False,
) -> None:
    """Writes a page that lists all runs, reports, comparisons and diagnoses below a folder."""
    from leglab.report.folder_index import write_index

    entries, page = write_index(folder, out or folder / "index.html")
    broken = sum(entry.state == "broken" for entry in entries)
    if broken:
        errors.print(f"[yellow]warning:[/yellow] {broken} of {len(entries)} cannot be read")
    if as_json:
        typer.echo(json.dumps([asdict(entry) for entry in entries], indent=2))
        return
    output.print(f"{len(entries)} listed in {page}", markup=False, soft_wrap=True)
