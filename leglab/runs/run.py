"""Execution of one run from settings to results: closed loop, recording, metrics."""

import platform
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from leglab import __version__
from leglab.base.recording import Recording
from leglab.base.scenario import Scenario
from leglab.data import parquet
from leglab.machine.files import ModelFiles
from leglab.runs.clock import adaptation
from leglab.runs.history import Ending, History, Rows
from leglab.runs.interrupts import held
from leglab.runs.loop import Loop, Progress
from leglab.runs.metrics import excess_error_area, joint_rms, phase_table, usage_table
from leglab.runs.preparation import Preparation, RunSettings, reference_config
from leglab.runs.record import ChangeRecord, RunConfiguration, RunMetrics, as_json
from leglab.runs.recorder import Recorder
from leglab.runs.view import draw

# Number of periods that a run keeps in memory before they become rows of its recording.
BLOCK = 8192


@dataclass(frozen=True, kw_only=True)
class Result:
    """Results of a run, which may have ended early."""

    settings: RunSettings  #: The requested settings
    scenario: Scenario  #: The scenario that ran
    recording: Recording  #: Sensor readings and commands; format of `leglab.base.recording`
    record: RunMetrics  #: Content of `metrics.json`
    configuration: RunConfiguration  #: Content of `run.json`
    window: float  #: Window of the sliding error [s]
    joints: tuple[str, ...]  #: Names of the driven joints
    files: ModelFiles | None  #: Files of the model; None for a model that ships with leglab

    @property
    def metrics(self) -> dict[str, Any]:
        """Content of `metrics.json` as plain Python types."""
        return as_json(self.record)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.record.told()})"

    def _repr_html_(self) -> str:
        return self.record.as_html()

    def plot(self) -> list[Any]:
        """Draws the tracking error and the valve commands of all joints, and the changes.

        Returns:
            The vertically stacked axes of a new `matplotlib.pyplot` figure.
        """
        return draw(self.recording, self.configuration.changes)

    def to_pandas(self) -> Any:
        """Returns a `pandas.DataFrame` of the metrics, by phase and joint.

        Raises:
            LeglabError: pandas is missing.
        """
        return self.record.to_pandas()


@dataclass(frozen=True, kw_only=True, repr=False)
class Run(Result):
    """Results of a run, complete or ended early, with its history in memory.

    Attributes:
        history: True states and all other recorded quantities of the loop.
    """

    history: History


def run_scenario(
    settings: RunSettings,
    progress: Progress | None = None,
    *,
    preparation: Preparation | None = None,
) -> Run:
    """Runs a scenario headless.

    Args:
        settings: Settings of the run.
        preparation: Preparation for the same model, parameters, time step, sensors and tolerance;
            reusing it saves time and does not change the results.
        progress: Called periodically with the simulated time [s]; with half of it if the frozen
            twin of an adaptive controller has to be run afterwards.

    Ctrl-C ends the run, which returns what was recorded; during setup it raises KeyboardInterrupt.

    Raises:
        LeglabError: A name, a setting or the machine is not suitable. If the run fails after its
            start, nothing is raised and `history.failure` is the reason.
    """
    loop = Loop(settings, preparation=preparation, kept=BLOCK)
    recorder, configuration = Recorder(loop), _configuration(loop)
    with held() as hold:
        history = loop.run(_share(loop, progress), interrupted=hold.take)
        columns = recorder.columns(history)
        recording = Recording(
            time=history.time, columns=columns, metadata=recorder.metadata(columns)
        )
        result = _result(loop, configuration, recording, history, progress, hold.take)
    if result.record.failure:  # may also be a failure of the frozen twin's run
        history = replace(history, failure=result.record.failure)
    return Run(**vars(result), history=history)


def record_scenario(settings: RunSettings, path: Path, progress: Progress | None = None) -> Result:
    """Runs a scenario headless and writes its recording to a file block by block.

    The recording is bitwise equal to that of `run_scenario`; the memory use hardly grows with the
    duration.

    Args:
        settings: Settings of the run.
        path: Path of the Parquet file.
        progress: As in `run_scenario`.

    Ctrl-C ends the run; the file holds what was recorded. During setup it raises KeyboardInterrupt.

    Raises:
        LeglabError: As in `run_scenario`, or the file cannot be written.
    """
    loop = Loop(settings, kept=BLOCK)
    recorder, configuration = Recorder(loop), _configuration(loop)
    with held() as hold:
        with parquet.growing(path, recorder.metadata) as file:

            def keep(rows: Rows) -> None:
                file.append({"time": rows.time, **recorder.columns(rows)})

            ending = loop.stream(keep, _share(loop, progress), interrupted=hold.take)
        return _result(loop, configuration, parquet.stored(path), ending, progress, hold.take)


def _result(
    loop: Loop,
    configuration: RunConfiguration,
    recording: Recording,
    ending: Ending,
    progress: Progress | None,
    interrupted: Callable[[], bool],
) -> Result:
    """Computes the results of a finished loop, for which it may run the frozen twin."""
    settings = loop.settings
    events = told(loop)  # before the frozen twin's run, which resets the controller
    twin_error = None
    if _has_twin(loop) and not ending.failure:
        twin_error, failure = _twin(loop, progress, interrupted)
        if failure.startswith("interrupted"):
            ending = replace(ending, failure="interrupted in the run of the frozen twin")
        if failure:
            twin_error = None
    names = {name: str(getattr(settings, name)) for name in ("scenario", "controller", "model")}
    metrics = _metrics(loop, recording, ending, twin_error)
    return Result(
        settings=settings,
        scenario=loop.scenario,
        recording=recording,
        record=RunMetrics.model_validate({**names, "seed": settings.seed, **metrics, **events}),
        configuration=configuration,
        window=loop.reference.period,
        joints=loop.simulation.joints,
        files=loop.preparation.files,
    )


def told(loop: Loop) -> dict[str, Any]:
    """Returns fault events and wear trends that the controller reported, as in `metrics.json`."""
    found = {}
    for key, name in (("events", "events"), ("health", "trends")):
        if (said := getattr(loop.controller, name, None)) is not None:
            found[key] = [one.model_dump() for one in said]
    return found


def _has_twin(loop: Loop) -> bool:
    """Tests whether the scenario has changes and the controller can freeze its adaptation."""
    return bool(loop.scenario.changes) and callable(getattr(loop.controller, "freeze", None))


def _twin(
    loop: Loop, progress: Progress | None, interrupted: Callable[[], bool]
) -> tuple[np.ndarray, str]:
    """Runs the frozen twin: the same run with adaptation stopped just before the first change.

    Returns its tracking error [rad], (n, joints), and the reason of its failure, or "".
    """
    half = loop.scenario.duration / 2
    loop.reset()
    show = None if progress is None else lambda now: progress(half + now / 2)
    error, count = np.empty((loop.count, len(loop.simulation.joints))), 0

    def keep(rows: Rows) -> None:
        nonlocal count
        start, count = count, count + len(rows.time)
        error[start:count] = rows.error

    ending = loop.stream(keep, show, freeze=True, interrupted=interrupted)
    return error[:count], ending.failure


def _share(loop: Loop, progress: Progress | None) -> Progress | None:
    parts = 2 if _has_twin(loop) else 1
    return None if progress is None else lambda now: progress(now / parts)


def _metrics(
    loop: Loop, recording: Recording, ending: Ending, twin: np.ndarray | None
) -> dict[str, Any]:
    """Computes the content of `metrics.json` except names and seed, also of an incomplete run."""
    scenario, simulation, stride = loop.scenario, loop.simulation, loop.reference.period
    joints, length = simulation.joints, float(recording.time[-1])
    error = recording.stack(joints, "truth")
    error -= recording.stack(joints, "reference")
    finite = np.isfinite(error).all(axis=1)
    # A slice, if there is no NaN, avoids a copy of the columns, which are large for long runs.
    kept = slice(None) if finite.all() else finite
    time, error = recording.time[kept], error[kept]
    errors = phase_table(time, error, joints, scenario.phases)
    change = min(scenario.breakpoints, default=None)
    figures = {
        "adaptation": adaptation(
            scenario, stride, time, error, joints, twin=twin, failure=ending.failure
        ).model_dump(),
        "excess_error_area_rad_s": None
        if change is None
        else excess_error_area(time, error, change, stride),
    }
    del error
    for row, costs in zip(errors, _usage(loop, recording, kept), strict=True):
        row.update(costs)
    if f"{joints[0]}_model_error" in recording:
        values = recording.stack(joints, "model_error")[kept]
        for row in errors:
            part = (time >= row["start"]) & (time <= row["end"])
            row["model_error"] = dict(zip(joints, joint_rms(values[part]).tolist(), strict=True))
    slides = [joint for joint in joints if loop.simulation.slides[joint]]
    times = loop.call_times.told()
    return {
        **({"slides": slides} if slides else {}),
        "duration": length,
        "severity": scenario.severity,
        "real_time_factor": float(length / max(ending.wall_time, 1e-9)),
        "command_time_s": None if times is None else vars(times),
        "completed": not ending.failure,
        "failure": ending.failure or None,
        "phases": errors,
        **figures,
    }


def _usage(loop: Loop, recording: Recording, kept: slice | np.ndarray) -> list[dict[str, Any]]:
    """Computes effort, valve activity and energy by phase from the samples in `kept`."""
    simulation = loop.simulation
    command = simulation.commands(recording.stack(simulation.actuators, "command")[kept])
    energy = np.full_like(command, np.nan)
    for i, joint in enumerate(simulation.joints):
        if (name := f"{joint}_energy_supply") in recording:
            energy[:, i] = recording[name][kept]
    time = recording.time[kept]
    return usage_table(time, command, energy, simulation.joints, loop.scenario.phases)


def _configuration(loop: Loop) -> RunConfiguration:
    settings, scenario, simulation = loop.settings, loop.scenario, loop.simulation
    files = loop.preparation.files
    return RunConfiguration(
        settings={
            **{name: getattr(settings, name) for name in settings.__dataclass_fields__},
            "model": str(settings.model),
            "reference": loop.reference.name,
            "duration": scenario.duration,
            "severity": scenario.severity,
            "reference_config": reference_config(settings, scenario),
            "controller_config": dict(settings.controller_config),
            "sensors": loop.preparation.sensors.model_dump(),
            "timestep": simulation.model.opt.timestep,
        },
        window=loop.reference.period,
        changes=[ChangeRecord(**asdict(change)) for change in scenario.changes],
        elements={
            name: simulation.native[name].description()
            if name in simulation.native
            else simulation.cylinder_parameters(name)
            for name in simulation.actuators
        },
        versions={
            "leglab": __version__,
            "python": platform.python_version(),
            **_package_versions(),
        },
        model_digest=files.digest if files else "",
        model_source=str(files.main) if files else None,
    )


@cache
def _package_versions() -> dict[str, str]:
    """Returns the versions of packages that results depend on; cached to save milliseconds."""
    return {name: version(name) for name in ("mujoco", "numpy", "scipy", "control", "pyarrow")}
