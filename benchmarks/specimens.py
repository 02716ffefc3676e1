"""The machines of the published tables: specimens off the drawing, their phases and their times."""

from dataclasses import replace
from typing import Any

import numpy as np

from leglab import Run, RunSettings, run_scenario
from leglab.base.scale import rms
from leglab.base.scenario import Scenario, get_scenario
from leglab.causes.record import Cause, Side
from leglab.causes.table import CAUSES

# Standard deviation of the logarithm of every parameter about the drawing.
TOLERANCE = 0.1

# Seeds of tables whose point is not the scatter.
FEW = range(3)

# Scenarios of which the bank of faults has a curve, with each side of their healthy magnitude.
KINDS = [(c, side) for c in CAUSES.values() if c.summary for side in c.sides if side.bank]


def drawn_size(cause: Cause, side: Side, share: float) -> float:
    """Magnitude from the smallest (share 0) to the largest (1) of benchmarks, beyond the bank's."""
    healthy = cause.healthy_magnitude()
    small, *_, large = cause.magnitudes(side.benchmark, healthy)
    return small + share * (large - small)


def specimen(seed: int, **settings: Any) -> RunSettings:
    """Settings of a run in which the seed draws machine, motion, time of the change and noise."""
    return RunSettings(seed=seed, tolerance=TOLERANCE, vary=True, **settings)


def run_specimen(seed: int, **settings: Any) -> Run:
    """The run of these settings."""
    return run_scenario(specimen(seed, **settings))


def window_rms(error: np.ndarray, time: np.ndarray, start: float, end: float) -> float:
    """RMS over joints of errors (n, joints) from one time until before another."""
    return float(rms(error[(time >= start) & (time < end)]))


def first_change(run: Run) -> float:
    """When the machine begins to change [s]."""
    return run.scenario.breakpoints[0]


def changed_at(time: float, name: str, duration: float, **options: Any) -> Scenario:
    """The scenario of this name and these options with all of its changes at a time [s]."""
    whole = get_scenario(name, duration=duration, **options)
    changes = tuple(replace(change, start=time) for change in whole.changes)
    return Scenario(name=name, duration=duration, changes=changes)
