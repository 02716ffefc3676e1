"""What an environment costs beside bare physics: `python benchmarks/environment_speed.py`.

One process, one core; bare stepping of the same model, the runner's closed loop and environments
take turns, and each figure is its best burst, so that other work disturbs all alike.
"""

import argparse
import time
from collections.abc import Callable

import mujoco
import numpy as np
import results

import leglab.environment
from leglab.machine.simulation import load_model

PERIODS = 400
BARE = "bare `mj_step`, with shapes"


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
    """The same as Gymnasium has it."""
    env = leglab.environment.load_gymnasium("seal_wear", action="residual")
    action = np.full(env.action_space.shape, 0.02)
    return env.reset, lambda: env.step(action)


def measure(options: argparse.Namespace) -> dict[str, dict[str, float]]:
    """Steps a second, and the time of one over bare physics."""
    cases = {
        "bare `mj_step`, without shapes": bare(visual=False),
        BARE: bare(visual=True),
        "dm_env, valve": dm_env(),
        "dm_env, residual on `static_feedforward`": dm_env(action="residual"),
        "dm_env, residual on `bsnn_arx`": dm_env(action="residual", controller="bsnn_arx"),
        "Gymnasium, residual on `static_feedforward`": gym(),
    }
    best = dict.fromkeys(cases, np.inf)
    for _ in range(options.bursts):
        for name, (start, step) in cases.items():
            start()
            begin = time.perf_counter()
            for _ in range(PERIODS):
                step()
            best[name] = min(best[name], (time.perf_counter() - begin) / PERIODS)
    return {
        name: {"steps_per_s": 1 / seconds, "over_bare": seconds / best[BARE]}
        for name, seconds in best.items()
    }


def tables(found: dict[str, dict[str, float]]) -> str:
    """A row a case."""
    rows = [
        (name, f"{row['steps_per_s']:,.0f}", results.number(row["over_bare"]))
        for name, row in found.items()
    ]
    head = ("leg, control periods of 2 ms", "steps/s", "time over bare physics")
    return results.table(head, rows)


def main() -> None:
    """Measures, or prints what is kept."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--bursts", type=int, default=20, help=f"of {PERIODS} periods")
    results.main(parser, measure, tables)


if __name__ == "__main__":
    main()
