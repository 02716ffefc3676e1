"""One scenario from names to results: model, controller, closed loop, metrics."""

import copy
import functools
import math
import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib import metadata
from typing import Any

import numpy as np

import leglab.controllers
import leglab.scenarios  # noqa: F401  registers the scenarios
from leglab import __version__
from leglab.base.errors import LeglabError
from leglab.base.recording import Recording
from leglab.base.scenario import Scenario, get_scenario
from leglab.base.settings import validate_configuration
from leglab.commissioning.calibration import settle, speed_limits
from leglab.commissioning.setup import controller_setup
from leglab.control import ControllerSetup, ReferencePoint, make_controller
from leglab.control.feedforward.offline import BenchRun
from leglab.machine.changes import check_tolerance, vary_bodies, vary_parameters
from leglab.machine.sensors import SensorConfiguration, held, quantise
from leglab.machine.simulation import Simulation, load_model
from leglab.references import Joint, Reference, make_reference
from leglab.runs.loop import History, Progress, closed_loop
from leglab.runs.metrics import summary


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


def scenario_of(settings: RunSettings) -> Scenario:
    """Builds the scenario that settings ask for.

    Raises:
        LeglabError: If the seed, the name or an option of the scenario is not allowed.
    """
    if settings.seed < 0:
        raise LeglabError(f"seed {settings.seed} is negative; allowed: 0 or more")
    return get_scenario(
        settings.scenario,
        duration=settings.duration,
        severity=settings.severity,
        ramp_duration=settings.ramp_duration,
    )


class Preparation:
    """What runs with the same model, sensors and tolerance share.

    Args:
        settings: Of a run.

    Attributes:
        sensors: Sensors and timing.
        nominal: The nominal machine in its rest pose; a run moves a machine of its own.

    Raises:
        LeglabError: If the model or a setting does not fit.
    """

    def __init__(self, settings: RunSettings) -> None:
        check_tolerance(settings.tolerance)
        self._model, self._timestep = settings.model, settings.timestep
        self._tolerance = settings.tolerance
        self.sensors = validate_configuration(SensorConfiguration, settings.sensors, "sensors")
        self.nominal = Simulation(self._load(visual=False))
        setup = controller_setup(self.nominal, settings.model, self.sensors)
        # Calibrations take long and are the same in every run.
        known = {
            name: functools.cache(value) if callable(value) else value
            for name, value in setup.machine.items()
        }
        self._setup = replace(setup, machine=known)

    def setup(self, scenario: Scenario, bench_runs: Callable[[], Any]) -> ControllerSetup:
        """What a controller may know in a run.

        Args:
            scenario: Of the run.
            bench_runs: Makes recordings of the machine before and after its changes.
        """
        return replace(
            self._setup,
            machine={
                **self._setup.machine,
                "first_change": min(scenario.breakpoints, default=math.inf),
                "last_change": max(scenario.breakpoints, default=math.inf),
                "bench_runs": bench_runs,
            },
        )

    def reference(self, settings: RunSettings, scenario: Scenario) -> Reference:
        """The trajectory of a run, of the nominal machine's joints."""
        return make_reference(
            settings.reference or scenario.reference,
            reference_joints(self.nominal),
            reference_config(settings, scenario),
            seed=settings.seed,
        )

    def machine(self, *, visual: bool = False) -> Simulation:
        """A machine of its own for runs, which `start` brings to the start of one.

        Args:
            visual: Whether it can be seen: with the shapes that are there for that only.
        """
        return Simulation(self._load(visual=True) if visual else copy.copy(self.nominal.model))

    def start(self, simulation: Simulation, seed: int) -> None:
        """Puts a machine where a run starts: the seed's specimen, at rest in its rest pose.

        Args:
            simulation: From `machine`, in any state, its bodies without loads.
            seed: Picks the specimen, where there is a tolerance.

        Raises:
            LeglabError: If a cylinder cannot hold its joint there.
        """
        if self._tolerance:
            model = simulation.model
            model.body_mass[:] = self.nominal.model.body_mass
            model.body_inertia[:] = self.nominal.model.body_inertia
            vary_bodies(model, self._tolerance, seed)
        simulation.reset()
        if self._tolerance:
            vary_parameters(simulation, self._tolerance, seed)
        settle(simulation)

    def _load(self, *, visual: bool) -> Any:
        return load_model(self._model, timestep=self._timestep, visual=visual)


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


# Seed of the recordings: none that a comparison uses.
BENCH_SEED = 1_000_003

_DURATION = 40.0  # s
_SETTLED = 10.0  # from then on the recorded motion is near the reference [s]
_cache: dict[str, BenchRun] = {}

Recorder = Callable[[Scenario], tuple[Recording, History]]


def bench_runs(record: Recorder, scenario: Scenario, key: str) -> tuple[BenchRun, BenchRun]:
    """Records both machines; what was recorded before under the same key is used again.

    Args:
        record: Runs a scenario with the adaptive controller.
        scenario: Whose changes are looked at.
        key: Tells everything else that the recordings depend on.
    """
    before = replace(scenario, duration=_DURATION, changes=())
    after = replace(scenario.changed_from_start(), duration=_DURATION)
    return _bench_run(record, before, key), _bench_run(record, after, key)


def _bench_run(record: Recorder, scenario: Scenario, key: str) -> BenchRun:
    key = f"{key} {scenario!r}"
    if key not in _cache:
        recording, history = record(scenario)
        kept = recording.time >= _SETTLED
        _cache[key] = BenchRun(
            time=recording.time[kept],
            position=recording.stack(recording.joints, "position")[kept],
            command=history.command[kept],
            reference=ReferencePoint(*(part[kept] for part in history.reference)),
        )
    return _cache[key]


__all__ = ["Run", "RunSettings", "run_scenario", "run_setup"]


@dataclass(frozen=True, kw_only=True)
class Run:
    """A finished run, or as much of it as there is.

    Attributes:
        settings: What was asked for.
        scenario: The scenario as it was built.
        recording: What sensors and commands were; format of `leglab.base.recording`.
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
