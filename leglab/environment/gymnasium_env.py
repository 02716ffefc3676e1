"""Gymnasium interface of the environment."""

import time
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from dm_control.rl.control import FLAT_OBSERVATION_KEY
from dm_env import TimeStep, specs
from gymnasium import spaces

from leglab.base.errors import SettingsError
from leglab.environment.task import ends
from leglab.machine.display import LiveWindow, check_display, has_display

if TYPE_CHECKING:
    from dm_control.rl import control

RENDER_MODES = ("human", "rgb_array", "depth_array")
# Pictures per second of the window and of films. A film with one picture per step is slow motion.
FRAME_RATE = 50
# `USUAL_CAMERA`: default camera. `FREE_CAMERA`: MuJoCo's index of the free camera, used without it.
USUAL_CAMERA, FREE_CAMERA = "three_quarter", -1


class LegEnv(gymnasium.Env):
    """An environment of `leglab.environment.load` for Gymnasium.

    Observations are float32: one array with `flat_observation=True`, otherwise a dict of arrays.

    A seed passed to `reset` seeds the episode's run, as in `leglab run --seed`, and the draws of
    later episodes. An episode is truncated when its duration is over, and terminated if the
    simulation blows up or an error exceeds the limit.

    `info` has `time` [s], the true `tracking_error` [rad], (joints,), and the sent `command` in
    [-1, 1], (joints,). After `reset` it has also the episode's `scenario`, `seed`, `severity`,
    `onset` [s] (None without a change) and `ramp_duration` [s]; after the last step also `ended`:
    "duration", "error_limit" or "blow_up".

    Args:
        env: Environment made by `leglab.environment.load`.
        render_mode: One of `RENDER_MODES`, or None.
        camera: Name of a camera of the model; the free camera if the model lacks the default one.
        width: Width of the pictures [px].
        height: Height of the pictures [px].

    Attributes:
        dm_env: The environment of dm_control.
        task: The environment's `leglab.environment.task.TrackingTask`.
        physics: The environment's `leglab.environment.physics.LegPhysics`.

    Raises:
        LeglabError: The render mode or camera does not exist, or there is no display for a window.
    """

    def __init__(
        self,
        env: "control.Environment",
        *,
        render_mode: str | None = None,
        camera: str = USUAL_CAMERA,
        width: int = 640,
        height: int = 480,
    ) -> None:
        if render_mode not in (None, *RENDER_MODES):
            modes = f"{', '.join(RENDER_MODES)}, or None"
            text = f"render_mode {render_mode!r} is not allowed; choose one of {modes}"
            raise SettingsError(text, given=render_mode, allowed=RENDER_MODES)
        if render_mode == "human":
            check_display("render_mode 'human'", 'use render_mode="rgb_array" and MUJOCO_GL=egl')
        shown = [mode for mode in RENDER_MODES if mode != "human" or has_display()]
        self.metadata = {"render_modes": shown, "render_fps": FRAME_RATE}
        self.render_mode = render_mode
        self.dm_env, self.task, self.physics = env, env.task, env.physics
        cameras = [self.physics.model.ptr.camera(i).name for i in range(self.physics.model.ncam)]
        if camera not in (*cameras, USUAL_CAMERA):
            raise SettingsError.unknown("camera", camera, [*cameras, USUAL_CAMERA])
        self._camera: str | int = camera if camera in cameras else FREE_CAMERA
        self._size = {"width": width, "height": height}
        self._window: LiveWindow | None = None
        self._shown = 0.0  # simulated time of the window's last picture [s]
        named = env.observation_spec()
        self._flat = tuple(named) == (FLAT_OBSERVATION_KEY,)
        self.observation_space = (
            _box(named[FLAT_OBSERVATION_KEY])
            if self._flat
            else spaces.Dict({name: _box(spec) for name, spec in named.items()})
        )
        self.action_space = _box(env.action_spec())

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Starts the next episode; with a seed, the first episode of that seed."""
        super().reset(seed=seed)
        if seed is not None:
            self.task.reseed(seed)
        step = self.dm_env.reset()
        if self.render_mode == "human":
            self._show()
        settings, scenario = self.task.episode.settings, self.task.scenario
        told = {
            "scenario": scenario.name,
            "seed": settings.seed,
            "severity": scenario.severity,
            "onset": min(scenario.breakpoints, default=None),
            "ramp_duration": settings.ramp_duration,
        }
        return self._observation(step), {**self._info(), **told}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Runs one control period; see `gymnasium.Env.step`.

        Raises:
            LeglabError: The action has another shape, or is not finite.
        """
        step = self.dm_env.step(action)
        if self.render_mode == "human" and self.task.time - self._shown >= 1.0 / FRAME_RATE:
            self._show()
        terminated = step.last() and step.discount == 0.0
        truncated = step.last() and not terminated
        info = self._info()
        if step.last():
            why = "blow_up" if self.task.diverged else "error_limit"
            info["ended"] = "duration" if truncated else why
        return self._observation(step), float(step.reward), terminated, truncated, info

    def render(self) -> np.ndarray | None:
        """Returns a picture, (height, width, 3) of uint8, or the depth in m, (height, width).

        Returns None without a render mode and for "human", because `step` updates the window.
        """
        if self.render_mode in (None, "human"):
            return None
        depth = self.render_mode == "depth_array"
        return self.physics.render(camera_id=self._camera, depth=depth, **self._size)

    def close(self) -> None:
        """Closes the window and the physics."""
        if self._window is not None:
            self._window.close()
            self._window = None
        self.dm_env.close()

    def _show(self) -> None:
        """Updates MuJoCo's window; waits so that the motion is not faster than real time."""
        if self._window is None:
            self._window = LiveWindow(
                self.physics.model.ptr,
                self.physics.data.ptr,
                camera=str(self._camera),
                show_left_ui=False,
                show_right_ui=False,
            )
            self._clock = time.monotonic()
        passed = self.task.time - self._shown
        if passed > 0:
            time.sleep(max(0.0, passed - (time.monotonic() - self._clock)))
        self._shown, self._clock = self.task.time, time.monotonic()
        self._window.handle.sync()

    def _observation(self, step: TimeStep) -> Any:
        found = step.observation
        if self._flat:
            return found[FLAT_OBSERVATION_KEY].astype(np.float32)
        return {name: values.astype(np.float32) for name, values in found.items()}

    def _info(self) -> dict[str, Any]:
        transition = self.task.transition()
        return {
            "time": transition.time,
            "tracking_error": transition.error,
            "command": transition.command.copy(),
        }


def _box(spec: specs.Array) -> spaces.Box:
    """Returns the float32 space that corresponds to a dm_env specification."""
    low, high = (end.astype(np.float32) for end in ends(spec))
    return spaces.Box(low=low, high=high, dtype=np.float32)
