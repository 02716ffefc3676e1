"""Folders of runs: default names, writing, and reading with validation of all entries."""

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from leglab import data
from leglab.base.errors import FileError, LeglabError, RecordingError, SettingsError
from leglab.base.input import read_json
from leglab.base.output import cannot_write, check_folder, new_folder, write_json
from leglab.base.recording import Recording
from leglab.jobs.engine import TIMEOUT, Progress, Results, executor, make_missing
from leglab.machine.files import since
from leglab.runs import record
from leglab.runs.preparation import RunSettings, basis_of, check_controllers, prepared, scenario_of
from leglab.runs.record import (
    CONFIGURATION,
    METRICS,
    MODEL,
    RECORDING,
    RUN_FILES,
    RUN_FOLDER,
    PhaseMetrics,
    RunConfiguration,
    RunMetrics,
)
from leglab.runs.run import Result, Run, record_scenario
from leglab.runs.view import draw

# Maximum number of controller, reference and sensor settings that appear in a folder's name.
_MOST_TOLD = 3


def default_folder(settings: RunSettings, *names: str) -> Path:
    """Returns the default folder of a run, named after its settings.

    `runs/SCENARIO-CONTROLLER-MODEL-SEED`, followed by all settings that differ from the default.

    Args:
        settings: Settings of the run.
        names: Name parts for a folder of several runs, in place of the four parts above.
    """
    told = ("scenario", "controller", "model", "seed")
    parts = [settings.scenario, settings.controller, Path(settings.model).stem, str(settings.seed)]
    parts = list(names or parts)
    for field in fields(settings):
        value = getattr(settings, field.name)
        if field.name in told or value == field.default or isinstance(value, Mapping):
            continue
        shown = "" if value is True else value
        if isinstance(value, float):
            shown = f"{value:g}" if float(f"{value:g}") == value else f"{value:.17g}"
        parts.append(value if isinstance(value, str) else f"{field.name}{shown}")
    parts += _told(settings)
    return Path("runs") / "-".join(parts)


def _told(settings: RunSettings) -> list[str]:
    """Returns one name part per controller, reference or sensor setting; a digest if many."""
    own = {
        "controller": settings.controller_config,
        "reference": settings.reference_config,
        "sensors": settings.sensors,
    }
    found = [f"{section}.{k}{v}" for section, each in own.items() for k, v in each.items()]
    if any(not re.fullmatch(r"[\w.+-]{1,40}", text) for text in found) or len(found) > _MOST_TOLD:
        content = json.dumps(own, sort_keys=True, default=str)
        return [f"settings{hashlib.sha256(content.encode()).hexdigest()[:8]}"]
    return found


def write_run(run: Run, folder: Path, *, overwrite: bool = False) -> Path:
    """Writes `metrics.json`, `run.json` and `recording.parquet`.

    The folder is written completely or not at all.

    Args:
        run: The run, complete or not.
        folder: Output folder; parents are created.
        overwrite: Whether the folder of an earlier run may be replaced.

    Raises:
        LeglabError: The folder exists or cannot be written, or another process writes it.
    """
    with new_folder(folder, mark=METRICS, made=RUN_FOLDER, overwrite=overwrite) as partial:
        data.write(run.recording, partial / RECORDING)
        write_result(run, partial)
    return folder


def write_result(run: Result, folder: Path) -> None:
    """Writes `metrics.json`, `run.json` and the model's files into the folder of a recording.

    Args:
        run: The run, complete or not.
        folder: An existing folder.

    Raises:
        LeglabError: A file cannot be written.
    """
    configuration = run.configuration
    if run.files:
        try:
            file = MODEL / run.files.write(folder / MODEL)
        except OSError as error:
            raise cannot_write(folder / MODEL, error) from error
        configuration = configuration.model_copy(update={"model_file": file.as_posix()})
    write_json(folder / METRICS, record.as_json(run.record))
    write_json(folder / CONFIGURATION, record.as_json(configuration))


def model_of(folder: Path, configuration: RunConfiguration) -> str:
    """Returns the model of a run: its name, or the path of the copy in the run's folder."""
    file = configuration.model_file
    return str(configuration.settings["model"]) if file is None else str(folder / file)


def model_note(path: Path) -> str:
    """Returns a warning if the model file has changed since the run; empty otherwise.

    Args:
        path: Path of the `run.json` of the run.

    Raises:
        LeglabError: The file cannot be read.
    """
    found = record.read(RunConfiguration, path)
    if found.model_file is None or found.model_source is None:
        return ""
    source = Path(found.model_source)
    change = since(source, found.model_digest)
    return change and f"{source.name} {change} since this run; the run's own model is used"


@dataclass(frozen=True, kw_only=True, eq=False)
class ReportedRun:
    """One run of a report."""

    folder: Path  #: Folder of the run
    label: str  #: Name that distinguishes it from the other runs of the report
    metrics: RunMetrics  #: Content of `metrics.json`
    configuration: RunConfiguration  #: Content of `run.json`
    recording: Recording  #: Content of `recording.parquet`

    def __repr__(self) -> str:
        return f"ReportedRun({self.metrics.told()}; {self.folder})"

    def _repr_html_(self) -> str:
        return self.metrics.as_html()

    def plot(self) -> list[Any]:
        """Draws the run as `Run.plot` does."""
        return draw(self.recording, self.configuration.changes)

    def to_pandas(self) -> Any:
        """Returns the metrics as `Run.to_pandas` does."""
        return self.metrics.to_pandas()

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints with tracking errors in the metrics."""
        return tuple(name for name in self.metrics.phases[0].rms_rad if name != "all")

    @property
    def planned(self) -> float:
        """Planned duration of the run [s]."""
        wanted = self.configuration.settings.get("duration")
        return float(wanted) if isinstance(wanted, int | float) else self.metrics.duration

    @property
    def last(self) -> PhaseMetrics:
        """Phase by which the run is judged: "after" or "whole", or the last phase it reached."""
        return self.metrics.phases[-1]

    @property
    def before(self) -> PhaseMetrics | None:
        """Phase before the change; None if the scenario has no change."""
        first = self.metrics.phases[0]
        return first if first.name == "before" else None

    @property
    def error(self) -> float:
        """RMS error by which the run is judged [rad]: `end_rad`, or the error of `last` if None."""
        end = self.metrics.adaptation.end_rad
        return self.last.rms_rad["all"] if end is None else end["all"]

    @property
    def unit(self) -> str:
        """Unit in which errors are reported: "mrad", "mm", or "mrad or mm"."""
        return self.metrics.error_unit()

    @property
    def power(self) -> float | None:
        """Mean power from the supply in the phase `last` [W]; None if energy was not recorded."""
        energy = self.last.energy_j.get("all")
        seconds = min(self.last.end, self.metrics.duration) - self.last.start
        return None if energy is None or seconds <= 0 else energy / seconds

    @property
    def judged_over(self) -> str:
        """Time interval of `error` as text."""
        found = self.metrics.adaptation
        if found.end_rad is not None:
            return f"in the last {found.span_s:g} s"
        return f"over {self.last.end - self.last.start:.3g} s" + (
            f" {self.last.name} the change" if self.before else ""
        )

    def setting(self, name: str) -> Any:
        """Returns a stored setting; None if it was not stored."""
        return self.configuration.settings.get(name)


def read_runs(folders: Sequence[Path | str]) -> tuple[ReportedRun, ...]:
    """Reads the runs of a report.

    Args:
        folders: Folders of runs, complete or ended early.

    Raises:
        LeglabError: A folder is repeated, is no folder of a run, or holds a file that cannot be
            read or has an invalid entry; the message names the file and the entry.
    """
    if not folders:
        raise SettingsError("nothing to report: give the folder of at least one run")
    seen: set[Path] = set()
    runs = []
    for folder in map(Path, folders):
        if folder.resolve() in seen:
            raise SettingsError(f"the folder {str(folder)!r} is given twice", given=folder)
        seen.add(folder.resolve())
        runs.append(read_run(folder))
    return tuple(replace(run, label=x) for run, x in zip(runs, _labels(runs), strict=True))


def check_runs(folders: Sequence[Path | str]) -> None:
    """Tests that folders have all files of a run, before any work is done.

    Raises:
        LeglabError: A file is missing; the message names the folder and the file.
    """
    for folder in map(Path, folders):
        for name in RUN_FILES:
            if not (folder / name).is_file():
                text = f"{str(folder)!r} is not the folder of a run: it has no {name}"
                if folder.name in RUN_FILES:
                    text += f"; give its folder, {str(folder.parent)!r}"
                raise FileError(text, given=folder)


def read_run(folder: Path | str) -> ReportedRun:
    """Reads one folder of a run; its label is the controller's name.

    Raises:
        LeglabError: As `read_runs`.
    """
    folder = Path(folder)
    check_runs([folder])
    metrics = read_metrics(folder)
    configuration = record.read(RunConfiguration, folder / CONFIGURATION)
    recording = data.read(folder / RECORDING)
    joints = [name for name in metrics.phases[0].rms_rad if name != "all"]
    for phase in metrics.phases:
        for key in ("rms_rad", "peak_rad"):
            missing = {*joints, "all"} - getattr(phase, key).keys()
            if missing:
                raise FileError(
                    f"{folder / 'metrics.json'}: phase {phase.name!r}: {key} lacks "
                    f"{sorted(missing)[0]!r}",
                    given=folder,
                )
    for joint in joints:
        for quantity in ("position", "reference"):
            if f"{joint}_{quantity}" not in recording:
                absent = f"{joint}_{quantity}"
                text = f"{folder / 'recording.parquet'}: no column {absent!r}"
                raise RecordingError(text, given=absent, allowed=recording.columns)
    return ReportedRun(
        folder=folder,
        label=metrics.controller,
        metrics=metrics,
        configuration=configuration,
        recording=recording,
    )


def read_metrics(folder: Path) -> RunMetrics:
    """Reads only `metrics.json`.

    Raises:
        LeglabError: The file cannot be read or does not have the required form.
    """
    return record.read(RunMetrics, folder / METRICS)


def _labels(runs: Sequence[ReportedRun]) -> list[str]:
    """Returns distinct labels: the controllers' names, with differing settings where needed."""
    labels = [run.metrics.controller for run in runs]
    told = ("scenario", "model", "reference", "severity", "duration", "ramp_duration", "element")
    for name in (*told, "tolerance", "vary", "seed"):
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


def check_settings(runs: Sequence[RunSettings]) -> None:
    """Tests the settings of all runs before any run is made.

    Raises:
        LeglabError: There is no run, a controller, scenario or option is unknown or not allowed,
            or a controller is repeated.
    """
    if not runs:
        raise SettingsError("no controllers to run; give ", allowed="one or more")
    check_controllers([run.controller for run in runs])
    for run in runs:
        scenario_of(run)


def make_runs(
    runs: Sequence[RunSettings],
    folders: Sequence[Path],
    *,
    jobs: int = -1,
    overwrite: bool = False,
    timeout: float = TIMEOUT,
    progress: Progress | None = None,
) -> list[Path]:
    """Makes the runs whose folders are missing or out of date.

    A folder is written completely or not at all, so the same call continues after an interruption.
    A folder is reused only if its settings, code and model are the same, as in `run_all` of
    `leglab.runs.comparison`; otherwise it is replaced.

    Args:
        runs: Settings of the runs.
        folders: Folder of each run.
        jobs: Number of processes; -1 for one per core.
        overwrite: Whether to repeat existing runs.
        timeout: Maximum wall time of a run [s].
        progress: Called after each run.

    Returns:
        The folders.

    Raises:
        LeglabError: A run fails, a folder cannot be written or holds something other than a run,
            or another process writes to it. The other runs are made nevertheless.
        KeyboardInterrupt: The user interrupts; finished runs are kept.
    """
    numbers = range(len(runs))
    bases = [basis_of(run) for run in runs]
    made = [n for n in numbers if not overwrite and _is_made(runs[n], folders[n], bases[n])]
    for number in numbers:
        if number not in made:
            check_folder(folders[number], mark=METRICS, overwrite=True)
    problems = make_missing(
        executor(make_folder, jobs, timeout=timeout),
        numbers,
        Results(dict.fromkeys(made), lambda *_: None),
        lambda n: {
            "settings": asdict(runs[n]),
            "basis": bases[n],
            "folder": str(folders[n].absolute()),
        },
        told=lambda n: f"{runs[n].scenario} · {runs[n].controller}",
        progress=progress,
    )
    for problem in problems.values():
        raise problem
    return list(folders)


def _asked(settings: RunSettings) -> dict:
    """Returns the settings in the form in which a JSON file would return them."""
    return json.loads(json.dumps(asdict(settings)))


def _is_made(settings: RunSettings, folder: Path, basis: Mapping[str, str]) -> bool:
    wanted = {"asked": _asked(settings), **basis}
    there = all((folder / name).is_file() for name in RUN_FILES)
    return there and content_with(wanted, folder / CONFIGURATION) is not None


def content_with(wanted: Mapping[str, Any], path: Path) -> dict[str, Any] | None:
    """Returns the content of a JSON file if it has the entries `wanted`; None otherwise."""
    try:
        content = read_json(path)
    except LeglabError:
        return None
    same = isinstance(content, dict) and wanted.items() <= content.items()
    return content if same else None


def make_folder(given: dict[str, Any]) -> None:
    """Makes a run with its recording and writes its folder.

    Args:
        given: Dict with the run's `settings`, its `basis` from `basis_of`, and its `folder`.

    Raises:
        LeglabError: The run cannot be set up, or the folder cannot be written.
        KeyboardInterrupt: The user interrupts.
    """
    settings = RunSettings(**given["settings"])
    folder = Path(given["folder"])
    prepared(settings, given["basis"]["model_digest"])
    with new_folder(folder, mark=METRICS, made=RUN_FOLDER, overwrite=True) as partial:
        run = record_scenario(settings, partial / RECORDING)
        if (run.record.failure or "").startswith("interrupted"):
            raise KeyboardInterrupt
        made = {"asked": _asked(settings), "code": given["basis"]["code"]}
        write_result(replace(run, configuration=run.configuration.model_copy(update=made)), partial)
