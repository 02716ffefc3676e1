"""Gymnasium and dm_env interfaces of a batch of machines."""

from typing import Any

import gymnasium
import numpy as np
from dm_env import StepType, TimeStep, specs
from gymnasium import spaces
from gymnasium.vector import AutoresetMode

from leglab.base.errors import SettingsError, SimulationError
from leglab.environment.batch import Batch
from leglab.environment.gymnasium_env import FRAME_RATE, RENDER_MODES

AUTORESETS = {"next_step": AutoresetMode.NEXT_STEP, "same_step": AutoresetMode.SAME_STEP}


class LegVectorEnv(gymnasium.vector.VectorEnv):
    """Batch of machines of `leglab.environment.make_batch` as a `gymnasium.vector.VectorEnv`.

    Observations are one float32 array with a row per machine, in the order of
    docs/guides/environments.md; the arrays that `reset` and `step` return are copies.

    `info` has arrays with a row per machine: `time` [s], the true `tracking_error` [rad], the sent
    `command`; for machines whose episode begins (mask `_scenario`) also `scenario`, `seed`,
    `severity`, `onset` and `ramp_duration`; for machines whose episode ends (mask `_ended`) also
    `ended`: "duration", "error_limit" or "blow_up". With autoreset in the same step, `final_obs`
    and `final_info` have the observation and the info of the last step of an episode.

    Args:
        batch: The machines.
        autoreset: "next_step" or "same_step".

    Raises:
        LeglabError: `autoreset` has another value.
    """

    def __init__(self, batch: Batch, *, autoreset: str = "next_step") -> None:
        if autoreset not in AUTORESETS:
            text = f"autoreset {autoreset!r} is not allowed; choose one of "
            raise SettingsError(text, given=autoreset, allowed=AUTORESETS)
        self.batch = batch
        self.num_envs = batch.count
        self.metadata = {
            "render_modes": list(RENDER_MODES),
            "render_fps": FRAME_RATE,
            "autoreset_mode": AUTORESETS[autoreset],
        }
        self._same_step = autoreset == "same_step"
        self.single_observation_space = spaces.Box(-batch.limits, batch.limits, dtype=np.float32)
        self.single_action_space = spaces.Box(-1.0, 1.0, (len(batch.joints),), np.float32)
        self.observation_space = gymnasium.vector.utils.batch_space(
            self.single_observation_space, self.num_envs
        )
        self.action_space = gymnasium.vector.utils.batch_space(
            self.single_action_space, self.num_envs
        )
        self._begun = False

    @property
    def dm_env(self) -> "BatchEnvironment":
        """The same machines with dm_env's interface."""
        return BatchEnvironment(self.batch)

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts episodes; with a single seed, machine i starts the first episode of seed + i.

        Args:
            seed: One number, or one per machine; None continues with the next episodes.
            options: "reset_mask": mask of the machines to reset, (machines,); by default all.
        """
        chosen = np.ones(self.num_envs, dtype=bool)
        if options and options.get("reset_mask") is not None:
            chosen = np.asarray(options["reset_mask"], dtype=bool)
            if chosen.shape != (self.num_envs,) or not self._begun:
                allowed = f"({self.num_envs},) after a first reset of all"
                text = f"reset_mask has shape {chosen.shape}, allowed is "
                raise SettingsError(text, given=chosen.shape, allowed=allowed)
        seeds = [None] * self.num_envs if seed is None else seed
        if isinstance(seeds, (int, np.integer)):
            seeds = [int(seeds) + i for i in range(self.num_envs)]
        if len(seeds) != self.num_envs:
            text = f"{len(seeds)} seeds for {self.num_envs} machines"
            raise SettingsError(text, given=len(seeds), allowed=str(self.num_envs))
        for i, each in enumerate(seeds):
            if each is not None and chosen[i]:
                self.batch.reseed(i, int(each))
        self.batch.reset(chosen)
        self._begun = True
        return self.batch.observation.copy(), {**self._info(), **self._told(chosen)}

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Runs one control period of every machine; see `gymnasium.vector.VectorEnv.step`.

        Raises:
            LeglabError: The actions have another shape or are not finite, or nothing was reset.
        """
        if not self._begun:
            raise SimulationError("step before reset")
        batch = self.batch
        reward, begun = batch.step(actions)  # with autoreset "same_step" no episode begins here
        terminated, truncated = batch.terminated.copy(), batch.truncated.copy()
        info = self._info()
        if begun.any():
            info |= self._told(begun)
        ended = terminated | truncated
        if ended.any():
            info |= self._ends(ended)
            if self._same_step:
                final = np.full(self.num_envs, None, dtype=object)
                for i in np.flatnonzero(ended).tolist():
                    final[i] = batch.observation[i].copy()
                last = dict(info)
                batch.reset(ended)
                info = {**self._info(), **self._told(ended)}
                info |= {"final_obs": final, "_final_obs": ended}
                info |= {"final_info": last, "_final_info": ended}
        return batch.observation.copy(), reward, terminated, truncated, info

    def close_extras(self, **kwargs: Any) -> None:
        """Closes the closed-loop runs of all machines, which restores their models."""
        if self._begun:
            for i in range(self.num_envs):
                self.batch.loop(i).close()

    def _info(self) -> dict[str, Any]:
        batch, every = self.batch, np.ones(self.num_envs, dtype=bool)
        error, command = batch.error.copy(), batch.command.copy()
        found = {"time": batch.time, "tracking_error": error, "command": command}
        return found | {f"_{name}": every for name in found}

    def _told(self, chosen: np.ndarray) -> dict[str, Any]:
        """Returns the entries of `info` for the episodes that begin."""
        count = self.num_envs
        found: dict[str, Any] = {
            "scenario": np.full(count, None, dtype=object),
            "seed": np.zeros(count, dtype=np.int64),
            "severity": np.full(count, np.nan),
            "onset": np.full(count, np.nan),
            "ramp_duration": np.zeros(count),
        }
        for i in np.flatnonzero(chosen).tolist():
            loop = self.batch.loop(i)
            found["scenario"][i] = loop.scenario.name
            found["seed"][i] = loop.settings.seed
            if loop.scenario.severity is not None:
                found["severity"][i] = loop.scenario.severity
            found["onset"][i] = min(loop.scenario.breakpoints, default=np.nan)
            found["ramp_duration"][i] = loop.settings.ramp_duration
        return found | {f"_{name}": chosen.copy() for name in found}

    def _ends(self, ended: np.ndarray) -> dict[str, Any]:
        why = np.full(self.num_envs, None, dtype=object)
        for i in np.flatnonzero(ended).tolist():
            why[i] = "duration"
            if self.batch.terminated[i]:
                why[i] = "blow_up" if self.batch.diverged[i] else "error_limit"
        return {"ended": why, "_ended": ended}


class BatchEnvironment:
    """dm_env interface of a batch of machines: arrays in time steps have a row per machine.

    The step after the last step of an episode begins the machine's next episode, as in dm_env, with
    reward 0 and discount 1.

    Args:
        batch: The machines.
    """

    def __init__(self, batch: Batch) -> None:
        self.batch = batch
        self._begun = False

    def reset(self) -> TimeStep:
        """Starts an episode in every machine."""
        every = np.ones(self.batch.count, dtype=bool)
        self.batch.reset(every)
        self._begun = True
        return self._time_step(np.zeros(self.batch.count), every)

    def step(self, action: np.ndarray) -> TimeStep:
        """Runs one control period; the first call resets.

        Args:
            action: Actions in [-1, 1], (machines, joints).

        Raises:
            LeglabError: The action has another shape or is not finite.
        """
        if not self._begun:
            return self.reset()
        return self._time_step(*self.batch.step(action))

    def observation_spec(self) -> specs.BoundedArray:
        """Returns the specification of one machine's observation."""
        ends = self.batch.limits
        return specs.BoundedArray(ends.shape, np.float32, -ends, ends, name="observations")

    def action_spec(self) -> specs.BoundedArray:
        """Returns the specification of one machine's action."""
        names = "\t".join(self.batch.joints)
        return specs.BoundedArray((len(self.batch.joints),), float, -1.0, 1.0, name=names)

    def _time_step(self, reward: np.ndarray, first: np.ndarray) -> TimeStep:
        batch = self.batch
        kind = np.full(batch.count, int(StepType.MID))
        kind[first] = int(StepType.FIRST)
        kind[batch.terminated | batch.truncated] = int(StepType.LAST)
        discount = np.where(batch.terminated, 0.0, 1.0)
        return TimeStep(kind, reward, discount, batch.observation.copy())
