"""One scenario from settings to results: closed loop, recording, metrics."""

import platform
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any

from leglab import __version__
from leglab.base.recording import Recording
from leglab.base.scenario import Scenario
from leglab.runs.loop import History, Loop, Progress, recorded_positions, recording_noise
from leglab.runs.metrics import summary
from leglab.runs.preparation import RunSettings, reference_config
from leglab.runs.record import ChangeRecord, RunConfiguration, RunMetrics, as_json


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


def run_scenario(settings: RunSettings, progress: Progress | None = None) -> Run:
    """Runs a scenario headless.

    Args:
        settings: What to run.
        progress: Called now and then with the simulated time [s].

    Raises:
        LeglabError: If a name, a setting or the machine does not fit. A run that fails half way
            does not raise: `history.failure` says why it ended.
    """
    loop = Loop(settings)
    configuration = _configuration(loop)
    history = loop.run(progress)
    scenario, joints, window = loop.scenario, loop.simulation.joints, loop.reference.period
    names = {name: str(getattr(settings, name)) for name in ("scenario", "controller", "model")}
    metadata = {**names, "seed": settings.seed}
    return Run(
        settings=settings,
        scenario=scenario,
        recording=_recording(loop, history, metadata),
        history=history,
        record=RunMetrics.model_validate(
            {**metadata, **summary(scenario, window, history, joints)}
        ),
        configuration=configuration,
        window=window,
        joints=joints,
    )


def _recording(loop: Loop, history: History, metadata: dict[str, Any]) -> Recording:
    simulation, sensors = loop.simulation, loop.preparation.sensors
    noise = recording_noise(loop.settings.seed)
    measured = recorded_positions(history, sensors, noise)
    columns = {}
    for i, (joint, actuator) in enumerate(
        zip(simulation.joints, simulation.actuators, strict=True)
    ):
        columns[f"{joint}_position"] = measured[:, i]
        columns[f"{joint}_truth"] = history.position[:, i]
        columns[f"{joint}_truth_velocity"] = history.velocity[:, i]
        columns[f"{actuator}_command"] = history.command[:, i]
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
    for name, values in history.states.items():
        pressure = name.endswith(("_pressure_a", "_pressure_b"))
        extra = noise.normal(0.0, sensors.pressure_noise, len(values)) if pressure else 0.0
        columns[name] = values + extra
    # Encoders of joints that nothing drives, as linear scales of the same noise, rad or m.
    for name, values in history.passive.items():
        columns[f"{name}_position"] = values + noise.normal(
            0.0, sensors.position_noise, len(values)
        )
    return Recording(time=history.time, columns=columns, metadata=metadata)


def _configuration(loop: Loop) -> RunConfiguration:
    settings, scenario, simulation = loop.settings, loop.scenario, loop.simulation
    packages = ("mujoco", "numpy", "scipy", "control", "pyarrow")
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
        elements={name: simulation.cylinder_parameters(name) for name in simulation.actuators},
        versions={
            "leglab": __version__,
            "python": platform.python_version(),
            **{package: version(package) for package in packages},
        },
    )
