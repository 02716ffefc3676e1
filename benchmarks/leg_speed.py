"""Cost of six cylinders. Ratios of one run on one core.

The step of leg.xml against the same leg with native motors on the same tendons, and the closed
loop against real time, with PD and with six adaptive identifiers. Measurements alternate and each
figure is its best burst, so that other work on the machine disturbs both sides alike; the median
says how much it did. Runs of the loop are longer than a quiet moment of a shared machine: their
ratio to `pd` is the median of those to the run of `pd` in the same turn.
"""

import argparse
import statistics
import time
from typing import Any

import mujoco
import numpy as np

from benchmarks import results
from leglab import RunSettings, run_scenario
from leglab.machine.simulation import load_model

STEPS = 100
MODELS = ("leg", "leg_motor")
# With shapes or not, commands moving or zero.
CASES = {
    "as shipped": (True, True),
    "without shapes": (False, True),
    "as shipped, at rest": (True, False),
}
ASKED = {
    "pd": "at least 50",
    "static_feedforward": "",
    "bsnn_arx": "at least 30",
    "bsnn_arx_bank": "at least 0.6 of `pd`",
}


def step_times(bursts: int, *, visual: bool, moving: bool) -> dict[str, float]:
    """Best time of one step [us] of each model."""
    machines = {}
    for name in MODELS:
        model = load_model(name, visual=visual)
        model.opt.gravity[:] = 0.0  # so that the motors' leg does not fall into its stops
        data = mujoco.MjData(model)
        machines[name] = model, data
    best = dict.fromkeys(MODELS, np.inf)
    for burst in range(bursts):
        for name, (model, data) in machines.items():
            amplitude = 0.05 if name == "leg" else 0.5  # relative opening; N
            mujoco.mj_resetDataKeyframe(model, data, 0)
            data.ctrl[:] = moving * amplitude * np.sin(0.3 * burst + np.arange(model.nu))
            mujoco.mj_step(model, data, STEPS)
            start = time.perf_counter()
            mujoco.mj_step(model, data, STEPS)
            best[name] = min(best[name], (time.perf_counter() - start) / STEPS * 1e6)
    return best


def loop_speeds(rounds: int, duration: float) -> dict[str, dict[str, float]]:
    """Closed loop, 1 ms step, 2 ms control period: runs of the controllers take turns.

    The monitor of faults waits for 7.6 s: shorter runs show no alarm, no looks and no slow wear.
    """
    factors: dict[str, list[float]] = {name: [] for name in ASKED}
    for _ in range(rounds):
        for name, found in factors.items():
            settings = RunSettings(scenario="seal_wear", controller=name, duration=duration)
            found.append(run_scenario(settings).metrics["real_time_factor"])
    return {
        name: {
            "best": max(found),
            "median": statistics.median(found),
            "of_pd": statistics.median(np.divide(found, factors["pd"])),
        }
        for name, found in factors.items()
    }


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Both tables' figures."""
    steps = {}
    for label, (visual, moving) in CASES.items():
        times = step_times(options.bursts, visual=visual, moving=moving)
        steps[label] = {**times, "ratio": times["leg"] / times["leg_motor"]}
    return {"step_us": steps, "loop": loop_speeds(options.rounds, options.duration)}


def tables(found: dict[str, Any]) -> str:
    """One step, and the closed loop."""
    step = [
        (label, *(results.number(row[k]) for k in (*MODELS, "ratio")), "at most 2.0")
        for label, row in found["step_us"].items()
    ]
    loop = [
        (
            f"`{name}`",
            f"{factor['best']:.0f}",
            f"{factor['median']:.0f}",
            ASKED[name],
            f"{factor['of_pd']:.2f}",
        )
        for name, factor in found["loop"].items()
    ]
    times = "times real time, best", "median"
    head = ("closed loop of the leg", *times, "asked", "of the speed of `pd`")
    return "\n".join(
        (
            results.table(("one step", "`leg`, µs", "`leg_motor`, µs", "ratio", "asked"), step),
            results.table(head, loop),
        )
    )


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--bursts", type=int, default=200, help=f"of {STEPS} steps")
    parser.add_argument("--rounds", type=int, default=12, help="runs of each controller")
    parser.add_argument("--duration", type=float, default=20.0, help="of a run [s]")
