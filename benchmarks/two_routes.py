"""Inverse or forward model for the feed-forward.

Both learn the same features online; one says what flow a motion takes, the other what speed a flow
gives, which is then solved for the flow (docs/concepts/identification.md). RMS tracking errors in
mrad before and 0-2, 2-4 and 5-8 s after the change, over specimens.
"""

import argparse
from collections.abc import Iterable
from typing import Any

import numpy as np

from benchmarks import results
from benchmarks.specimens import FEW, first_change, run_specimen

CASES = (
    ("leg", None, "seal_wear"),
    ("leg", None, "cold_oil"),
    ("leg", None, "valve_wear"),
    ("leg", None, "supply_drop"),
    ("leg", "squat", "seal_wear"),
    ("leg", "random_stride", "seal_wear"),
    ("leg_rail", "squat", "seal_wear"),
    ("knee_bench", None, "seal_wear"),
    ("knee_bench", None, "hot_oil"),
)
PARTS = ((-5, 0), (0, 2), (2, 4), (5, 8))  # s after the change


def errors(model: str, reference: str | None, scenario: str, route: str) -> np.ndarray:
    """RMS over joints, time and seeds in each part."""
    squares = []
    for seed in FEW:
        run = run_specimen(
            seed,
            scenario=scenario,
            controller="bsnn_arx",
            model=model,
            reference=reference,
            controller_config={"route": route},
        )
        history = run.history
        after = history.time - first_change(run)
        squares.append([np.mean(history.error[(after >= a) & (after < b)] ** 2) for a, b in PARTS])
    return 1e3 * np.sqrt(np.mean(squares, axis=0))


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """A row a case."""
    del options
    return [
        {
            "model": model,
            "reference": reference or "walking_stride",
            "scenario": scenario,
            **{
                route: list(errors(model, reference, scenario, route))
                for route in ("inverse", "forward")
            },
        }
        for model, reference, scenario in CASES
    ]


def tables(found: list[dict[str, Any]]) -> str:
    """A row a case, and the geometric mean."""
    ratios = [np.divide(row["forward"], row["inverse"]) for row in found]
    rows = [
        (
            *(row[key] for key in ("model", "reference", "scenario")),
            *(shown(values) for values in (row["inverse"], row["forward"], ratio)),
        )
        for row, ratio in zip(found, ratios, strict=True)
    ]
    mean = np.exp(np.mean(np.log(ratios), axis=0))
    rows.append(("geometric mean", "", "", "", "", shown(mean)))
    return results.table(
        ("model", "reference", "scenario", "inverse", "forward", "forward / inverse"), rows
    )


def shown(values: Iterable[float]) -> str:
    """Values of the parts."""
    return " / ".join(f"{value:.2f}" for value in values)
