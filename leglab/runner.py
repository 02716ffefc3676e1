"""One scenario from names to results: model, controller, closed loop, metrics."""

import platform
from dataclasses import dataclass, replace
from importlib import metadata
from typing import Any

import numpy as np

from leglab import __version__
from leglab.bench_runs import BENCH_SEED, bench_runs
from leglab.control import ControllerSetup, make_controller
from leglab.feedforward.offline import BenchRun
from leglab.measurement import SensorConfiguration, held, quantise
from leglab.preparation import Preparation, RunSettings, reference_config, scenario_of
from leglab.recording import Recording
from leglab.references import Reference
from leglab.rollout import History, Progress, closed_loop
from leglab.scenario import Scenario
from leglab.simulation import Simulation
from leglab.summary import summary

__all__ = ["Run", "RunSettings", "run_scenario", "run_setup"]


@dataclass(frozen=True, kw_only=True)
class Run:
    """A finished run, or as much of it as there is.

    Attributes:
        settings: What was asked for.
        scenario: The scenario as it was built.
        recording: What sensors and commands were; format of `leglab.recording`.
        history: True states and everything else of the loop.
        metrics: Content of `metrics.json`.
        configuration: Content of `run.json`.
        window: Window of the sliding error [s].
        joints: Names of the driven joints.
    """

    settings: RunSettings
    scenario: Scenario
    recording: Recording
    history: History
    metrics: dict[str, Any]
    configuration: dict[str, Any]
    window: float
    joints: tuple[str, ...]


def run_scenario(settings: RunSettings, progress: Progress | None = None) -> Run:
    """Runs a scenario headless.

    Args:
        settings: What to run.
        progress: Called now and then with the simulated time [s].

    Raises:
        LeglabError: If a name, a setting or the machine does not fit. A run that fails half way
            does not raise: `history.failure` says why it ended.
    """
    return _run(settings, scenario_of(settings), progress)


def run_setup(
    preparation: Preparation, settings: RunSettings, scenario: Scenario
) -> ControllerSetup:
    """What a controller may know in a run; bench recordings are made when it asks for them."""
    return preparation.setup(scenario, lambda: _bench_runs(settings, scenario))


def _run(settings: RunSettings, scenario: Scenario, progress: Progress | None = None) -> Run:
    preparation = Preparation(settings)
    sensors = preparation.sensors
    setup = run_setup(preparation, settings, scenario)
    controller = make_controller(settings.controller, setup, settings.controller_config)
    reference = preparation.reference(settings, scenario)
    simulation = preparation.machine()
    preparation.start(simulation, settings.seed)
    configuration = _configuration(settings, scenario, sensors, simulation, reference)
    history = closed_loop(
        simulation,
        controller,
        setup,
        reference,
        scenario,
        sensors,
        seed=settings.seed,
        name=settings.controller,
        progress=progress,
    )
    return Run(
        settings=settings,
        scenario=scenario,
        recording=_recording(history, simulation, sensors, settings),
        history=history,
        metrics={
            "scenario": settings.scenario,
            "controller": settings.controller,
            "model": str(settings.model),
            "seed": settings.seed,
            **summary(scenario, reference.period, history, setup.joints),
        },
        configuration=configuration,
        window=reference.period,
        joints=setup.joints,
    )


def _bench_runs(settings: RunSettings, scenario: Scenario) -> tuple[BenchRun, BenchRun]:
    # The specimen is the seed's; the sensor noise could not be told from another.
    seed = settings.seed if settings.tolerance else BENCH_SEED
    settings = replace(settings, controller="bsnn_arx", controller_config={}, seed=seed)

    def record(changed: Scenario) -> tuple[Recording, History]:
        run = _run(settings, changed)
        return run.recording, run.history

    return bench_runs(record, scenario, repr(settings))


def _recording(
    history: History, simulation: Simulation, sensors: SensorConfiguration, settings: RunSettings
) -> Recording:
    noise = np.random.default_rng([settings.seed, 1])
    columns = {}
    for i, (joint, actuator) in enumerate(
        zip(simulation.joints, simulation.actuators, strict=True)
    ):
        true = history.position[:, i]
        noisy = true + noise.normal(0.0, sensors.position_noise, len(true))
        noisy += history.encoder_shift[:, i]
        reading = quantise(noisy, sensors.encoder_counts)
        columns[f"{joint}_position"] = held(reading, history.encoder_lost[:, i])
        columns[f"{joint}_truth"] = true
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
    return Recording(
        time=history.time,
        columns=columns,
        metadata={
            "scenario": settings.scenario,
            "controller": settings.controller,
            "model": str(settings.model),
            "seed": settings.seed,
        },
    )


def _configuration(
    settings: RunSettings,
    scenario: Scenario,
    sensors: SensorConfiguration,
    simulation: Simulation,
    reference: Reference,
) -> dict[str, Any]:
    packages = ("mujoco", "numpy", "scipy", "control", "pyarrow")
    return {
        "settings": {
            **{name: getattr(settings, name) for name in settings.__dataclass_fields__},
            "model": str(settings.model),
            "reference": reference.name,
            "duration": scenario.duration,
            "severity": scenario.severity,
            "reference_config": reference_config(settings, scenario),
            "controller_config": dict(settings.controller_config),
            "sensors": sensors.model_dump(),
            "timestep": simulation.model.opt.timestep,
        },
        "window": reference.period,
        "changes": [
            {name: getattr(change, name) for name in change.__dataclass_fields__}
            for change in scenario.changes
        ],
        "elements": {name: simulation.cylinder_parameters(name) for name in simulation.actuators},
        "versions": {
            "leglab": __version__,
            "python": platform.python_version(),
            **{package: metadata.version(package) for package in packages},
        },
    }
