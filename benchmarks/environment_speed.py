"""What an environment costs beside bare physics: `python benchmarks/environment_speed.py`.

One process, one core; bare stepping of the same model, the runner's closed loop and environments
take turns, and each figure is its best burst, so that other work disturbs all alike.
"""

import time
from collections.abc import Callable

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

import leglab.environment
from leglab.simulation import load_model

BURSTS, PERIODS = 20, 400


def bare(visual: bool) -> tuple[Callable[[], None], Callable[[], None]]:
    """Two time steps a control period of 2 ms, valves moving, nothing else."""
    model = load_model("leg", visual=visual)
    data = mujoco.MjData(model)

    def start() -> None:
        mujoco.mj_resetDataKeyframe(model, data, 0)
        data.ctrl[:] = 0.02

    def step() -> None:
        mujoco.mj_step(model, data, 2)

    return start, step


def dm_env(**settings) -> tuple[Callable[[], None], Callable[[], None]]:
    """An environment under a constant small action."""
    env = leglab.environment.load("seal_wear", **settings)
    action = np.full(env.action_spec().shape, 0.02)
    return env.reset, lambda: env.step(action)


def gym() -> tuple[Callable[[], None], Callable[[], None]]:
    """The same through shimmy."""
    env = leglab.environment.load_gymnasium("seal_wear", action="residual")
    action = np.full(env.action_space.shape, 0.02)
    return env.reset, lambda: env.step(action)


def main() -> None:
    """Prints the table."""
    cases = {
        "bare mj_step, without shapes": bare(visual=False),
        "bare mj_step, with shapes": bare(visual=True),
        "dm_env, valve": dm_env(),
        "dm_env, residual on static_feedforward": dm_env(action="residual"),
        "dm_env, residual on bsnn_arx": dm_env(action="residual", controller="bsnn_arx"),
        "Gymnasium, residual on static_feedforward": gym(),
    }
    best = dict.fromkeys(cases, np.inf)
    for _ in range(BURSTS):
        for name, (start, step) in cases.items():
            start()
            begin = time.perf_counter()
            for _ in range(PERIODS):
                step()
            best[name] = min(best[name], (time.perf_counter() - begin) / PERIODS)
    reference = best["bare mj_step, with shapes"]
    table = Table(title="control periods of 2 ms, model leg")
    for column in ("", "steps/s", "x real time", "time over bare physics"):
        table.add_column(column, justify="right")
    for name, seconds in best.items():
        table.add_row(
            name, f"{1 / seconds:.0f}", f"{2e-3 / seconds:.0f}", f"{seconds / reference:.2f}"
        )
    Console().print(table)


if __name__ == "__main__":
    main()
