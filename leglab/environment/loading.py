"""Makes environments from names."""

import importlib.util
import math
import os
import sys
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import leglab.scenarios  # noqa: F401  registers the scenarios
from leglab.base.errors import LeglabError, SettingsError
from leglab.base.scenario import scenario_names
from leglab.environment.episodes import Draw, Episodes
from leglab.environment.plan import PREVIEW, Plan, made_plan
from leglab.environment.rewards import Reward
from leglab.machine.display import has_display

if TYPE_CHECKING:
    import gymnasium
    from dm_control.rl import control

    from leglab.environment.vector_env import LegVectorEnv


def load(  # noqa: D417  RunSettings describes the others
    scenario: str = "seal_wear",
    *,
    model: str = "leg",
    action: str = "valve",
    controller: str | None = None,
    controller_config: Mapping[str, Any] | None = None,
    residual_scale: float = 0.2,
    reward: str | Reward = "tracking",
    reference: str | None = None,
    reference_config: Mapping[str, Any] | None = None,
    severity: float | None = None,
    ramp_duration: float = 0.0,
    element: str | None = None,
    onset: float | None = None,
    duration: float | None = None,
    control_period: float | None = None,
    sensors: Mapping[str, Any] | None = None,
    timestep: float | None = None,
    tolerance: float = 0.0,
    seed: int = 0,
    randomize: Mapping[str, Any] | Draw | None = None,
    preview: Sequence[float] = PREVIEW,
    error_limit: float = math.inf,
    normalize: bool = True,
    flat_observation: bool = False,
) -> "control.Environment":
    """Makes a `dm_control.rl.control.Environment`: one step is one control period.

    Args:
        scenario: Name of the scenario; its changes happen in the episode as in a run.
        action: "valve": valve commands in [-1, 1]. "residual": `residual_scale` times the action
            is added to the command of a controller, and the sum clipped to [-1, 1]. "torque": the
            action times the task's `torque_limit` is a torque; a force loop computes the commands.
        controller: Name of the controller for residual actions; None for static_feedforward.
        residual_scale: Valve command that a residual action of 1 stands for, in (0, 2].
        reward: Name of a reward in `REWARDS`, or a function of a `Transition`.
        onset: Time at which the first change begins [s]; None for the scenario's own time.
        control_period: Control period [s]; None for the one in the sensor settings.
        randomize: None: every episode is the run of `seed`, bit for bit. Otherwise each episode
            draws a new seed and further values: by a mapping of severity, onset [s], ramp_duration
            [s], tolerance or seed to ranges (low, high) and of scenario to names, or by a function
            of a `numpy.random.RandomState` that returns values by these names.
        preview: Times ahead of the present at which the observation contains the reference [s].
        error_limit: True error of a joint [rad] beyond which the episode terminates.
        normalize: Whether `leglab.environment.observations` scales observations to about one within
            finite bounds; otherwise they are in SI units.
        flat_observation: Whether the observation is one array.

    All other arguments are those of `leglab.runs.preparation.RunSettings`.

    Raises:
        LeglabError: A name or a setting does not fit, or dm_control is missing.
    """
    settings = dict(locals())  # the arguments; copied, since a debugger writes into the original
    del settings["randomize"], settings["flat_observation"]
    _require("dm_control.mujoco")
    return _environment(made_plan(**settings), randomize, flat=flat_observation)


def _environment(
    plan: Plan, randomize: Mapping[str, Any] | Draw | None, *, flat: bool
) -> "control.Environment":
    """Makes the environment of a plan; `flat`: whether an observation is one array."""
    from dm_control.rl import control

    from leglab.environment.physics import LegPhysics
    from leglab.environment.task import TrackingTask

    simulation = plan.preparation.machine(visual=True)
    return control.Environment(
        LegPhysics.of(simulation),
        TrackingTask(plan, simulation, Episodes(plan.base, randomize), flat=flat),
        # Half a period less than the duration, so that rounding cannot add a period.
        time_limit=(plan.periods - 0.5) * plan.period,
        control_timestep=plan.period,
        flat_observation=flat,
        legacy_step=False,
    )


def make_batch(
    num_envs: int,
    scenario: str = "seal_wear",
    *,
    threads: int | None = None,
    autoreset: str = "next_step",
    randomize: Mapping[str, Any] | Draw | None = None,
    **settings: Any,
) -> "LegVectorEnv":
    """Makes many environments that are stepped together in threads, as one Gymnasium `VectorEnv`.

    Machine i has the episodes of `load_gymnasium(scenario, seed=seed + i, flat_observation=True)`,
    bit for bit, with any number of threads. `.dm_env` is the same batch with dm_env's interface.

    Args:
        num_envs: Number of machines.
        scenario: Name of the scenario.
        threads: Number of threads that step machines; None for one per core.
        autoreset: "next_step": the step after an episode's last step begins the next episode;
            "same_step": the last step itself does, and `info` has its final observation.
        randomize: As for `load`.
        settings: As for `load`, without `flat_observation`: an observation is one array.

    Raises:
        LeglabError: A name or a setting does not fit, or a package is missing.
    """
    for name, count in (("num_envs", num_envs), ("threads", threads)):
        if count is not None and count < 1:
            text = f"{name} {count} is not allowed, must be "
            raise SettingsError(text, given=count, allowed="1 or more")
    _require("dm_control.mujoco", "gymnasium")
    from leglab.environment.batch import Batch
    from leglab.environment.vector_env import LegVectorEnv

    plan = made_plan(scenario, **settings)
    own, episodes = plan.base.settings, []
    for i in range(num_envs):
        base = replace(plan.base, settings=replace(own, seed=own.seed + i))
        episodes.append(Episodes(base, randomize))
    return LegVectorEnv(Batch(plan, episodes, threads=threads), autoreset=autoreset)


def load_gymnasium(
    scenario: str = "seal_wear",
    *,
    render_mode: str | None = None,
    camera: str = "three_quarter",
    width: int = 640,
    height: int = 480,
    **settings: Any,
) -> "gymnasium.Env":
    """Makes the environment of `load` with the interface of Gymnasium.

    Gymnasium knows it by one name per scenario, such as "leglab/SealWear-v0".

    Args:
        scenario: Name of the scenario.
        render_mode: "rgb_array" for pictures by `render()`, "depth_array" for depths, "human" for
            a window, or None.
        camera: Name of a camera of the model.
        width: Width of the pictures [px].
        height: Height of the pictures [px].
        settings: As for `load`.

    Raises:
        LeglabError: A name or a setting does not fit, or a package is missing.
    """
    _require("dm_control.mujoco", "gymnasium")
    from leglab.environment.gymnasium_env import LegEnv

    return LegEnv(
        load(scenario, **settings),
        render_mode=render_mode,
        camera=camera,
        width=width,
        height=height,
    )


def register() -> None:
    """Registers one environment per scenario if Gymnasium is installed."""
    if importlib.util.find_spec("gymnasium") is None:
        return
    import gymnasium

    for scenario in scenario_names():
        gymnasium.register(
            id=f"leglab/{scenario.title().replace('_', '')}-v0",
            entry_point="leglab.environment.loading:load_gymnasium",
            vector_entry_point="leglab.environment.loading:make_batch",
            kwargs={"scenario": scenario},
        )


def _choose_renderer() -> None:
    """Makes dm_control render off-screen if there is no display and MUJOCO_GL is not set.

    Otherwise dm_control would use GLFW, which ends the process at the first picture.
    """
    if has_display() or os.environ.get("MUJOCO_GL") or "dm_control._render" in sys.modules:
        return
    for backend in ("egl", "osmesa"):
        os.environ["MUJOCO_GL"] = backend
        try:
            importlib.import_module("dm_control._render")
        except Exception:  # PyOpenGL raises several kinds of exception if a library is missing
            os.environ.pop("PYOPENGL_PLATFORM", None)  # dm_control has set it for this backend
            continue
        finally:
            del os.environ["MUJOCO_GL"]
        return


def _require(*modules: str) -> None:
    with warnings.catch_warnings():
        # Without a display dm_control tries GLFW, which warns.
        warnings.filterwarnings("ignore", message=".*DISPLAY environment variable")
        _choose_renderer()
        for module in modules:
            try:
                importlib.import_module(module)
            except ImportError as error:
                raise LeglabError(
                    f"the environment needs {module.partition('.')[0]} ({error}): "
                    'pip install ".[rl]" in a clone of leglab'
                ) from error
