"""The page of one run or several, and its film."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from leglab.base.errors import FileError, LeglabError
from leglab.base.output import cannot_write, claimed_folder
from leglab.report.film.encoder import film_bytes, still_bytes
from leglab.report.page.shell import asset, inlined, render, write_page
from leglab.report.page.wording import listed
from leglab.report.run import tables, words
from leglab.report.run.plots import plot_data
from leglab.report.style import SERIES
from leglab.runs.folder import ReportedRun

PAGE, FILM = "report.html", "report.mp4"

# Maximum size of a page, for which its film is re-encoded with fewer bits, and minimum size that is
# left to the film even if the page becomes larger [bytes].
_LARGEST, _FILM_LEAST = 14_500_000, 2_000_000

# Function that writes a film to the given path and returns the path of the film.
Filmer = Callable[[Path], Path]


@dataclass(frozen=True, kw_only=True)
class Report:
    """Files of a report."""

    page: Path
    film: Path | None  #: None if there is no film
    why_no_film: str = ""  #: Why a requested film is missing; else empty


def check_out(folder: Path, *, overwrite: bool) -> None:
    """Raises an error if a report cannot be written to a folder, before any work is done.

    Raises:
        LeglabError: The folder has a report that must not be replaced, or the path is no folder.
    """
    if folder.exists() and not folder.is_dir():
        raise FileError(f"{str(folder)!r} is not a folder", given=folder)
    if (folder / PAGE).exists() and not overwrite:
        text = f"{str(folder / PAGE)!r} exists; remove it or give --overwrite"
        raise FileError(text, given=folder / PAGE)


def write_report(
    runs: Sequence[ReportedRun],
    folder: Path,
    *,
    filmer: Filmer | None,
    workplace: Path | None = None,
) -> Report:
    """Writes `report.html` and `report.mp4`: moves them into place when both are complete.

    Args:
        runs: Runs from `read_runs`.
        folder: Folder to write to, made if missing. An earlier report is replaced.
        filmer: Draws the film; None for a page without film. If it fails with `LeglabError`, the
            page gives the reason. Without a new film, an earlier film is deleted.
        workplace: Result of `claimed_folder`, if the caller has already claimed the folder.

    Raises:
        LeglabError: The folder cannot be written to, or another process writes to it.
    """
    if workplace is None:
        with claimed_folder(folder) as own:
            return write_report(runs, folder, filmer=filmer, workplace=own)
    film, why_no_film = None, ""
    if filmer is not None:
        try:
            film = filmer(workplace / FILM)
        except LeglabError as error:
            why_no_film = str(error)
    write_page(page(runs, film=film, no_film=why_no_film), workplace / PAGE)
    try:
        if film is None:
            (folder / FILM).unlink(missing_ok=True)
        else:
            os.replace(film, folder / FILM)
        os.replace(workplace / PAGE, folder / PAGE)
    except OSError as error:
        raise cannot_write(folder, error) from error
    shown = None if film is None else folder / FILM
    return Report(page=folder / PAGE, film=shown, why_no_film=why_no_film)


def page(runs: Sequence[ReportedRun], *, film: Path | None = None, no_film: str = "") -> str:
    """Returns the page as one file that loads no other.

    Args:
        runs: Runs from `read_runs`.
        film: Film to embed into the page.
        no_film: Why there is no film.
    """
    joints = tuple(dict.fromkeys(joint for run in runs for joint in run.joints))
    # The page opens with the joint that has the largest error.
    shared = [joint for joint in joints if all(joint in run.joints for run in runs)] or joints
    worst = {j: max(run.last.rms_rad.get(j, 0.0) for run in runs) for j in shared}
    from plotly.offline import get_plotlyjs  # slow to import

    content: dict[str, Any] = {
        "scripts": (get_plotlyjs(), asset("report.js")),
        "title": words.title(runs),
        "headline": words.headline(runs),
        "sections": words.sections(runs),
        "labels": [run.label for run in runs],
        "colors": len(SERIES),
        "bars": tables.error_bars(runs),
        "table": tables.run_table(runs),
        "joint_tables": tables.joint_tables(runs),
        "setting_tables": tables.setting_tables(runs),
        "joints": joints,
        "plot_data": plot_data(runs, joints, joints.index(max(shared, key=worst.__getitem__))),
        "film_file": FILM,
    }
    fill = partial(render, "report.html", kind="report", **content)
    if film is None:
        return fill(film={"text": no_film or "none was asked for.", "data": None})
    part = {"text": _description(runs), "data": "", "still": inlined(still_bytes(film))}
    most = max(_FILM_LEAST, (_LARGEST - len(fill(film=part).encode())) * 3 // 4)
    return fill(film={**part, "data": inlined(film_bytes(film, most))})


def _description(runs: Sequence[ReportedRun]) -> str:
    """Describes the film for readers who cannot see it."""
    run = runs[0]
    places = listed(tuple(run.label for run in runs)) + ", side by side" * (len(runs) > 1)
    changes = listed(tuple(words.change_words(c) for c in run.configuration.changes))
    what = f" What happens to the machine is written into the picture: {changes}." * bool(changes)
    return (
        f"The {run.metrics.model} follows {run.setting('reference')} under {places}; a curve below "
        f"the picture shows the RMS tracking error up to each moment.{what} It has no sound."
    )
