"""Error that sensors and valves leave to any controller.

`exact_inverse` plays the commands that the very machine of the run needs, beside PD with the run's
sensors. The learned map (`bsnn_arx`) and the same map identified offline (`oracle`) stand beside
it. The walking leg, one specimen; RMS over joints in the last strides in mrad.
"""

import argparse
from pathlib import Path

import numpy as np
from rich.progress import Progress

from benchmarks import results
from benchmarks.specimens import specimen
from leglab.base.scenario import scenario_names
from leglab.runs.comparison import run_all

CONTROLLERS = ("bsnn_arx", "oracle", "exact_inverse")
SEEDS = range(1)
# Controllers that measure a wrong position cannot know: no bound of control.
SENSING = ("encoder_shift", "sensor_dropout")


def measure(options: argparse.Namespace) -> dict[str, list[float]]:
    """Errors in the order of `CONTROLLERS`, by scenario."""
    runs = [
        specimen(seed, scenario=scenario, controller=controller)
        for scenario in scenario_names()
        if scenario not in SENSING
        for controller in CONTROLLERS
        for seed in SEEDS
    ]
    with Progress() as bar:
        task = bar.add_task("running", total=len(runs))
        found = run_all(
            runs, options.out, progress=lambda done, total, _: bar.update(task, completed=done)
        )
    errors: dict[str, dict[str, list[float]]] = {}
    for result in found:
        metrics = result["metrics"]
        row = errors.setdefault(metrics["scenario"], {name: [] for name in CONTROLLERS})
        row[metrics["controller"]].append(1e3 * metrics["adaptation"]["end_rad"]["all"])
    return {
        scenario: [float(np.mean(row[name])) for name in CONTROLLERS]
        for scenario, row in errors.items()
    }


def tables(errors: dict[str, list[float]]) -> str:
    """A row a scenario."""
    head = ["scenario", *(f"`{name}`" for name in CONTROLLERS), "bsnn_arx / oracle"]
    return results.table(
        head,
        [
            (f"`{name}`", *(results.number(x, 2) for x in row), f"{row[0] / row[1]:.2f}")
            for name, row in errors.items()
        ],
    )


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", type=Path, default=Path("runs/bound"), help="where runs are kept")
