"""Folders of runs, one a controller, made in parallel and kept where they are whole."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

from joblib import Parallel, delayed
from joblib.externals.loky import get_reusable_executor

from leglab.control import controller_names
from leglab.errors import LeglabError, unknown_name
from leglab.report.run_folder import check_folder, write_run
from leglab.runner import RunSettings, run_scenario
from leglab.scenario import get_scenario
from leglab.sweep import fingerprint, interrupts_ignored

# Told after each run: how many are done, how many there are, what was run.
Progress = Callable[[int, int, str], None]

_FILES = ("metrics.json", "run.json", "recording.parquet")


def check_settings(runs: Sequence[RunSettings]) -> None:
    """Refuses what cannot be run before anything is.

    Raises:
        LeglabError: A controller, the scenario or one of its options is not known or not allowed,
            or a controller is given twice.
    """
    if not runs:
        raise LeglabError("no controllers to run; give one or more")
    seen = set()
    for run in runs:
        if run.controller not in controller_names():
            raise unknown_name("controller", run.controller, controller_names())
        if run.controller in seen:
            raise LeglabError(f"controllers: {run.controller!r} is given twice")
        seen.add(run.controller)
        get_scenario(
            run.scenario,
            duration=run.duration,
            severity=run.severity,
            ramp_duration=run.ramp_duration,
        )


def make_runs(
    runs: Sequence[RunSettings],
    folder: Path,
    *,
    jobs: int = -1,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> list[Path]:
    """Makes the folders of runs that are not there yet.

    A folder is there as a whole or not at all, so the same call goes on where it was interrupted.
    A folder counts only with the same settings and the same code, as `leglab.sweep.run_all` has
    it; another one is replaced.

    Args:
        runs: What to run, each with another controller.
        folder: Where the folders lie, each with the name of its controller.
        jobs: Processes at a time; -1 is one a core.
        overwrite: Whether to repeat runs that are there.
        progress: Called after each run.

    Returns:
        The folders in the order of the runs.

    Raises:
        LeglabError: As `check_settings`, a run cannot be set up, or a folder cannot be written
            or holds something other than a run.
        KeyboardInterrupt: The user interrupts; finished runs are kept.
    """
    check_settings(runs)
    code = fingerprint()
    folders = [folder / run.controller for run in runs]
    todo = [
        (run, place)
        for run, place in zip(runs, folders, strict=True)
        if overwrite or not _is_made(run, place, code)
    ]
    for _, place in todo:
        check_folder(place, overwrite=True)
    done = len(runs) - len(todo)
    if progress:
        progress(done, len(runs), "")
    if todo:
        worker = Parallel(
            n_jobs=min(jobs, len(todo)), return_as="generator_unordered", batch_size=1
        )
        try:
            with interrupts_ignored():
                labels = worker(delayed(_make)(run, place, code) for run, place in todo)
            for label in labels:
                done += 1
                if progress:
                    progress(done, len(runs), label)
        except KeyboardInterrupt:
            get_reusable_executor().shutdown(wait=False, kill_workers=True)
            raise
    return folders


def _asked(settings: RunSettings) -> dict:
    """The settings as they come back from a file."""
    return json.loads(json.dumps(asdict(settings)))


def _is_made(settings: RunSettings, folder: Path, code: str) -> bool:
    if not all((folder / name).is_file() for name in _FILES):
        return False
    try:
        stored = json.loads((folder / "run.json").read_text())
    except (OSError, ValueError):
        return False
    if not isinstance(stored, dict):
        return False
    return stored.get("asked") == _asked(settings) and stored.get("code") == code


def _make(settings: RunSettings, folder: Path, code: str) -> str:
    """Makes a run, in a process of its own unless there is one job only, and says what it was."""
    run = run_scenario(settings)
    if run.history.failure.startswith("interrupted"):
        raise KeyboardInterrupt
    run = replace(run, configuration={**run.configuration, "asked": _asked(settings), "code": code})
    write_run(run, folder, overwrite=True, figures=False)
    return f"{settings.scenario} · {settings.controller}"
