"""One scenario from settings to results: closed loop, recording, metrics."""

import platform
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib.metadata import version
from typing import Any

import mujoco
import numpy as np

from leglab import __version__
from leglab.base.recording import DRIVES, SIMULATION, Recording
from leglab.base.scenario import Scenario
from leglab.base.units import CONTROL_UNIT, units_of_columns
from leglab.control.feedforward.fault_monitor import plain
from leglab.machine.changes import parameter_units
from leglab.machine.sensors import CHAMBERS, PressureFaults, filtered_velocities
from leglab.runs.clock import adaptation
from leglab.runs.interrupts import held
from leglab.runs.loop import History, Loop, Progress, recorded_positions, recording_noise
from leglab.runs.metrics import excess_error_area, phase_table, rms, usage_table
from leglab.runs.preparation import Preparation, RunSettings, reference_config
from leglab.runs.record import ChangeRecord, RunConfiguration, RunMetrics, as_json
from leglab.runs.view import draw


@dataclass(frozen=True, kw_only=True)
class Run:
    """A finished run, or as much of it as there is.

    Attributes:
        settings: What was asked for.
        scenario: The scenario as it was built.
        recording: What sensors and commands were; format of `leglab.base.recording`.
        history: True states and everything else of the loop.
        record: Content of `metrics.json`.
        configuration: Content of `run.json`.
        window: Window of the sliding error [s].
        joints: Names of the driven joints.
    """

    settings: RunSettings
    scenario: Scenario
    recording: Recording
    history: History
    record: RunMetrics
    configuration: RunConfiguration
    window: float
    joints: tuple[str, ...]

    @property
    def metrics(self) -> dict[str, Any]:
        """Content of `metrics.json` as plain Python types."""
        return as_json(self.record)

    def __repr__(self) -> str:
        return f"Run({self.record.told()})"

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
    loop = Loop(settings, preparation=preparation)
    with held() as hold:
        return _run(loop, progress, hold.take)


def _run(loop: Loop, progress: Progress | None, interrupted: Callable[[], bool]) -> Run:
    settings, configuration = loop.settings, _configuration(loop)
    twin = _has_twin(loop)
    history = loop.run(_share(progress, 2 if twin else 1), interrupted=interrupted)
    names = {name: str(getattr(settings, name)) for name in ("scenario", "controller", "model")}
    metadata = {**names, "seed": settings.seed}
    recording = _recording(loop, history, metadata)
    events = told(loop)  # of this run: its twin forgets them
    twin_error = None
    if twin and not history.failure:
        twin_history = _twin(loop, progress, interrupted)
        if twin_history.failure.startswith("interrupted"):
            history = replace(history, failure="interrupted in the run of the frozen twin")
        elif not twin_history.failure:
            twin_error = twin_history.error
    return Run(
        settings=settings,
        scenario=loop.scenario,
        recording=recording,
        history=history,
        record=RunMetrics.model_validate(
            {**metadata, **_metrics(loop, history, twin_error), **events}
        ),
        configuration=configuration,
        window=loop.reference.period,
        joints=loop.simulation.joints,
    )


def told(loop: Loop) -> dict[str, Any]:
    """What the controller said of changes and wear, if it does, as `metrics.json` has it."""
    found: dict[str, Any] = {}
    if (events := getattr(loop.controller, "events", None)) is not None:
        found["events"] = plain(events)
    if (trends := getattr(loop.controller, "trends", None)) is not None:
        found["health"] = [vars(trend).copy() for trend in trends]
    return found


def _has_twin(loop: Loop) -> bool:
    """Whether the controller adapts and can be told to stop, and there is something to adapt to."""
    return bool(loop.scenario.changes) and callable(getattr(loop.controller, "freeze", None))


def _twin(loop: Loop, progress: Progress | None, interrupted: Callable[[], bool]) -> History:
    """The same run with adaptation stopped just before the first change."""
    half = loop.scenario.duration / 2
    loop.reset()
    show = None if progress is None else lambda now: progress(half + now / 2)
    return loop.run(show, freeze=True, interrupted=interrupted)


def _share(progress: Progress | None, parts: int) -> Progress | None:
    return None if progress is None else lambda now: progress(now / parts)


def _metrics(loop: Loop, history: History, twin: np.ndarray | None) -> dict[str, Any]:
    """What `metrics.json` holds beside the names: a summary of a run, as far as it came.

    Args:
        loop: The loop that was run.
        history: What it left behind.
        twin: Tracking error of the frozen twin [rad], (n, joints); None without one.
    """
    scenario, joints, stride = loop.scenario, loop.simulation.joints, loop.reference.period
    finite = np.isfinite(history.error).all(axis=1)
    error, time = history.error[finite], history.time[finite]
    none = np.full(len(history.time), np.nan)
    spent = [history.states.get(f"{joint}_energy_supply", none) for joint in joints]
    energy = np.column_stack(spent)
    errors = phase_table(time, error, joints, scenario.phases)
    usage = usage_table(time, history.command[finite], energy[finite], joints, scenario.phases)
    for row, costs in zip(errors, usage, strict=True):
        row.update(costs)
        if "model_error" in history.diagnostics:
            part = (history.time >= row["start"]) & (history.time <= row["end"])
            values = rms(history.diagnostics["model_error"][part & finite])
            row["model_error"] = dict(zip(joints, values.tolist(), strict=True))
    change = min(scenario.breakpoints, default=None)
    slides = [joint for joint in joints if loop.simulation.slides[joint]]
    return {
        **({"slides": slides} if slides else {}),
        "duration": float(history.time[-1]),
        "severity": scenario.severity,
        "real_time_factor": float(history.time[-1] / max(history.wall_time, 1e-9)),
        "completed": not history.failure,
        "failure": history.failure or None,
        "phases": errors,
        "adaptation": adaptation(
            scenario, stride, time, error, joints, twin=twin, failure=history.failure
        ).model_dump(),
        "excess_error_area_rad_s": None
        if change is None
        else excess_error_area(time, error, change, stride),
    }


def _recording(loop: Loop, history: History, metadata: dict[str, Any]) -> Recording:
    simulation, sensors = loop.simulation, loop.preparation.sensors
    noise = recording_noise(loop.settings.seed)
    measured = recorded_positions(history, sensors, noise)
    velocities = filtered_velocities(measured, sensors)
    columns = {}
    for i, (joint, actuator) in enumerate(
        zip(simulation.joints, simulation.actuators, strict=True)
    ):
        columns[f"{joint}_position"] = measured[:, i]
        columns[f"{joint}_velocity"] = velocities[:, i]
        columns[f"{joint}_truth"] = history.position[:, i]
        columns[f"{joint}_truth_velocity"] = history.velocity[:, i]
        columns[f"{actuator}_command"] = history.control[:, i]
        for suffix, values in zip(
            ("reference", "reference_velocity", "reference_acceleration"),
            history.reference,
            strict=True,
        ):
            columns[f"{joint}_{suffix}"] = values[:, i]
        for name, values in history.diagnostics.items():
            columns[f"{joint}_{name}"] = values[:, i]
    for name, values in history.passive.items():
        columns[f"{name}_truth"] = values
    hydraulic = simulation.hydraulic_joints
    places = [f"{joint}_{chamber}" for chamber in CHAMBERS for joint in hydraulic]
    faults = PressureFaults.of(simulation.model, hydraulic)
    shown = dict(zip(places, zip(faults.scale, faults.offset, strict=True), strict=True))
    for name, values in history.states.items():
        columns[name] = values
        if name in shown:
            scale, offset = shown[name]
            noisy = values + noise.normal(0.0, sensors.pressure_noise, len(values))
            columns[name] = scale * noisy + offset
            columns[name].setflags(write=False)  # The recording need not copy it.
    # Encoders of joints that nothing drives, as linear scales of the same noise, rad or m.
    for name, values in history.passive.items():
        read = values + noise.normal(0.0, sensors.position_noise, len(values))
        columns[f"{name}_position"] = read
        columns[f"{name}_velocity"] = filtered_velocities(read[:, None], sensors)[:, 0]
    units = units_of_columns(columns, simulation.slides)
    changeable = parameter_units()
    if loop.machine:
        schedule = loop.machine.schedule
        for element, parameter in (*schedule.parameters, *schedule.others):
            units[f"{element}_{parameter}"] = changeable[parameter]
    drives = {
        simulation.model.joint(drive.joint).name: {
            "actuator": name,
            "centre": drive.centre,
            "half": drive.half,
        }
        for name, drive in simulation.native.items()
    }
    for drive in drives.values():
        units[f"{drive['actuator']}_command"] = CONTROL_UNIT
    options = simulation.model.opt
    made = {
        "timestep": options.timestep,
        "integrator": mujoco.mjtIntegrator(options.integrator).name.removeprefix("mjINT_").lower(),
    }
    known = {**metadata, SIMULATION: made, **({DRIVES: drives} if drives else {}), "units": units}
    return Recording(time=history.time, columns=columns, metadata=known)


def _configuration(loop: Loop) -> RunConfiguration:
    settings, scenario, simulation = loop.settings, loop.scenario, loop.simulation
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
    )


@cache
def _package_versions() -> dict[str, str]:
    """Versions of what results depend on; looking one up takes milliseconds."""
    return {name: version(name) for name in ("mujoco", "numpy", "scipy", "control", "pyarrow")}
