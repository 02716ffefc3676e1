"""From the settings of a run to its parts: nominal machine, specimen, reference."""

import copy
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import leglab.controllers
import leglab.scenarios  # noqa: F401  registers the scenarios
from leglab.base.errors import SettingsError
from leglab.base.scenario import Scenario, get_scenario
from leglab.base.settings import validate_configuration
from leglab.commissioning.calibration import settle, speed_limits
from leglab.commissioning.setup import controller_setup
from leglab.control.contract import CONTROLLERS
from leglab.data import SUFFIXES
from leglab.jobs.fingerprint import fingerprint
from leglab.machine.changes import (
    NATIVE_FIELDS,
    check_tolerance,
    fitted,
    healthy_values,
    vary_bodies,
    vary_parameters,
)
from leglab.machine.files import changed_meanwhile, model_digest, model_files
from leglab.machine.parameters import placed_parameters
from leglab.machine.sensors import SensorConfiguration, in_whole_steps, loop_timing
from leglab.machine.simulation import Simulation, load_model
from leglab.references import (
    GAIT,
    LEG_REFERENCES,
    Joint,
    Reference,
    make_reference,
)
from leglab.references.base import REFERENCES
from leglab.references.from_file import NAME as FILE
from leglab.references.from_file import digest_of


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """Everything that decides a run, as `run.json` stores it.

    Attributes:
        scenario: Name of the scenario.
        controller: Name of the controller.
        model: Name of a model or path of an MJCF file.
        duration: [s]; None for the scenario's own.
        seed: Of sensor noise and of everything random, a random reference included.
        severity: Size of the scenario's change, in its own unit; None for its own.
        ramp_duration: How long the change takes [s].
        element: Joint whose cylinder, spring and encoder change alone; None for all that the
            scenario changes.
        reference: Name of the reference, or a file with positions of joints; None for the
            scenario's own.
        reference_config: Settings of the reference, over those of the scenario.
        controller_config: Settings of the controller.
        sensors: Settings of sensors and timing.
        parameters: Physical parameters in place of those of the model's file, by NAME, for all
            elements that have it, or by ELEMENT.NAME. The controller is calibrated on the model so
            changed; gains that are stored for a model stay.
        timestep: Of the simulation [s]; None for the model's own.
        tolerance: Relative standard deviation of the machine's parameters about those that the
            controller knows [1]; the seed picks the specimen.
        vary: Whether the seed also draws when the machine changes, within a tenth of the duration
            about the scenario's own time, and the motion: the phase of `walking_stride`, the
            strides of `random_stride`.
    """

    scenario: str
    controller: str = "pd"
    model: str = "leg"
    duration: float | None = None
    seed: int = 0
    severity: float | None = None
    ramp_duration: float = 0.0
    element: str | None = None
    reference: str | None = None
    reference_config: Mapping[str, Any] = field(default_factory=dict)
    controller_config: Mapping[str, Any] = field(default_factory=dict)
    sensors: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)
    timestep: float | None = None
    tolerance: float = 0.0
    vary: bool = False

    def __post_init__(self) -> None:
        name = self.reference or ""
        if Path(name).suffix.lower() in SUFFIXES:
            found = {"file": os.path.abspath(name), "digest": digest_of(name)}
            object.__setattr__(self, "reference", FILE)
            object.__setattr__(self, "reference_config", {**self.reference_config, **found})


def scenario_of(settings: RunSettings, preparation: "Preparation | None" = None) -> Scenario:
    """Builds the scenario that settings ask for, by the healthy values of its machine.

    Args:
        settings: Of the run.
        preparation: Of the run; None for one that is made where a value of the model is asked for.

    Raises:
        SettingsError: If the seed, the name or an option of the scenario is not allowed.
    """
    if settings.seed < 0:
        told = f"seed {settings.seed} is negative; allowed: "
        raise SettingsError(told, given=settings.seed, allowed="0 or more")
    if preparation is not None and settings.element is not None:
        joints = preparation.nominal.joints
        if settings.element not in joints:
            raise SettingsError.unknown("joint", settings.element, joints).at("element")
    scenario = get_scenario(
        settings.scenario,
        duration=settings.duration,
        severity=settings.severity,
        ramp_duration=settings.ramp_duration,
        element=settings.element,
        healthy=partial(_healthy, settings, preparation),
    )
    return scenario.shifted(2 * _draws(settings.seed)[0] - 1) if settings.vary else scenario


def _healthy(
    settings: RunSettings, preparation: "Preparation | None", parameter: str
) -> tuple[float, ...]:
    """Values of a parameter in the nominal machine of a run, of the elements that change."""
    if preparation is None:  # of the model as it is: a sweep of parameters compiles it once
        plain = RunSettings(scenario="", model=settings.model, timestep=settings.timestep)
        preparation = prepared(plain)
    placed = placed_parameters(settings.parameters, preparation.nominal.elements)
    return healthy_values(preparation.nominal, parameter, settings.element, placed)


def _draws(seed: int) -> tuple[float, float]:
    """Draws of a seed for time and phase, in [0, 1) each, apart from noise and specimen."""
    time, phase = np.random.default_rng([seed, 3]).random(2).tolist()
    return time, phase


def check_controllers(names: Sequence[str]) -> None:
    """Refuses names of controllers that are not known, or given twice.

    Raises:
        SettingsError: Names the first one.
    """
    for i, name in enumerate(names):
        CONTROLLERS.get(name)
        if name in names[:i]:
            raise SettingsError(f"controllers: {name!r} is given twice", given=name)


class Preparation:
    """Preparation that runs with the same model and sensors share.

    Args:
        settings: Of a run.

    Attributes:
        sensors: Sensors and timing.
        files: Of the model; None of one that ships with leglab.
        nominal: The nominal machine in its rest pose; a run moves a machine of its own.
        controller_setup: What every controller may know.

    Raises:
        LeglabError: If the model or a setting does not fit.
    """

    def __init__(self, settings: RunSettings) -> None:
        check_tolerance(settings.tolerance)
        self._model, self._timestep = settings.model, settings.timestep
        self._parameters: dict[tuple[str, str], float] = {}
        self.files = model_files(settings.model)
        if settings.parameters:
            plain = Simulation(self._load(visual=False))
            self._parameters = placed_parameters(settings.parameters, plain.elements)
        asked = validate_configuration(SensorConfiguration, settings.sensors, "sensors")
        self.nominal = Simulation(self._load(visual=False))
        if self.files and model_digest(settings.model) != self.files.digest:
            raise changed_meanwhile(settings.model)
        timestep = self.nominal.model.opt.timestep
        self.sensors = in_whole_steps(asked, timestep)
        # Before anything is sized by the period.
        loop_timing(self.sensors, timestep)
        self.controller_setup = controller_setup(self.nominal, settings.model, self.sensors)

    def fitted(self, scenario: Scenario) -> Scenario:
        """The scenario as the machine can carry it out, with a motion that it can make.

        References for a leg give way to `multisine` where no joint is one of a leg.

        Raises:
            SettingsError: The machine has nothing that the scenario changes; lists those that fit.
        """
        known = fitted(scenario, self.nominal)
        if known.reference in LEG_REFERENCES and not set(self.nominal.joints) & set(GAIT):
            known = replace(known, reference="multisine", reference_config={})
        return known

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

    def start(self, simulation: Simulation, seed: int, tolerance: float = 0.0) -> None:
        """Puts a machine where a run starts: the seed's specimen, at rest in its rest pose.

        Args:
            simulation: From `machine`, in any state, its bodies without loads.
            seed: Picks the specimen, where there is a tolerance.
            tolerance: Relative standard deviation of its parameters [1].

        Raises:
            ModelError: If a cylinder cannot hold its joint there.
        """
        check_tolerance(tolerance)
        if tolerance or simulation.varied:
            self._restore(simulation)
            simulation.varied = bool(tolerance)
        if tolerance:
            vary_bodies(simulation.model, tolerance, seed)
        simulation.reset()
        if tolerance:
            vary_parameters(simulation, tolerance, seed)
        settle(simulation)

    def _restore(self, simulation: Simulation) -> None:
        """Undoes what `vary_bodies` and `vary_parameters` did to a model."""
        model, nominal = simulation.model, self.nominal.model
        fields = ("body_mass", "body_inertia", *(NATIVE_FIELDS if simulation.native else ()))
        for name in fields:
            if hasattr(model, name):
                getattr(model, name)[:] = getattr(nominal, name)
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def _load(self, *, visual: bool) -> Any:
        edit = partial(_edit, self._parameters) if self._parameters else None
        return load_model(self._model, timestep=self._timestep, visual=visual, edit=edit)


# Preparations that are kept for the next run with the same machine, by what decides them.
_PREPARED = 8


def prepared(settings: RunSettings, digest: str | None = None) -> Preparation:
    """The preparation of a run, kept in this process for the next runs of the same machine.

    Args:
        settings: Of the run.
        digest: Of the model as the run is to have it; None for the model as it is.

    Raises:
        LeglabError: As `Preparation`, or the model is another one by now.
    """
    now = model_digest(settings.model)
    if digest not in (None, now):
        raise changed_meanwhile(settings.model)
    # A path is that of another file where the process works in another folder.
    file = os.path.abspath(settings.model) if Path(settings.model).is_file() else ""
    shared = ("model", "timestep", "tolerance", "sensors", "parameters")
    values = {name: getattr(settings, name) for name in shared}
    key = json.dumps([file, now, values], sort_keys=True)
    return _prepared(key)


@lru_cache(_PREPARED)
def _prepared(key: str) -> Preparation:
    settings = json.loads(key)[-1]
    return Preparation(RunSettings(scenario="", **settings))


def basis_of(settings: RunSettings) -> dict[str, str]:
    """Digests of all that a run depends on beside its settings: what is kept of it goes by them.

    Raises:
        LeglabError: There is no such model, or MuJoCo refuses it.
    """
    return {"code": fingerprint(), "model_digest": model_digest(settings.model)}


def forget_preparations() -> None:
    """Frees the memory of all preparations that are kept."""
    _prepared.cache_clear()


def _edit(parameters: Mapping[tuple[str, str], float], spec: mujoco.MjSpec) -> None:
    """Writes parameters into a specification, by element and name."""
    plugins = {plugin.name: plugin for plugin in spec.plugins if plugin.name}
    plugins |= {a.name: plugins.get(a.plugin.name, a.plugin) for a in spec.actuators}
    for (element, name), value in parameters.items():
        plugin = plugins[element]
        plugin.config = {**plugin.config, name: repr(value)}


def reference_config(settings: RunSettings, scenario: Scenario) -> dict[str, Any]:
    """Settings of the reference: the scenario's, for its own reference, below the user's.

    Where the settings say so, the phase is the seed's.
    """
    own = settings.reference in (None, scenario.reference)
    kind = REFERENCES.get(settings.reference or scenario.reference).configuration
    drawn = {}
    if settings.vary and "phase" in kind.model_fields:
        drawn["phase"] = _draws(settings.seed)[1]
    known = scenario.reference_config if own else {}
    return {**drawn, **known, **settings.reference_config}


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
