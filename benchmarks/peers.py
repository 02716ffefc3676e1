"""Peers of the adaptive feed-forward on one specimen."""

import argparse
from typing import Any

from joblib import Parallel, delayed

from benchmarks import results
from benchmarks.specimens import specimen, window_rms
from leglab.runs.loop import Loop

CONTROLLERS = ("static_feedforward", "adrc", "ilc", "bsnn_arx")
CASES = (
    ("leg", "walking_stride", "seal_wear"),
    ("leg", "walking_stride", "cold_oil"),
    ("leg", "walking_stride", "supply_drop"),
    ("leg", "walking_stride", "friction_rise"),
    ("leg", "walking_stride", "valve_wear"),
    ("leg", "walking_stride", "slow_valve"),
    ("leg", "squat", "seal_wear"),
    ("leg", "random_stride", "seal_wear"),
    ("leg_rail", "squat", "seal_wear"),
    ("knee_bench", "walking_stride", "seal_wear"),
)
SEED = 3
# After the change [s].
PARTS = ((-2.4, 0.0), (0.0, 1.2), (1.2, 2.4), (2.4, 4.8), (4.8, 8.0))


def judged(task: tuple[str, str, str, str]) -> tuple[str, list[float]]:
    """The task in words, and RMS errors [mrad] of its run in each part."""
    model, reference, scenario, controller = task
    settings = {"scenario": scenario, "controller": controller, "duration": 20}
    loop = Loop(specimen(SEED, model=model, reference=reference, **settings))
    history, change = loop.run(), min(loop.scenario.breakpoints)
    assert not history.failure, history.failure
    after = history.time - change
    return " ".join(task), [1e3 * window_rms(history.error, after, *part) for part in PARTS]


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """All cases and controllers."""
    tasks = [(*case, controller) for case in CASES for controller in CONTROLLERS]
    return dict(Parallel(n_jobs=options.jobs)(delayed(judged)(task) for task in tasks))


def tables(kept: dict[str, Any]) -> str:
    """Errors before / in the first and second stride / 2.4-4.8 s / from 4.8 s on."""
    head = ["model", "reference", "scenario", *(f"`{name}`" for name in CONTROLLERS)]
    rows = []
    for case in CASES:
        cells = [kept[" ".join((*case, name))] for name in CONTROLLERS]
        rows.append([*case, *(" / ".join(results.number(x, 2) for x in row) for row in cells)])
    return results.table(head, rows)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time")
