"""Folders of comparisons with made-up figures, summarised by the real function."""

import json
from dataclasses import asdict
from pathlib import Path

from leglab.runs.comparison import RUNS, SUMMARY, Comparison, compare

LEVELS = {"pd": 0.04, "static_feedforward": 0.02, "bsnn_arx": 0.002}


def write_comparison(folder: Path, *, failed=(), missing=(), seeds=3, controllers=tuple(LEVELS)):
    """Writes a comparison of seal wear, on time courses that double at the change.

    Args:
        folder: Where to; must not be there.
        failed: Controllers whose seed 0 came to nothing.
        missing: Controllers whose files are not there.
        seeds: Number of seeds.
        controllers: Their names, of `LEVELS`.

    Returns:
        The summary.
    """
    plan = Comparison(
        scenarios=("seal_wear",), controllers=controllers, seeds=seeds, model="knee_bench"
    )
    (folder / RUNS).mkdir(parents=True)
    results = []
    for run in plan.runs():
        level = LEVELS[run.controller] * (1.0 + 0.01 * run.seed)
        came = not (run.controller in failed and run.seed == 0)
        results.append(_result(run, level, came=came))
        if run.controller not in missing:
            name = f"seal_wear-{run.controller}-knee_bench-{run.seed}.json"
            (folder / RUNS / name).write_text(json.dumps(results[-1]))
    summary = compare(plan, results)
    (folder / SUMMARY).write_text(json.dumps(summary))
    return summary


def _result(run, level, *, came):
    adapts = run.controller == "bsnn_arx"
    phases = [("before", 0.0, 2.0, 0.5 * level), ("after", 2.0, 4.0, level)]
    metrics = {
        "scenario": run.scenario,
        "controller": run.controller,
        "seed": run.seed,
        "completed": came,
        "failure": None if came else "it blew up",
        "phases": [
            {"name": n, "start": a, "end": b, "rms_rad": {"all": v}} for n, a, b, v in phases
        ],
        "adaptation": {
            "before_rad": {"all": 0.5 * level},
            "end_rad": {"all": 0.6 * level},
            "damage_rad": 0.5 * level,
            "recovered": 0.9 if adapts else None,
            "t90_s": 0.5 if adapts else None,
            "reason": None if adapts else "the change does no damage",
        },
        "excess_error_area_rad_s": 0.1,
    }
    time = [0.1 * i for i in range(40)]
    errors = [None if t < 1.0 else level * (1.0 if t < 2.0 else 2.0) for t in time]
    return {
        "settings": asdict(run),
        "metrics": metrics,
        "changes": [2.0],
        "window": 1.0,
        "time": time,
        "windowed_error_rad": errors,
        "safety_error_rad": errors,
        "travel_rad": {},
    }
