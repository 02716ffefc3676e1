"""Validated settings of an environment, and the objects that follow from them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from leglab.base.errors import ModelError, SettingsError
from leglab.control.backstepping.data import NominalCylinders
from leglab.environment.episodes import Episode
from leglab.environment.rewards import REWARDS, Reward
from leglab.machine.simulation import Simulation
from leglab.runs.loop import Loop
from leglab.runs.preparation import Preparation, RunSettings

ACTIONS = ("valve", "residual", "torque")
PREVIEW = (0.02, 0.05, 0.1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """Settings of an environment or a batch of them."""

    preparation: Preparation  #: Preparation of the runs
    base: Episode  #: The episode to vary
    periods: int  #: Number of control periods of an episode
    #: Valve command that an action of 1 adds to the controller's; None without a controller.
    residual_scale: float | None
    #: Data sheets of the cylinders if actions are torques; None if they are valve commands.
    cylinders: NominalCylinders | None
    reward: Reward  #: Function of a transition that returns the reward
    #: Times at which the observation contains the reference, in control periods ahead, (n,).
    ahead: np.ndarray
    error_limit: float  #: True error of a joint [rad] beyond which an episode terminates
    normalize: bool  #: Whether observations are scaled to about one

    @property
    def period(self) -> float:
        """Control period [s]."""
        return self.preparation.sensors.control_period

    def loop(self, episode: Episode, simulation: Simulation, *, controlled: bool) -> Loop:
        """Makes the closed loop of an episode; `controlled`: whether the loop has a controller."""
        return Loop(
            episode.settings,
            preparation=self.preparation,
            scenario=episode.scenario(),
            simulation=simulation,
            controlled=controlled,
            pressures=True,
            ahead=int(self.ahead.max(initial=0)),
        )


def made_plan(
    scenario: str,
    *,
    model: str = "leg",
    action: str = "valve",
    controller: str | None = None,
    controller_config: Mapping[str, Any] | None = None,
    residual_scale: float = 0.2,
    reward: str | Reward = "tracking",
    onset: float | None = None,
    duration: float | None = None,
    control_period: float | None = None,
    sensors: Mapping[str, Any] | None = None,
    reference_config: Mapping[str, Any] | None = None,
    preview: Sequence[float] = PREVIEW,
    error_limit: float = math.inf,
    normalize: bool = True,
    **run: Any,
) -> Plan:
    """Checks settings of `leglab.environment.load`, makes the plan; `run`: other `RunSettings`."""
    controlled = controller is not None or bool(controller_config)
    _check_actions(action, residual_scale, controlled=controlled)
    if not error_limit > 0:
        text = f"error_limit {error_limit!r} rad is not allowed, must be "
        raise SettingsError(text, given=error_limit, allowed="> 0")
    if not all(0 <= ahead < math.inf for ahead in preview):
        text = f"preview {tuple(preview)} s is not allowed, all must be "
        raise SettingsError(text, given=tuple(preview), allowed=">= 0")
    if not callable(reward) and reward not in REWARDS:
        raise SettingsError.unknown("reward", reward, REWARDS)
    timing = {} if control_period is None else {"control_period": control_period}
    settings = RunSettings(
        scenario=scenario,
        controller=controller or "static_feedforward",
        model=model,
        duration=duration,
        reference_config=reference_config or {},
        controller_config=controller_config or {},
        sensors={**(sensors or {}), **timing},
        **run,
    )
    length = Episode(settings=settings, onset=onset).scenario().duration
    preparation = Preparation(settings)
    period = preparation.sensors.control_period
    return Plan(
        preparation=preparation,
        # Every episode has the duration of this scenario, even if another scenario is drawn.
        base=Episode(settings=replace(settings, duration=length), onset=onset),
        periods=round(length / period),
        residual_scale=residual_scale if action == "residual" else None,
        cylinders=_cylinders(preparation) if action == "torque" else None,
        reward=reward if callable(reward) else REWARDS[reward],
        ahead=np.array([round(ahead / period) for ahead in preview], dtype=np.int64),
        error_limit=error_limit,
        normalize=normalize,
    )


def _check_actions(action: str, residual_scale: float, *, controlled: bool) -> None:
    """Raises `SettingsError` if actions are of no known kind, or do not fit the controller."""
    if action not in ACTIONS:
        text = f"action {action!r} is not allowed; choose one of "
        raise SettingsError(text, given=action, allowed=ACTIONS)
    if action != "residual" and controlled:
        text = f"a controller acts with action='residual' only; here it is {action!r}"
        raise SettingsError(text, given=action, allowed=("residual",))
    if not 0 < residual_scale <= 2:
        text = f"residual_scale {residual_scale!r} is outside "
        raise SettingsError(text, given=residual_scale, allowed="(0, 2]")


def _cylinders(preparation: Preparation) -> NominalCylinders:
    """Returns data sheets for torque actions; raises `ModelError` for drives without a cylinder."""
    if preparation.nominal.native:
        name = next(iter(preparation.nominal.native))
        raise ModelError(
            f"action 'torque' needs cylinders, and actuator {name!r} is none; allowed: 'valve', "
            "which is the torque of a motor, and 'residual'",
            given=name,
            allowed=("valve", "residual"),
        )
    return preparation.controller_setup.machine.cylinders


def checked_action(action: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Converts an action to an array and checks its shape: (joints,), or (machines, joints).

    Raises:
        SettingsError: The action has another shape or is not finite.
    """
    values = np.asarray(action, dtype=float)
    if values.shape != shape:
        text = f"action has shape {values.shape}, allowed is "
        raise SettingsError(text, given=values.shape, allowed=str(shape))
    fine = np.isfinite(values).all(axis=-1)
    if not fine.all():
        row = int(np.argmin(fine))
        of_batch = values.ndim > 1
        which = f"of machine {row}" if of_batch else str(values.tolist())
        given = values[row] if of_batch else values
        text = f"action {which} is not finite; allowed: "
        raise SettingsError(text, given=given, allowed="numbers in [-1, 1]")
    return values
