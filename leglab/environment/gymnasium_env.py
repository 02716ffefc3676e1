"""The environment as Gymnasium knows it: shimmy's adapter with Gymnasium's seeding."""

from typing import Any

import gymnasium
from shimmy.dm_control_compatibility import DmControlCompatibilityV0


class LegEnv(DmControlCompatibilityV0):
    """An environment of `leglab.environment.load` for Gymnasium.

    A seed given to `reset` is that of the episode's run, as of `leglab run --seed`, and of what
    later episodes draw. An episode ends by truncation at its duration, by termination where the
    simulation blows up or an error exceeds the limit.
    """

    def __init__(
        self, env: Any, render_mode: str | None = None, render_kwargs: dict[str, Any] | None = None
    ) -> None:
        super().__init__(env, render_mode, render_kwargs)
        rate = round(1.0 / env.control_timestep())
        self.metadata = {"render_modes": ["rgb_array", "depth_array"], "render_fps": rate}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Starts the next episode; with a seed, the first of that seed's."""
        if seed is not None:
            self._env.task.reseed(seed)
        gymnasium.Env.reset(self, seed=seed)
        step = self._env.reset()
        return dict(step.observation), {}

    # Gymnasium's own generator, which shimmy replaces by the task's; that one is seeded alike.
    np_random = gymnasium.Env.np_random
