"""Adaptation that never stops: `python -m benchmarks long_run [--minutes 30]`.

A specimen of the leg walks on, and nothing changes. Gains that stay open too far, or directions
that are forgotten and never excited, would show as errors that grow or burst. RMS errors in mrad.
"""

import argparse

import numpy as np

from benchmarks import results
from benchmarks.specimens import run_specimen
from leglab.base.scale import rms
from leglab.runs.metrics import sliding_rms

START, WINDOW = 5.0, 2.0  # s
CONTROLLERS = ("static_feedforward", "bsnn_arx")


def measured(controller: str, minutes: float) -> list[float]:
    """First and last minute, and the best and the worst window after the start."""
    run = run_specimen(
        0, scenario="nominal", controller=controller, duration=60.0 * minutes
    ).history
    after = run.time >= START
    times, errors = run.time[after], run.error[after]
    windows = sliding_rms(times, errors, WINDOW)
    ends = (errors[times <= START + 60.0], errors[times >= times[-1] - 60.0])
    parts = [rms(part) for part in ends]
    return [float(1e3 * part) for part in (*parts, np.nanmin(windows), np.nanmax(windows))]


def measure(options: argparse.Namespace) -> dict[str, list[float]]:
    """Errors by controller."""
    return {name: measured(name, options.minutes) for name in CONTROLLERS}


def tables(kept: dict[str, list[float]]) -> str:
    """A row a controller."""
    window = f"{WINDOW:g} s window"
    head = ["", "first minute", "last minute", f"best {window}", f"worst {window}"]
    return results.table(
        head, [(f"`{name}`", *(f"{x:.2f}" for x in row)) for name, row in kept.items()]
    )


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--minutes", type=float, default=30.0, help="of simulated time")
