"""Folders of runs as a report reads them; what they hold may come from anywhere."""

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, TypeVar

from joblib import Parallel, delayed
from joblib.externals.loky import get_reusable_executor
from pydantic import BaseModel, Field, FiniteFloat, StringConstraints, ValidationError

from leglab import data
from leglab.base.errors import LeglabError, unknown_name
from leglab.base.recording import Recording
from leglab.base.scenario import get_scenario
from leglab.control import controller_names
from leglab.runs.preparation import RunSettings
from leglab.runs.run import Run, run_scenario
from leglab.runs.sweep import fingerprint, interrupts_ignored


def check_folder(folder: Path, *, overwrite: bool = False, mark: str = "metrics.json") -> None:
    """Refuses a folder that exists, before any work is done.

    Args:
        folder: Where results shall go.
        overwrite: Whether earlier results may be replaced.
        mark: File by which a folder with earlier results is known.

    Raises:
        LeglabError: If it exists and may not be replaced, or holds something else.
    """
    if not folder.exists():
        return
    if not overwrite:
        raise LeglabError(f"output folder {str(folder)!r} exists; remove it or give --overwrite")
    if not folder.is_dir() or (any(folder.iterdir()) and not (folder / mark).exists()):
        raise LeglabError(f"{str(folder)!r} holds no {mark}: it is left as it is")


def write_run(
    run: Run,
    folder: Path,
    *,
    overwrite: bool = False,
    draw: Callable[[Run, Path], object] | None = None,
) -> Path:
    """Writes `metrics.json`, `run.json` and `recording.parquet`.

    Everything is written beside the folder first and moved at the end: a folder is there as a
    whole or not at all.

    Args:
        run: The run, complete or not.
        folder: Where to; parents are made.
        overwrite: Whether the folder of an earlier run may be replaced.
        draw: Draws plots of the run into a folder, for instance
            `leglab.report.figures.draw_run`.

    Raises:
        LeglabError: If the folder exists or cannot be written.
    """
    check_folder(folder, overwrite=overwrite)
    partial = folder.with_name(f".{folder.name}.partial")
    try:
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        data.write(run.recording, partial / "recording.parquet")
        _write_json(partial / "metrics.json", run.metrics)
        _write_json(partial / "run.json", run.configuration)
        if draw:
            draw(run, partial)
        if folder.exists():
            shutil.rmtree(folder)
        partial.rename(folder)
    except OSError as error:
        raise LeglabError(f"{folder}: cannot be written: {error.strerror}") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return folder


def _write_json(path: Path, content: dict) -> None:
    path.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n")


Name = Annotated[str, StringConstraints(min_length=1, max_length=500)]
ByJoint = dict[str, FiniteFloat]
_Content = TypeVar("_Content", bound=BaseModel)


class PhaseMetrics(BaseModel):
    """One phase of `metrics.json`; see `leglab.runs.metrics.phase_table` and `usage_table`."""

    name: Name
    start: FiniteFloat
    end: FiniteFloat
    rms_rad: ByJoint
    peak_rad: ByJoint
    p95_rad: ByJoint = {}
    effort: ByJoint = {}
    energy_j: ByJoint = {}


class ReadaptationMetrics(BaseModel):
    """See `leglab.runs.metrics.Readaptation`."""

    time_s: FiniteFloat | None = None
    threshold: FiniteFloat | None = None
    reason: str | None = None


class Metrics(BaseModel):
    """What a report needs of `metrics.json`."""

    scenario: Name
    controller: Name
    model: Name
    seed: int
    duration: FiniteFloat
    severity: FiniteFloat | None = None
    completed: bool
    failure: str | None = None
    phases: Annotated[list[PhaseMetrics], Field(min_length=1)]
    readaptation: ReadaptationMetrics
    excess_error_area_rad_s: FiniteFloat | None = None


class Change(BaseModel):
    """A parameter that changes; see `leglab.base.scenario.ParameterChange`."""

    parameter: Name
    element: Name
    kind: Name
    value: FiniteFloat
    start: FiniteFloat
    ramp_duration: FiniteFloat = 0.0


class Configuration(BaseModel):
    """What a report needs of `run.json`."""

    settings: dict[str, Any]
    window: Annotated[FiniteFloat, Field(gt=0)]
    changes: list[Change] = []
    versions: dict[str, str] = {}
    code: str | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class ReportedRun:
    """One run of a report.

    Attributes:
        folder: Where it lies.
        label: What tells it from the others of the report.
        metrics: Content of `metrics.json`.
        configuration: Content of `run.json`.
        recording: Content of `recording.parquet`.
    """

    folder: Path
    label: str
    metrics: Metrics
    configuration: Configuration
    recording: Recording

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints whose tracking was measured."""
        return tuple(name for name in self.metrics.phases[0].rms_rad if name != "all")

    @property
    def planned(self) -> float:
        """How long the run was to last [s]."""
        wanted = self.configuration.settings.get("duration")
        return float(wanted) if isinstance(wanted, int | float) else self.metrics.duration

    @property
    def last(self) -> PhaseMetrics:
        """The phase by which the run is judged: "after" or "whole", or the last it reached."""
        return self.metrics.phases[-1]

    @property
    def before(self) -> PhaseMetrics | None:
        """The phase before the change; None without a change."""
        first = self.metrics.phases[0]
        return first if first.name == "before" else None

    def setting(self, name: str) -> Any:
        """A setting as it was stored; None where it was not."""
        return self.configuration.settings.get(name)


def read_runs(folders: Sequence[Path]) -> tuple[ReportedRun, ...]:
    """Reads the folders of a report.

    Args:
        folders: Of runs that are complete or stopped half way.

    Raises:
        LeglabError: A folder is given twice, is no run, or holds a file that cannot be read or
            does not have the form of a run's; the message names the file and the entry.
    """
    if not folders:
        raise LeglabError("nothing to report: give the folder of at least one run")
    seen: set[Path] = set()
    runs = []
    for folder in folders:
        if folder.resolve() in seen:
            raise LeglabError(f"the folder {str(folder)!r} is given twice")
        seen.add(folder.resolve())
        runs.append(read_run(folder))
    labels = _labels(runs)
    return tuple(
        ReportedRun(
            folder=run.folder,
            label=label,
            metrics=run.metrics,
            configuration=run.configuration,
            recording=run.recording,
        )
        for run, label in zip(runs, labels, strict=True)
    )


def read_run(folder: Path) -> ReportedRun:
    """Reads one folder; its label is the controller's name.

    Raises:
        LeglabError: As `read_runs`.
    """
    for name in ("metrics.json", "run.json", "recording.parquet"):
        if not (folder / name).is_file():
            raise LeglabError(f"{str(folder)!r} is not the folder of a run: it has no {name}")
    metrics = read_metrics(folder)
    configuration = _read(Configuration, folder / "run.json")
    recording = data.read(folder / "recording.parquet")
    joints = [name for name in metrics.phases[0].rms_rad if name != "all"]
    for phase in metrics.phases:
        for key in ("rms_rad", "peak_rad"):
            missing = {*joints, "all"} - getattr(phase, key).keys()
            if missing:
                raise LeglabError(
                    f"{folder / 'metrics.json'}: phase {phase.name!r}: {key} lacks "
                    f"{sorted(missing)[0]!r}"
                )
    for joint in joints:
        for quantity in ("position", "reference"):
            if f"{joint}_{quantity}" not in recording:
                raise LeglabError(
                    f"{folder / 'recording.parquet'}: no column {f'{joint}_{quantity}'!r}"
                )
    return ReportedRun(
        folder=folder,
        label=metrics.controller,
        metrics=metrics,
        configuration=configuration,
        recording=recording,
    )


def read_metrics(folder: Path) -> Metrics:
    """Reads `metrics.json` alone.

    Raises:
        LeglabError: It cannot be read or does not have the form.
    """
    return _read(Metrics, folder / "metrics.json")


def _read(kind: type[_Content], path: Path) -> _Content:
    try:
        return kind.model_validate(json.loads(path.read_bytes()))
    except ValidationError as error:
        problem = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in problem["loc"]) or "content"
        message = problem["msg"][:1].lower() + problem["msg"][1:]
        raise LeglabError(f"{path}: {where}: {message}") from error
    except (OSError, ValueError, RecursionError) as error:
        raise LeglabError(f"{path}: cannot be read: {error}") from error


def _labels(runs: Sequence[ReportedRun]) -> list[str]:
    """The controllers' names with every setting in which runs of one controller differ."""
    labels = [run.metrics.controller for run in runs]
    told = ("scenario", "model", "reference", "severity", "duration", "ramp_duration")
    for name in (*told, "tolerance", "seed"):
        values = [str(run.setting(name)) for run in runs]
        if len(set(labels)) == len(labels):
            return labels
        if len(set(values)) > 1:
            labels = [
                f"{x}, {name.replace('_', ' ')} {v}" for x, v in zip(labels, values, strict=True)
            ]
    if len(set(labels)) < len(labels):
        labels = [f"{x}, {run.folder.name}" for x, run in zip(labels, runs, strict=True)]
    if len(set(labels)) < len(labels):
        labels = [f"{x} ({i + 1})" for i, x in enumerate(labels)]
    return labels


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
    A folder counts only with the same settings and the same code, as `run_all` of
    `leglab.runs.sweep` has it; another one is replaced.

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
    write_run(run, folder, overwrite=True)
    return f"{settings.scenario} · {settings.controller}"
