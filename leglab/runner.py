"""One scenario from names to results: model, controller, closed loop, metrics."""

import copy
import math
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib import metadata
from typing import Any

import numpy as np

import leglab.controllers
import leglab.scenarios  # noqa: F401  registers the scenarios
from leglab import __version__
from leglab.bench_runs import BENCH_SEED, bench_runs
from leglab.calibration import settle, speed_limits
from leglab.commissioning import controller_setup
from leglab.configuration import validate_configuration
from leglab.control import make_controller
from leglab.errors import LeglabError
from leglab.feedforward.offline import BenchRun
from leglab.measurement import SensorConfiguration, held, quantise
from leglab.recording import Recording
from leglab.references import Joint, Reference, make_reference
from leglab.rollout import History, Progress, closed_loop
from leglab.scenario import Scenario, get_scenario
from leglab.simulation import Simulation, load_model
from leglab.summary import summary
from leglab.tolerance import check_tolerance, vary_bodies, vary_parameters


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """Everything that decides a run, as `run.json` stores it.

    Attributes:
        scenario: Name of the scenario.
        controller: Name of the controller.
        model: Name of a model or path of an MJCF file.
        duration: [s]; None for the scenario's own.
        seed: Of sensor noise and of everything random, a random reference included.
        severity: Of the scenario's change, in its own unit; None for its own.
        ramp_duration: How long the change takes [s].
        reference: Name of the reference; None for the scenario's own.
        reference_config: Settings of the reference, over those of the scenario.
        controller_config: Settings of the controller.
        sensors: Settings of sensors and timing.
        timestep: Of the simulation [s]; None for the model's own.
        tolerance: Relative standard deviation of the machine's parameters about those that the
            controller knows [1]; the seed picks the specimen.
    """

    scenario: str
    controller: str = "pd"
    model: str = "leg"
    duration: float | None = None
    seed: int = 0
    severity: float | None = None
    ramp_duration: float = 0.0
    reference: str | None = None
    reference_config: Mapping[str, Any] = field(default_factory=dict)
    controller_config: Mapping[str, Any] = field(default_factory=dict)
    sensors: Mapping[str, Any] = field(default_factory=dict)
    timestep: float | None = None
    tolerance: float = 0.0


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
    if settings.seed < 0:
        raise LeglabError(f"seed {settings.seed} is negative; allowed: 0 or more")
    scenario = get_scenario(
        settings.scenario,
        duration=settings.duration,
        severity=settings.severity,
        ramp_duration=settings.ramp_duration,
    )
    return _run(settings, scenario, progress)


def _run(settings: RunSettings, scenario: Scenario, progress: Progress | None = None) -> Run:
    check_tolerance(settings.tolerance)
    sensors = validate_configuration(SensorConfiguration, settings.sensors, "sensors")
    model = load_model(settings.model, timestep=settings.timestep, visual=False)
    simulation = Simulation(model)
    setup = controller_setup(simulation, settings.model, sensors)
    setup = replace(
        setup,
        machine={
            **setup.machine,
            "first_change": min(scenario.breakpoints, default=math.inf),
            "last_change": max(scenario.breakpoints, default=math.inf),
            "bench_runs": lambda: _bench_runs(settings, scenario),
        },
    )
    controller = make_controller(settings.controller, setup, settings.controller_config)
    reference = make_reference(
        settings.reference or scenario.reference,
        reference_joints(simulation),
        reference_config(settings, scenario),
        seed=settings.seed,
    )
    if settings.tolerance:
        specimen = copy.copy(model)
        vary_bodies(specimen, settings.tolerance, settings.seed)
        simulation = Simulation(specimen)
        vary_parameters(simulation, settings.tolerance, settings.seed)
    settle(simulation)
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


def reference_config(settings: RunSettings, scenario: Scenario) -> dict[str, Any]:
    """Settings of the reference: the scenario's, for its own reference, below the user's."""
    own = settings.reference in (None, scenario.reference)
    return {**(scenario.reference_config if own else {}), **settings.reference_config}


def reference_joints(simulation: Simulation) -> tuple[Joint, ...]:
    """The driven joints with their limits, at rest in the present pose."""
    rows = zip(
        simulation.joints,
        simulation.position(),
        simulation.joint_range(),
        speed_limits(simulation),
        strict=True,
    )
    return tuple(
        Joint(name=name, rest=float(rest), lower=low, upper=high, velocity_limit=float(speed))
        for name, rest, (low, high), speed in rows
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
