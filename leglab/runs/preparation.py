"""Preparation of a run from its settings: nominal machine, specimen, reference."""

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
from leglab.references import GAIT, LEG_REFERENCES, Joint, Reference, make_reference
from leglab.references.base import REFERENCES
from leglab.references.from_file import NAME as FILE
from leglab.references.from_file import digest_of, is_file


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
        name = self.reference
        if name is not None and is_file(name):
            found = {"file": os.path.abspath(name), "digest": digest_of(name)}
            object.__setattr__(self, "reference", FILE)
            object.__setattr__(self, "reference_config", {**self.reference_config, **found})


def scenario_of(settings: RunSettings, preparation: "Preparation | None" = None) -> Scenario:
    """Builds the scenario of a run from its settings and the nominal parameters of its machine.

    Args:
        settings: Settings of the run.
        preparation: Preparation of the run; None to make one if a model parameter is needed.

    Raises:
        SettingsError: The seed, the name or an option of the scenario is not allowed.
    """
    if settings.seed < 0:
        text = f"seed {settings.seed} is negative; allowed: "
        raise SettingsError(text, given=settings.seed, allowed="0 or more")
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
    """Returns a parameter's values at those elements of the nominal machine that change."""
    if preparation is None:  # omits `parameters`, so that a sweep over them compiles the model once
        plain = RunSettings(scenario="", model=settings.model, timestep=settings.timestep)
        preparation = prepared(plain)
    placed = placed_parameters(settings.parameters, preparation.nominal.elements)
    return healthy_values(preparation.nominal, parameter, settings.element, placed)


def _draws(seed: int) -> tuple[float, float]:
    """Draws shares in [0, 1) for change time and phase; independent of noise and specimen."""
    time, phase = np.random.default_rng([seed, 3]).random(2).tolist()
    return time, phase


def check_controllers(names: Sequence[str]) -> None:
    """Tests that names of controllers are known and not repeated.

    Raises:
        SettingsError: A name is unknown or repeated; the message names the first one.
    """
    for i, name in enumerate(names):
        CONTROLLERS.get(name)
        if name in names[:i]:
            raise SettingsError(f"controllers: {name!r} is given twice", given=name)


class Preparation:
    """Machine and controller setup that runs with the same model and sensors share.

    Args:
        settings: Settings of a run.

    Attributes:
        sensors: Sensors and timing.
        files: Files of the model; None for a model that ships with leglab.
        nominal: The nominal machine in its rest pose; each run simulates a copy.
        controller_setup: Data about the machine that every controller may use.

    Raises:
        LeglabError: The model or a setting is not valid.
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
        # Checks the timing before arrays are allocated by the control period.
        loop_timing(self.sensors, timestep)
        self.controller_setup = controller_setup(self.nominal, settings.model, self.sensors)

    def fitted(self, scenario: Scenario) -> Scenario:
        """Returns the scenario adapted to the machine, with a reference that its joints can follow.

        References for legs are replaced by `multisine` if no joint is a leg joint.

        Raises:
            SettingsError: The machine lacks what the scenario changes; lists suitable scenarios.
        """
        known = fitted(scenario, self.nominal)
        if known.reference in LEG_REFERENCES and not set(self.nominal.joints) & set(GAIT):
            known = replace(known, reference="multisine", reference_config={})
        return known

    def reference(self, settings: RunSettings, scenario: Scenario) -> Reference:
        """Returns the reference trajectory of a run for the nominal machine's joints."""
        return make_reference(
            settings.reference or scenario.reference,
            reference_joints(self.nominal),
            reference_config(settings, scenario),
            seed=settings.seed,
        )

    def machine(self, *, visual: bool = False) -> Simulation:
        """Returns a new machine for runs, which `start` brings to the initial state of a run.

        Args:
            visual: Whether the model includes shapes that serve rendering only.
        """
        return Simulation(self._load(visual=True) if visual else copy.copy(self.nominal.model))

    def start(self, simulation: Simulation, seed: int, tolerance: float = 0.0) -> None:
        """Resets a machine to the start of a run: the seed's specimen, at rest in its rest pose.

        Args:
            simulation: Machine from `machine`, in any state, without loads on its bodies.
            seed: Seed that selects the specimen, used if `tolerance` is not 0.
            tolerance: Relative standard deviation of the specimen's parameters [1].

        Raises:
            ModelError: A cylinder cannot hold its joint in the rest pose.
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


# Number of preparations that are cached for further runs with the same machine.
_PREPARED = 8


def prepared(settings: RunSettings, digest: str | None = None) -> Preparation:
    """Returns the preparation of a run, cached in this process for runs with the same machine.

    Args:
        settings: Settings of the run.
        digest: Required digest of the model's files; None to take the model as it is.

    Raises:
        LeglabError: As `Preparation`, or the model's files have changed.
    """
    now = model_digest(settings.model)
    if digest not in (None, now):
        raise changed_meanwhile(settings.model)
    # Absolute, since a relative path depends on the working folder of the process.
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
    """Returns digests of code and model, which decide whether stored results are up to date.

    Raises:
        LeglabError: The model does not exist, or MuJoCo rejects it.
    """
    return {"code": fingerprint(), "model_digest": model_digest(settings.model)}


def forget_preparations() -> None:
    """Frees the memory of all cached preparations."""
    _prepared.cache_clear()


def _edit(parameters: Mapping[tuple[str, str], float], spec: mujoco.MjSpec) -> None:
    """Sets plugin parameters in a model specification, by element and name."""
    plugins = {plugin.name: plugin for plugin in spec.plugins if plugin.name}
    plugins |= {a.name: plugins.get(a.plugin.name, a.plugin) for a in spec.actuators}
    for (element, name), value in parameters.items():
        plugin = plugins[element]
        plugin.config = {**plugin.config, name: repr(value)}


def reference_config(settings: RunSettings, scenario: Scenario) -> dict[str, Any]:
    """Merges settings of the reference: the user's, and for its default reference the scenario's.

    With `vary` the seed draws the phase, unless scenario or user set it.
    """
    own = settings.reference in (None, scenario.reference)
    kind = REFERENCES.get(settings.reference or scenario.reference).configuration
    drawn = {}
    if settings.vary and "phase" in kind.model_fields:
        drawn["phase"] = _draws(settings.seed)[1]
    known = scenario.reference_config if own else {}
    return {**drawn, **known, **settings.reference_config}


def reference_joints(simulation: Simulation) -> tuple[Joint, ...]:
    """Returns the driven joints with their limits and the current pose as rest position."""
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
