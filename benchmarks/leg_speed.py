"""What six cylinders cost: `python benchmarks/leg_speed.py`. Ratios of one run on one core.

The step of leg.xml against the same leg with native motors on the same tendons, and the closed
loop against real time, with PD and with six adaptive identifiers. Measurements alternate and each
figure is its best burst, so that other work on the machine disturbs both sides alike.
"""

import time

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

from leglab.runner import RunSettings, run_scenario
from leglab.simulation import load_model

BURSTS, STEPS = 200, 100
MODELS = ("leg", "leg_motor")


def step_times(visual: bool) -> dict[str, float]:
    """Best time of one step [us] of each model, all valves or motors moving."""
    machines = {}
    for name in MODELS:
        model = load_model(name, visual=visual)
        model.opt.gravity[:] = 0.0  # so that the motors' leg does not fall into its stops
        data = mujoco.MjData(model)
        machines[name] = model, data
    best = dict.fromkeys(MODELS, np.inf)
    for burst in range(BURSTS):
        for name, (model, data) in machines.items():
            amplitude = 0.05 if name == "leg" else 0.5  # relative opening; N
            mujoco.mj_resetDataKeyframe(model, data, 0)
            data.ctrl[:] = amplitude * np.sin(0.3 * burst + np.arange(model.nu))
            mujoco.mj_step(model, data, STEPS)
            start = time.perf_counter()
            mujoco.mj_step(model, data, STEPS)
            best[name] = min(best[name], (time.perf_counter() - start) / STEPS * 1e6)
    return best


def main() -> None:
    """Prints both tables."""
    table = Table(title="one step of the leg")
    for column in ("model", "leg, us", "leg_motor, us", "ratio", "asked"):
        table.add_column(column, justify="right")
    for visual, label in ((True, "as shipped"), (False, "without shapes")):
        times = step_times(visual)
        ratio = times["leg"] / times["leg_motor"]
        table.add_row(
            label, *(f"{times[name]:.2f}" for name in MODELS), f"{ratio:.2f}", "at most 2.0"
        )
    console = Console()
    console.print(table)

    loop_speeds(console)


def loop_speeds(console: Console) -> None:
    """Closed loop, 1 ms step, 2 ms control period: runs of the controllers take turns."""
    asked = {"pd": "at least 50", "static_feedforward": "", "bsnn_arx": "at least 30"}
    best = dict.fromkeys(asked, 0.0)
    for _ in range(5):
        for name in asked:
            settings = RunSettings(scenario="seal_wear", controller=name, duration=20.0)
            factor = run_scenario(settings).metrics["real_time_factor"]
            best[name] = max(best[name], factor)
    table = Table(title="closed loop of the whole leg")
    for column in ("controller", "x real time", "asked", "controller beyond pd"):
        table.add_column(column, justify="right")
    for name, factor in best.items():
        share = 1 - factor / best["pd"]
        table.add_row(name, f"{factor:.0f}", asked[name], f"{share:.0%} of its loop")
    console.print(table)


if __name__ == "__main__":
    main()
