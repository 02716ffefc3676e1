"""Folders of runs as a report reads them; what they hold may come from anywhere."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, Field, FiniteFloat, StringConstraints, ValidationError

from leglab import data
from leglab.errors import LeglabError
from leglab.recording import Recording

Name = Annotated[str, StringConstraints(min_length=1, max_length=500)]
ByJoint = dict[str, FiniteFloat]
_Content = TypeVar("_Content", bound=BaseModel)


class PhaseMetrics(BaseModel):
    """One phase of `metrics.json`; see `leglab.metrics.phase_table` and `usage_table`."""

    name: Name
    start: FiniteFloat
    end: FiniteFloat
    rms_rad: ByJoint
    peak_rad: ByJoint
    p95_rad: ByJoint = {}
    effort: ByJoint = {}
    energy_j: ByJoint = {}


class ReadaptationMetrics(BaseModel):
    """See `leglab.metrics.Readaptation`."""

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
    """A parameter that changes; see `leglab.schedule.ParameterChange`."""

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
