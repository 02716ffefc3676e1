"""What many runs say together: means over seeds with their confidence intervals."""

import math
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

import numpy as np
from scipy import stats

from leglab import __version__
from leglab.sweep import Comparison

_CONFIDENCE = 0.95


def compare(comparison: Comparison, results: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """Summarises results over seeds: the content of `compare.json`.

    Args:
        comparison: What was compared.
        results: From `run_all`.

    Returns:
        By scenario and controller: `rms_before_rad`, `rms_after_rad`, `readaptation_s` (of the runs
        that did re-adapt), `excess_error_area_rad_s` and `ratio` of the error after the change to
        the first controller's with the same seed, each an estimate (`estimate`); `not_readapted`,
        the number of runs that never did; `failures`, the reasons of runs that ended early, which
        are left out of all estimates.
    """
    cells: dict[tuple[str, str], dict[int, dict[str, Any]]] = {}
    for result in results:
        metrics = result["metrics"]
        cell = cells.setdefault((metrics["scenario"], metrics["controller"]), {})
        cell[metrics["seed"]] = metrics
    first = comparison.controllers[0]
    return {
        **asdict(comparison),
        "version": __version__,
        "results": {
            scenario: {
                controller: _summary(
                    cells.get((scenario, controller), {}), cells.get((scenario, first), {})
                )
                for controller in comparison.controllers
            }
            for scenario in comparison.scenarios
        },
    }


def estimate(values: Iterable[float | None]) -> dict[str, Any]:
    """Mean of independent runs with its confidence interval by Student's t.

    Args:
        values: One a run; None where a run has none.

    Returns:
        `values`; their `mean`, None without any; and `half_width` of the 95 % interval, t s/sqrt(n)
        with n - 1 degrees of freedom, None with less than two.
    """
    numbers = [value for value in values if value is not None]
    mean = float(np.mean(numbers)) if numbers else None
    half_width = None
    if len(numbers) > 1:
        quantile = float(stats.t.ppf((1 + _CONFIDENCE) / 2, len(numbers) - 1))
        half_width = quantile * float(np.std(numbers, ddof=1)) / math.sqrt(len(numbers))
    return {"mean": mean, "half_width": half_width, "values": numbers}


def _summary(cell: dict[int, dict], first: dict[int, dict]) -> dict[str, Any]:
    whole = {seed: metrics for seed, metrics in cell.items() if metrics["completed"]}
    after = {seed: _rms(metrics, "after", "whole") for seed, metrics in whole.items()}
    found = [m["readaptation"] for m in whole.values()]
    ratios = []
    for seed, value in after.items():
        base = _rms(first[seed], "after", "whole") if seed in first else None
        if value is not None and base and first[seed]["completed"]:
            ratios.append(value / base)
    return {
        "rms_before_rad": estimate(_rms(m, "before") for m in whole.values()),
        "rms_after_rad": estimate(after.values()),
        "ratio": estimate(ratios),
        "readaptation_s": estimate(entry["time_s"] for entry in found),
        "not_readapted": sum(e["time_s"] is None and e["reason"] is None for e in found),
        "excess_error_area_rad_s": estimate(m["excess_error_area_rad_s"] for m in whole.values()),
        "runs": len(cell),
        "failures": [m["failure"] for m in cell.values() if not m["completed"]],
    }


def _rms(metrics: dict[str, Any], *phases: str) -> float | None:
    for phase in metrics["phases"]:
        if phase["name"] in phases:
            return phase["rms_rad"]["all"]
    return None
