"""Cost of environments beside bare physics.

On one core: bare stepping of a model, and environments in one process. On all cores: bare stepping
in a process a core, the batch in threads, and what Gymnasium and dm_control offer, in processes.
All cases of a table take turns, and each figure is its best burst, so that other work disturbs all
alike; ratios are of those.
"""

import argparse
import multiprocessing
import os
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from typing import Any

import gymnasium
import mujoco
import numpy as np

import leglab.environment
from benchmarks import results
from leglab.machine.plugin import headless
from leglab.machine.simulation import load_model

PERIODS = 400
# Periods in the shortest burst: of a large batch some hundredths of a second, as of the others.
_SHORTEST = 10
BARE = "bare `mj_step`, with shapes"
BARE_ALL = "bare `mj_step`, without shapes, one process a core"
CORES = len(os.sched_getaffinity(0))

_PROCESS = ExitStack()  # closes with the process

Case = tuple[Callable[[], Any], Callable[[], Any]]  # starts an episode, steps


def bare(visual: bool, hold: ExitStack | None = None) -> Case:
    """Two time steps a control period of 2 ms, valves moving, nothing else.

    With `hold` as fast as they can be until it closes: no sensors, no clock, no warnings.
    """
    model = load_model("leg", visual=visual)
    data = mujoco.MjData(model)
    if hold:
        hold.enter_context(headless(model))

    def start() -> None:
        mujoco.mj_resetDataKeyframe(model, data, 0)
        data.ctrl[:] = 0.02

    def step() -> None:
        mujoco.mj_step(model, data, 2)

    return start, step


def dm_env(**settings) -> Case:
    """An environment under a constant small action."""
    env = leglab.environment.load("seal_wear", **settings)
    action = np.full(env.action_spec().shape, 0.02)
    return env.reset, lambda: env.step(action)


def gym() -> Case:
    """The same as Gymnasium has it."""
    env = leglab.environment.load_gymnasium("seal_wear", action="residual")
    action = np.full(env.action_space.shape, 0.02)
    return env.reset, lambda: env.step(action)


def vector(env: gymnasium.vector.VectorEnv) -> Case:
    """Machines of a vector environment under a constant small action; begun once."""
    action = np.full(env.action_space.shape, 0.02)
    env.reset(seed=0)
    return lambda: None, lambda: env.step(action)


class Processes:
    """A case in one process a core, all running at once.

    Args:
        make: Makes the case, in each process.
    """

    def __init__(self, make: Callable[[], Case]) -> None:
        context = multiprocessing.get_context("forkserver")
        self._pipes, self._processes = [], []
        for _ in range(CORES):
            here, there = context.Pipe()
            process = context.Process(target=_serve, args=(make, there), daemon=True)
            process.start()
            self._pipes.append(here)
            self._processes.append(process)
        for pipe in self._pipes:
            pipe.recv()

    def burst(self, periods: int) -> float:
        """Wall time of so many periods in every process, starts left out [s]."""
        for pipe in self._pipes:
            pipe.send(periods)
        return max(pipe.recv() for pipe in self._pipes)

    def close(self) -> None:
        """Ends the processes."""
        for pipe, process in zip(self._pipes, self._processes, strict=True):
            pipe.send(None)
            process.join()


def _serve(make: Callable[[], Case], pipe: Any) -> None:
    start, step = make()
    pipe.send("ready")
    while (periods := pipe.recv()) is not None:
        pipe.send(burst((start, step), periods))


def bare_headless() -> Case:
    """Bare stepping without shapes, as fast as it can be, as long as the process lasts."""
    return bare(visual=False, hold=_PROCESS)


def burst(case: Case, periods: int) -> float:
    """Wall time of so many periods, the start left out [s]."""
    start, step = case
    start()
    begin = time.perf_counter()
    for _ in range(periods):
        step()
    return time.perf_counter() - begin


def one_core(bursts: int) -> dict[str, dict[str, float]]:
    """Steps a second in one process, and the time of one over bare physics."""
    cases = {
        "bare `mj_step`, without shapes": bare(visual=False),
        BARE: bare(visual=True),
        "dm_env, valve": dm_env(),
        "dm_env, residual on `static_feedforward`": dm_env(action="residual"),
        "dm_env, residual on `bsnn_arx`": dm_env(action="residual", controller="bsnn_arx"),
        "Gymnasium, residual on `static_feedforward`": gym(),
    }
    best = dict.fromkeys(cases, np.inf)
    for _ in range(bursts):
        for name, case in cases.items():
            best[name] = min(best[name], burst(case, PERIODS) / PERIODS)
    return {
        name: {"steps_per_s": 1 / seconds, "over_bare": seconds / best[BARE]}
        for name, seconds in best.items()
    }


def all_cores(rounds: int, machines: int) -> dict[str, dict[str, float]]:
    """Steps a second of all machines together, and the share of bare stepping's."""
    residual = {"action": "residual"}
    make = partial(leglab.environment.make_batch, machines, "seal_wear")
    asynchronous = gymnasium.vector.AsyncVectorEnv(
        [partial(leglab.environment.load_gymnasium, "seal_wear", **residual)] * (2 * CORES),
        context="forkserver",
    )
    bare_processes, dm_processes = Processes(bare_headless), Processes(partial(dm_env, **residual))
    cases: dict[str, tuple[int, Callable[[int], float]]] = {
        BARE_ALL: (CORES, bare_processes.burst),
        f"`make_batch({machines})`, valve": (machines, partial(burst, vector(make()))),
        f"`make_batch({machines})`, residual on `static_feedforward`": (
            machines,
            partial(burst, vector(make(**residual))),
        ),
        f"`make_batch({machines})`, residual on `bsnn_arx`": (
            machines,
            partial(burst, vector(make(**residual, controller="bsnn_arx"))),
        ),
        f"Gymnasium's `AsyncVectorEnv` of {2 * CORES}, residual on `static_feedforward`": (
            2 * CORES,
            partial(burst, vector(asynchronous)),
        ),
        "dm_control, one process a core, residual on `static_feedforward`": (
            CORES,
            dm_processes.burst,
        ),
    }
    best = dict.fromkeys(cases, np.inf)
    for _ in range(rounds):
        for name, (count, run) in cases.items():
            periods = max(_SHORTEST, PERIODS * CORES // count)
            best[name] = min(best[name], run(periods) / periods / count)
    for case in (bare_processes, dm_processes, asynchronous):
        case.close()
    return {
        name: {"steps_per_s": 1 / seconds, "of_bare": best[BARE_ALL] / seconds}
        for name, seconds in best.items()
    }


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Both tables."""
    return {
        "one_core": one_core(options.bursts),
        "all_cores": all_cores(options.rounds, options.machines),
        "cores": CORES,
    }


def tables(found: dict[str, Any]) -> str:
    """Both tables, a row a case."""
    one = [
        (name, f"{row['steps_per_s']:,.0f}", results.number(row["over_bare"]))
        for name, row in found["one_core"].items()
    ]
    every = [
        (name, f"{row['steps_per_s']:,.0f}", f"{100 * row['of_bare']:.0f} %")
        for name, row in found["all_cores"].items()
    ]
    head = "leg, control periods of 2 ms"
    return "\n\n".join(
        (
            results.table((f"{head}, one core", "steps/s", "time over bare physics"), one),
            results.table(
                (f"{head}, {found['cores']} cores", "steps/s of all", "of bare physics"), every
            ),
        )
    )


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--bursts", type=int, default=20, help=f"of {PERIODS} periods")
    parser.add_argument(
        "--rounds", type=int, default=100, help="bursts on all cores, some hundredths of a second"
    )
    parser.add_argument("--machines", type=int, default=64, help="in a batch")
