"""Limits of adaptation in the squat.

First table: the map learned online against the one fitted offline on the changed machine
(`oracle`), the longer the squat goes on after the change. Second table: seals wear further and
further; the part of the last seconds in which some valve is open by more than 95 % tells how far
it is from what the valves can give. RMS tracking errors in mrad, over specimens.
"""

import argparse
from typing import Any

import numpy as np

from benchmarks import results
from benchmarks.specimens import FEW, first_change, run_specimen, window_rms
from leglab import Run

DURATION = 80.0  # s
WINDOWS = ((2.0, 4.0), (5.0, 10.0), (15.0, 20.0), (27.0, 32.0))  # s after the change
CASES = ("seal_wear", "hot_oil", "friction_rise", "stiction", "spring_fatigue")
FACTORS = (10.0, 20.0, 30.0, 40.0, 50.0)  # leakage over new
MAPS = ("bsnn_arx", "oracle")
OPEN = 0.95


def squat(
    scenario: str, controller: str, duration: float, seed: int, severity: float | None = None
) -> Run:
    """A squat of the leg."""
    return run_specimen(
        seed,
        scenario=scenario,
        controller=controller,
        reference="squat",
        duration=duration,
        severity=severity,
    )


def error(run: Run, start: float, end: float) -> float:
    """RMS over joints and a time span after the change [mrad]."""
    after = run.history.time - first_change(run)
    return 1e3 * window_rms(run.history.error, after, start, end)


def longer(scenario: str) -> list[list[float]]:
    """Errors in every window of `WINDOWS`, of both maps, means over specimens."""
    runs = [[squat(scenario, name, DURATION, seed) for seed in FEW] for name in MAPS]
    return [
        [float(np.mean([error(run, a, b) for run in part])) for part in runs] for a, b in WINDOWS
    ]


def harder(factor: float) -> list[float]:
    """Errors of both maps at the end, and the share of time in which a valve is open [%]."""
    found = []
    for seed in FEW:
        runs = [squat("seal_wear", name, 20.0, seed, factor) for name in MAPS]
        ends = [run.record.adaptation.end_rad for run in runs]
        last = np.abs(runs[0].history.command[runs[0].history.time >= 15.0])
        share = 100.0 * float((last.max(1) > OPEN).mean())
        found.append([*(1e3 * end["all"] for end in ends if end is not None), share])
    return np.mean(found, axis=0).tolist()


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Both experiments."""
    del options
    return {
        "longer": {scenario: longer(scenario) for scenario in CASES},
        "harder": [harder(factor) for factor in FACTORS],
    }


def tables(measured: dict[str, Any]) -> str:
    """Both tables."""
    head = ["bsnn_arx / oracle after the change", *(f"{a:g}-{b:g} s" for a, b in WINDOWS)]
    rows = [
        (name, *(" / ".join(f"{value:.2f}" for value in pair) for pair in pairs))
        for name, pairs in measured["longer"].items()
    ]
    leakage = [
        (
            f"{factor:g}",
            f"{learned:.2f}",
            f"{offline:.2f}",
            f"{learned / offline:.2f}",
            f"{share:.0f}",
        )
        for factor, (learned, offline, share) in zip(FACTORS, measured["harder"], strict=True)
    ]
    second = ["leakage over new", *MAPS, "ratio", "a valve open, % of the time"]
    return results.table(head, rows) + "\n" + results.table(second, leakage)
