"""The commands `leglab report`, `leglab index` and `leglab video`: pages and films of runs."""

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from leglab.base.errors import LeglabError, SettingsError
from leglab.base.output import claimed_folder
from leglab.cli.options import Camera, Jobs, Json, Load, check_jobs, split
from leglab.cli.terminal import (
    complain,
    make_many,
    output,
    print_json,
    progress,
    tell,
    tell_of_models,
)

if TYPE_CHECKING:
    from leglab.report.run.page import Filmer, Report
    from leglab.runs.folder import ReportedRun


def report(
    folders: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Folders of runs, side by side on one page; or that of a sweep or a comparison."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Output folder; default: the run's own, or out/report for several."),
    ] = None,
    video: Annotated[bool, typer.Option(help="Film the runs.")] = True,
    films: Annotated[
        int | None, typer.Option(help="Of a sweep: how many of its worst runs; default: 3.")
    ] = None,
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
        float | None, typer.Option(help="With --scenario: size of the change, in its own unit.")
    ] = None,
    element: Annotated[
        str | None, typer.Option(help="With --scenario: joint to which it happens alone.")
    ] = None,
    tolerance: Annotated[
        float | None, typer.Option(help="With --scenario: of the machine, as for run; default: 0.")
    ] = None,
    vary: Annotated[
        bool, typer.Option("--vary", help="With --scenario: the seed draws time and phase.")
    ] = False,
    jobs: Jobs = -1,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace a report; with --scenario repeat its runs.")
    ] = False,
    as_json: Json = False,
    load: Load = None,
) -> None:
    """Writes one page about runs: words, numbers, film and plots in one file.

    Give the folders of runs, or a scenario: its runs are made below OUT/runs, and a run that is
    there with the same settings, code and model is kept. Writes report.html, which needs no other
    file, and report.mp4. The page of a sweep has heat maps and the worst runs, with films of the
    first; that of a comparison its table, intervals as figures and every run.
    """
    from leglab.report.run.page import check_out, write_report
    from leglab.runs.comparison import is_comparison
    from leglab.runs.folder import check_runs, check_settings, make_runs, read_runs
    from leglab.runs.preparation import RunSettings
    from leglab.runs.sweeps.store import is_sweep

    every: dict[str, Any] = {
        "model": model,
        "reference": reference,
        "seed": seed,
        "severity": severity,
        "element": element,
        "tolerance": tolerance,
        "vary": vary or None,
    }
    own = {name: value for name, value in every.items() if value is not None}
    shown: dict[str, Any] = {"start": start, "duration": duration, "camera": camera}
    if folders and len(folders) == 1 and is_sweep(folders[0]):
        count = (3 if films is None else films) if video else 0
        _report_sweep(folders[0], out, count, shown, overwrite=overwrite, as_json=as_json)
        return
    if folders and len(folders) == 1 and is_comparison(folders[0]):
        _report_comparison(folders[0], out, overwrite=overwrite, as_json=as_json)
        return
    if folders and len(folders) == 1 and (page := folders[0] / "diagnosis.html").is_file():
        if as_json:
            print_json({"page": str(page)})
        else:
            tell(f"{page} is the page of this diagnosis; leglab diagnose has written it")
        return
    if films is not None:
        raise SettingsError("--films is for the page of a sweep; a page of runs has one film")
    if scenario is None:
        given = ["controllers", *own] if controllers is not None else list(own)
        if given:
            option = f"--{given[0]}"
            raise SettingsError(f"{option} says what to run: it needs --scenario", given=option)
        if not folders:
            raise SettingsError("report needs the folder of at least one run, or --scenario")
        place = out or (folders[0] if len(folders) == 1 else Path("out/report"))
        check_out(place, overwrite=overwrite)
        check_runs(folders)
    else:
        if folders:
            raise SettingsError("report takes folders of runs or --scenario, not both")
        check_jobs(jobs)
        place, shown["duration"] = out or Path("out/report"), None
        check_out(place, overwrite=True)
        common = RunSettings(scenario=scenario, duration=duration, **own)
        names = split(controllers or "pd,static_feedforward")
        settings = [replace(common, controller=name) for name in names]
        check_settings(settings)
        places = [place / "runs" / run.controller for run in settings]
        make = partial(make_runs, settings, places, jobs=jobs, overwrite=overwrite)
        made = partial(make_many, "running", len(settings), make)
    with claimed_folder(place) as workplace:
        runs = read_runs(made() if scenario else folders or ())
        if video:
            tell_of_models(folders or ())
        with progress("filming" if video else "writing", 1.0) as show:

            def film(path: Path) -> Path:
                from leglab.report.film import render_film

                return render_film(
                    [run.folder for run in runs],
                    path,
                    **shown,
                    progress=lambda share: show(completed=share),
                )

            filmer: Filmer | None = film if video else None
            written = write_report(runs, place, filmer=filmer, workplace=workplace)
    _tell(runs, written, as_json=as_json)


def _report_sweep(
    folder: Path,
    out: Path | None,
    count: int,
    shown: dict[str, Any],
    *,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Writes the page of a sweep with films of its `count` worst runs; `shown` are film options."""
    from leglab.report.run.page import PAGE, check_out
    from leglab.report.sweep.facts import MOST_FILMS
    from leglab.report.sweep.films import film_runs
    from leglab.report.sweep.page import worst_runs, write_sweep_page

    if not 0 <= count <= MOST_FILMS:
        told = f"films is {count}; allowed: "
        raise SettingsError(told, given=count, allowed=f"0 to {MOST_FILMS}")
    place = out or folder
    check_out(place, overwrite=overwrite)
    films: dict[int, Path] = {}
    with claimed_folder(place) if out else nullcontext():
        if numbers := worst_runs(folder, count):
            with progress("filming", 1.0) as show:
                try:
                    films = film_runs(
                        folder,
                        numbers,
                        place,
                        **shown,
                        progress=lambda share: show(completed=share),
                    )
                except LeglabError as error:  # The page is useful without films.
                    complain(f"no films: {error}", "warning")
        with progress("writing"):
            written = write_sweep_page(folder, place / PAGE, films=films)
    _tell_page(written, as_json=as_json, films=[str(film) for film in films.values()])


def _report_comparison(folder: Path, out: Path | None, *, overwrite: bool, as_json: bool) -> None:
    from leglab.report.comparison.page import write_comparison_page
    from leglab.report.run.page import PAGE, check_out

    place = out or folder
    check_out(place, overwrite=overwrite)
    with claimed_folder(place), progress("writing"):
        written = write_comparison_page(folder, place / PAGE)
    _tell_page(written, as_json=as_json)


def _tell_page(written: Path, *, as_json: bool, **more: Any) -> None:
    if as_json:
        print_json({"page": str(written), **more})
    else:
        tell(f"written to {written}")


def _tell(runs: Sequence["ReportedRun"], written: "Report", *, as_json: bool) -> None:
    from leglab.report.run.words import headline

    for run in runs:
        if not run.metrics.completed:
            reason = run.metrics.failure or "no reason was stored"
            complain(f"{run.label} stopped early: {reason}", "warning")
    if written.why_no_film:
        complain(f"no film: {written.why_no_film}", "warning")
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
                    "adaptation": run.metrics.adaptation.model_dump(),
                }
                for run in runs
            ],
        }
        print_json(content)
        return
    output.print(headline(runs), markup=False, highlight=False)
    tell(f"written to {written.page}")


def index(
    folder: Annotated[Path, typer.Argument(help="Folder below which runs lie.")],
    out: Annotated[Path | None, typer.Option(help="Page; default FOLDER/index.html.")] = None,
    as_json: Json = False,
) -> None:
    """Writes a page that lists runs, reports, comparisons, sweeps and diagnoses below a folder."""
    from leglab.report.folder_index import write_index

    entries, page = write_index(folder, out or folder / "index.html")
    broken = sum(entry.state == "broken" for entry in entries)
    if broken:
        complain(f"{broken} of {len(entries)} cannot be read", "warning")
    if as_json:
        print_json([asdict(entry) for entry in entries])
        return
    tell(f"{len(entries)} listed in {page}")


def video(
    folders: Annotated[list[Path], typer.Argument(help="Folders of one to four runs.")],
    out: Annotated[
        Path | None,
        typer.Option(help="MP4 file; default FOLDER/video.mp4, of several runs ./video.mp4."),
    ] = None,
    start: Annotated[float | None, typer.Option(help="First second shown.")] = None,
    duration: Annotated[float | None, typer.Option(help="Seconds shown; default: all.")] = None,
    camera: Camera = "three_quarter",
    as_json: Json = False,
    load: Load = None,
) -> None:
    """Renders runs side by side to MP4, headless, with EGL or OSMesa."""
    from leglab.report.film import FRAME_RATE, SIZE, render_film

    path = out or (folders[0] / "video.mp4" if len(folders) == 1 else Path("video.mp4"))
    tell_of_models(folders)
    with progress("rendering", 1.0) as show:
        render_film(
            folders,
            path,
            start=start,
            duration=duration,
            camera=camera,
            progress=lambda share: show(completed=share),
        )
    if as_json:
        content = {
            "film": str(path),
            "runs": [str(folder) for folder in folders],
            "size": list(SIZE),
            "frame_rate": FRAME_RATE,
            "bytes": path.stat().st_size,
        }
        print_json(content)
    else:
        tell(f"written to {path}")
