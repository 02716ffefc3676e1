"""What the tables of `adaptation_claims.py` need of each run, small enough to be committed."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import results

from leglab import RunSettings
from leglab.data import write_atomically
from leglab.studies.adaptation import SAFE_FROM

# Results by scenario, severity (None for the default) and controller, one a seed.
Cells = dict[tuple[str, float | None, str], list[dict[str, Any]]]

DATA = results.DATA / "adaptation_results.json"
ADAPTIVE, CALIBRATED = "bsnn_arx", "static_feedforward"


def condense(cells: Cells) -> Cells:
    """Reduces the results of `leglab.runs.comparison.run_all` to numbers, one dictionary a run.

    Each has `seed`, `completed` and, as `leglab.runs.clock` defines them, `before`, `after`, `end`,
    `damage`, `twin_end` [rad], `recovered` and `t90` [s], None where they cannot be told; `told`
    says whether `recovered` can. Nominal ones have `end_by_joint` and `travel` [rad]; those of
    `bsnn_arx` have `safety`: the worst ratio to `static_feedforward` in a 2 s window, its time [s],
    and both errors [mrad].
    """
    small: Cells = {}
    for (name, severity, controller), runs in cells.items():
        for run in runs:
            metrics = run["metrics"]
            if not metrics["phases"]:
                raise SystemExit(f"{name}, {controller}: {metrics['failure']}")
            found = metrics["adaptation"]
            before, end = found["before_rad"], found["end_rad"]
            entry = {
                "seed": run["settings"]["seed"],
                "completed": metrics["completed"],
                "before": before and before["all"],
                "after": metrics["phases"][-1]["rms_rad"]["all"],
                "end": end and end["all"],
                "damage": found["damage_rad"],
                "twin_end": found["twin_end_rad"],
                "recovered": found["recovered"],
                "t90": found["t90_s"],
                "told": found["reason"] is None,
            }
            if name == "nominal":
                entry["end_by_joint"], entry["travel"] = end, run["travel_rad"]
            if controller == ADAPTIVE:
                entry["safety"] = _safety(run, cells.get((name, severity, CALIBRATED), []))
            small.setdefault((name, severity, controller), []).append(results.rounded(entry))
    return small


def mrad(runs: list[dict[str, Any]], key: str) -> np.ndarray:
    """An error of every run that has it [mrad]; failed runs count as infinite."""
    values = [
        np.inf if not run["completed"] else 1e3 * run[key]
        for run in runs
        if not run["completed"] or run[key] is not None
    ]
    return np.array(values) if values else np.array([np.nan])


def stored(runs: list[RunSettings], folder: Path) -> list[dict[str, Any]]:
    """Results with these settings that a folder holds, whatever code they were made with."""
    found = [json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))]
    wanted = [json.loads(json.dumps(asdict(run))) for run in runs]
    return [result for result in found if result["settings"] in wanted]


def save(record: dict[str, Any], path: Path = DATA) -> None:
    """Writes results with where they come from, a line a run."""
    head = {name: record[name] for name in results.RECORD}
    lines = []
    for rig, cells in record["results"].items():
        rows = ",\n".join(json.dumps(row, allow_nan=False) for row in cells)
        lines.append(f"{json.dumps(rig)}: [\n{rows}\n]")
    body = ",\n".join(lines)
    text = (
        json.dumps(head, indent=1, ensure_ascii=False)[:-2] + f',\n "results": {{\n{body}\n}}}}\n'
    )
    write_atomically(path, lambda file: file.write(text.encode()))


def rows(rigs: dict[str, Cells]) -> dict[str, list[dict[str, Any]]]:
    """The results as JSON holds them: by rig, a dictionary a run."""
    return {
        rig: [
            {"scenario": n, "severity": s, "controller": c, **run}
            for (n, s, c), runs in cells.items()
            for run in runs
        ]
        for rig, cells in rigs.items()
    }


def read(path: Path = DATA) -> tuple[dict[str, Any], dict[str, Cells]]:
    """The committed record, and its results by rig."""
    record = json.loads(path.read_text())
    rigs: dict[str, Cells] = {}
    for rig, found in record["results"].items():
        cells = rigs.setdefault(rig, {})
        for row in found:
            cells.setdefault((row["scenario"], row["severity"], row["controller"]), []).append(row)
    return record, rigs


def _safety(run: dict[str, Any], statics: list[dict[str, Any]]) -> tuple[float, ...]:
    worst = (0.0, 0.0, 0.0, 0.0)
    for other in statics:
        if other["settings"]["seed"] != run["settings"]["seed"]:
            continue
        pairs = zip(run["time"], run["safety_error_rad"], other["safety_error_rad"], strict=False)
        for t, ours, theirs in pairs:
            if t >= SAFE_FROM and ours is not None and theirs:
                worst = max(worst, (ours / theirs, t, 1e3 * ours, 1e3 * theirs))
    return worst
