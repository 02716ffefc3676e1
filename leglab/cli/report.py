"""The commands `leglab report`, `leglab index` and `leglab video`: pages and films of runs."""

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from leglab.base.errors import LeglabError, SettingsError
from leglab.base.output import claimed_folder
from leglab.cli import options, terminal

if TYPE_CHECKING:
    from leglab.report.run.page import Report
    from leglab.runs.folder import ReportedRun

_Folders = Annotated[
    list[Path] | None,
    typer.Argument(
        help="Folders of runs, side by side on one page; or that of a sweep or a comparison."
    ),
]
_Out = Annotated[
    Path | None,
    typer.Option(help="Output folder; default: the run's own, or out/report for several."),
]
_Start = Annotated[float | None, typer.Option(help="First second of the film.")]
_Duration = Annotated[
    float | None, typer.Option(help="Seconds of the film; with --scenario of the runs.")
]
_Films = Annotated[
    int | None, typer.Option(help="Of a sweep: how many of its worst runs; default: 3.")
]
_Scenario = Annotated[str | None, typer.Option(help="Run this scenario first, once a controller.")]
_Controllers = Annotated[
    str | None,
    typer.Option(help="With --scenario: names, by commas; default pd,static_feedforward."),
]
_Model = Annotated[str | None, typer.Option(help="With --scenario; default: leg.")]
_Reference = Annotated[str | None, typer.Option(help="With --scenario; default: the scenario's.")]
_Seed = Annotated[int | None, typer.Option(help="With --scenario; default: 0.")]
_Severity = Annotated[
    float | None, typer.Option(help="With --scenario: size of the change, in its own unit.")
]
_Element = Annotated[
    str | None, typer.Option(help="With --scenario: joint to which it happens alone.")
]
_Tolerance = Annotated[
    float | None, typer.Option(help="With --scenario: of the machine, as for run; default: 0.")
]
_Vary = Annotated[
    bool, typer.Option("--vary", help="With --scenario: the seed draws time and phase.")
]
# Options that say what to run, and need a scenario.
_OF_RUNS = (
    "controllers", "model", "reference", "seed", "severity", "element", "tolerance", "vary",
)  # fmt: skip


def report(
    context: typer.Context,
    folders: _Folders = None,
    out: _Out = None,
    video: Annotated[bool, typer.Option(help="Film the runs.")] = True,
    films: _Films = None,
    start: _Start = None,
    duration: _Duration = None,
    camera: options.Camera = "three_quarter",
    scenario: _Scenario = None,
    controllers: _Controllers = None,
    model: _Model = None,
    reference: _Reference = None,
    seed: _Seed = None,
    severity: _Severity = None,
    element: _Element = None,
    tolerance: _Tolerance = None,
    vary: _Vary = False,
    jobs: options.Jobs = -1,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace a report; with --scenario repeat its runs.")
    ] = False,
    as_json: options.Json = False,
    load: options.Load = None,
) -> None:
    """Writes one page about runs: words, numbers, film and plots in one file.

    Give the folders of runs, or a scenario: its runs are made below OUT/runs, and a run that is
    there with the same settings, code and model is kept. Writes report.html, which needs no other
    file, and report.mp4. The page of a sweep has heat maps and the worst runs, with films of the
    first; that of a comparison its table, intervals as figures and every run.
    """
    from leglab.runs.comparison import is_comparison
    from leglab.runs.sweeps.store import is_sweep

    shown: dict[str, Any] = {"start": start, "duration": duration, "camera": camera}
    only = folders[0] if folders and len(folders) == 1 else None
    if only and is_sweep(only):
        count = (3 if films is None else films) if video else 0
        _report_sweep(only, out, count, shown, overwrite=overwrite, as_json=as_json)
    elif only and is_comparison(only):
        _report_comparison(only, out, overwrite=overwrite, as_json=as_json)
    elif only and (page := only / "diagnosis.html").is_file():
        text = f"{page} is the page of this diagnosis; leglab diagnose has written it"
        terminal.tell_or_print(text, {"page": str(page)}, as_json=as_json)
    else:
        if films is not None:
            raise SettingsError("--films is for the page of a sweep; a page of runs has one film")
        place, make = out or only or Path("out/report"), None
        if scenario is None:
            _check_given(context.params, place)
        else:
            make, shown["duration"] = _maker(context.params, place), None
        _report_runs(folders or [], make, place, shown if video else None, as_json=as_json)


def _of_runs(given: dict[str, Any]) -> dict[str, Any]:
    """Returns those options in `_OF_RUNS` that differ from their defaults, by name."""
    return {k: given[k] for k in _OF_RUNS if given[k] is not None and given[k] is not False}


def _check_given(given: dict[str, Any], place: Path) -> None:
    """Tests that options name folders of runs, and nothing to run, and the folder of the page."""
    from leglab.report.run.page import check_out
    from leglab.runs.folder import check_runs

    if own := _of_runs(given):
        option = f"--{next(iter(own))}"
        raise SettingsError(f"{option} says what to run: it needs --scenario", given=option)
    if not given["folders"]:
        raise SettingsError("report needs the folder of at least one run, or --scenario")
    check_out(place, overwrite=given["overwrite"])
    check_runs(given["folders"])


def _maker(given: dict[str, Any], place: Path) -> Callable[[], list[Path]]:
    """Checks options that say what to run; returns a function that makes the runs' folders."""
    from leglab.report.run.page import check_out
    from leglab.runs.folder import check_settings, make_runs
    from leglab.runs.preparation import RunSettings

    if given["folders"]:
        raise SettingsError("report takes folders of runs or --scenario, not both")
    options.check_jobs(given["jobs"])
    check_out(place, overwrite=True)
    own = _of_runs(given)
    names = options.split(own.pop("controllers", "") or "pd,static_feedforward")
    common = RunSettings(scenario=given["scenario"], duration=given["duration"], **own)
    settings = [replace(common, controller=name) for name in names]
    check_settings(settings)
    places = [place / "runs" / run.controller for run in settings]
    repeat = {"jobs": given["jobs"], "overwrite": given["overwrite"]}
    make = partial(make_runs, settings, places, **repeat)
    return partial(terminal.make_many, "running", len(settings), make)


def _report_runs(
    folders: list[Path],
    make: Callable[[], list[Path]] | None,
    place: Path,
    shown: dict[str, Any] | None,
    *,
    as_json: bool,
) -> None:
    """Writes the page of runs in `folders`, or of those that `make` makes, with a film if `shown`.

    `shown` are options of the film.
    """
    from leglab.report.run.page import write_report
    from leglab.runs.folder import read_runs

    with claimed_folder(place) as workplace:
        runs, filmer = read_runs(make() if make else folders), None
        if shown is not None:
            terminal.tell_of_models(folders)
        with terminal.told_shares("writing" if shown is None else "filming") as show:
            if shown is not None:
                from leglab.report.film import render_film

                filmer = partial(render_film, [run.folder for run in runs], progress=show, **shown)
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
        text = f"films is {count}; allowed: "
        raise SettingsError(text, given=count, allowed=f"0 to {MOST_FILMS}")
    place = out or folder
    check_out(place, overwrite=overwrite)
    films: dict[int, Path] = {}
    with claimed_folder(place) if out else nullcontext():
        if numbers := worst_runs(folder, count):
            with terminal.told_shares("filming") as show:
                try:
                    films = film_runs(folder, numbers, place, **shown, progress=show)
                except LeglabError as error:  # The page is useful without films.
                    terminal.complain(f"no films: {error}", "warning")
        with terminal.progress("writing"):
            written = write_sweep_page(folder, place / PAGE, films=films)
    content = {"page": str(written), "films": [str(film) for film in films.values()]}
    terminal.tell_or_print(f"written to {written}", content, as_json=as_json)


def _report_comparison(folder: Path, out: Path | None, *, overwrite: bool, as_json: bool) -> None:
    from leglab.report.comparison.page import write_comparison_page
    from leglab.report.run.page import PAGE, check_out

    place = out or folder
    check_out(place, overwrite=overwrite)
    with claimed_folder(place), terminal.progress("writing"):
        written = write_comparison_page(folder, place / PAGE)
    terminal.tell_or_print(f"written to {written}", {"page": str(written)}, as_json=as_json)


def _tell(runs: Sequence["ReportedRun"], written: "Report", *, as_json: bool) -> None:
    from leglab.report.run.words import headline

    for run in runs:
        if not run.metrics.completed:
            reason = run.metrics.failure or "no reason was stored"
            terminal.complain(f"{run.label} stopped early: {reason}", "warning")
    if written.why_no_film:
        terminal.complain(f"no film: {written.why_no_film}", "warning")
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
        terminal.print_json(content)
        return
    terminal.output.print(headline(runs), markup=False, highlight=False)
    terminal.tell(f"written to {written.page}")


def index(
    folder: Annotated[Path, typer.Argument(help="Folder below which runs lie.")],
    out: Annotated[Path | None, typer.Option(help="Page; default FOLDER/index.html.")] = None,
    as_json: options.Json = False,
) -> None:
    """Writes a page that lists runs, reports, comparisons, sweeps and diagnoses below a folder."""
    from leglab.report.folder_index import write_index

    entries, page = write_index(folder, out or folder / "index.html")
    broken = sum(entry.state == "broken" for entry in entries)
    if broken:
        terminal.complain(f"{broken} of {len(entries)} cannot be read", "warning")
    text = f"{len(entries)} listed in {page}"
    terminal.tell_or_print(text, [asdict(entry) for entry in entries], as_json=as_json)


def video(
    folders: Annotated[list[Path], typer.Argument(help="Folders of one to four runs.")],
    out: Annotated[
        Path | None,
        typer.Option(help="MP4 file; default FOLDER/video.mp4, of several runs ./video.mp4."),
    ] = None,
    start: Annotated[float | None, typer.Option(help="First second shown.")] = None,
    duration: Annotated[float | None, typer.Option(help="Seconds shown; default: all.")] = None,
    camera: options.Camera = "three_quarter",
    as_json: options.Json = False,
    load: options.Load = None,
) -> None:
    """Renders runs side by side to MP4, headless, with EGL or OSMesa."""
    from leglab.report.film import FRAME_RATE, SIZE, render_film

    path = out or (folders[0] / "video.mp4" if len(folders) == 1 else Path("video.mp4"))
    terminal.tell_of_models(folders)
    with terminal.told_shares("rendering") as show:
        render_film(folders, path, start=start, duration=duration, camera=camera, progress=show)
    content = {
        "film": str(path),
        "runs": [str(folder) for folder in folders],
        "size": list(SIZE),
        "frame_rate": FRAME_RATE,
        "bytes": path.stat().st_size,
    }
    terminal.tell_or_print(f"written to {path}", content, as_json=as_json)
