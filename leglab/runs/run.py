"""One scenario from settings to results: closed loop, recording, metrics."""

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

# Periods that a run keeps in memory before they become rows of its recording.
BLOCK = 8192


@dataclass(frozen=True, kw_only=True)
class Result:
    """Results of a run, or as much of them as there is."""

    settings: RunSettings  #: What was asked for
    scenario: Scenario  #: The scenario as it was built
    recording: Recording  #: What sensors and commands were; format of `leglab.base.recording`
    record: RunMetrics  #: Content of `metrics.json`
    configuration: RunConfiguration  #: Content of `run.json`
    window: float  #: Window of the sliding error [s]
    joints: tuple[str, ...]  #: Names of the driven joints
    files: ModelFiles | None  #: Of the model that ran; None of one that ships with leglab

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
            The axes, below each other, of a new figure of `matplotlib.pyplot`.
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
    """A finished run in memory, or as much of it as there is.

    Attributes:
        history: True states and everything else of the loop.
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
        settings: What to run.
        preparation: Of settings with the same model, parameters, time step, sensors and tolerance:
            a second run with it starts sooner, and gives the same bits.
        progress: Called now and then with the simulated time [s]; half of it while the frozen
            twin of an adaptive controller is still to be run.

    Ctrl-C ends the run: what was recorded comes back. While it is set up, it interrupts.

    Raises:
        LeglabError: If a name, a setting or the machine does not fit. A run that fails half way
            does not raise: `history.failure` says why it ended.
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
    if result.record.failure:  # of the run of the frozen twin, too
        history = replace(history, failure=result.record.failure)
    return Run(**vars(result), history=history)


def record_scenario(settings: RunSettings, path: Path, progress: Progress | None = None) -> Result:
    """Runs a scenario headless and writes its recording as it comes.

    The recording is that of `run_scenario`, bit for bit, and what the computer has to remember
    hardly grows with the duration.

    Args:
        settings: What to run.
        path: The recording; Parquet.
        progress: As in `run_scenario`.

    Ctrl-C ends the run: what was recorded is in the file. While it is set up, it interrupts.

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
    """Results of a loop that was run."""
    settings = loop.settings
    events = told(loop)  # of this run: its twin forgets them
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
    """Changes and wear that the controller named, if it does, as in `metrics.json`."""
    found = {}
    for key, name in (("events", "events"), ("health", "trends")):
        if (said := getattr(loop.controller, name, None)) is not None:
            found[key] = [one.model_dump() for one in said]
    return found


def _has_twin(loop: Loop) -> bool:
    """Whether the controller adapts and can be told to stop, and there is something to adapt to."""
    return bool(loop.scenario.changes) and callable(getattr(loop.controller, "freeze", None))


def _twin(
    loop: Loop, progress: Progress | None, interrupted: Callable[[], bool]
) -> tuple[np.ndarray, str]:
    """Tracking error [rad] of the same run with adaptation stopped just before the first change.

    And why it failed; empty if it did not.
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
    """Content of `metrics.json` beside the names: a summary of a run, as far as it came."""
    scenario, simulation, stride = loop.scenario, loop.simulation, loop.reference.period
    joints, length = simulation.joints, float(recording.time[-1])
    error = recording.stack(joints, "truth")
    error -= recording.stack(joints, "reference")
    finite = np.isfinite(error).all(axis=1)
    # Columns of long runs are large: one that is whole is not copied, and no two are kept.
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
    """Energy and valve travel by phase, of some rows."""
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
    """Versions of what results depend on; looking one up takes milliseconds."""
    return {name: version(name) for name in ("mujoco", "numpy", "scipy", "control", "pyarrow")}
