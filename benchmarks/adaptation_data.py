"""What the tables of `adaptation_claims.py` need of each run, small enough to be committed."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from results import DATA as FOLDER
from results import rounded

from leglab import RunSettings
from leglab.data import write_atomically
from leglab.runs.metrics import READAPTATION_RATIO, settling_time

# Results by scenario, severity (None for the default) and controller, one a seed.
Cells = dict[tuple[str, float | None, str], list[dict[str, Any]]]

DATA = FOLDER / "adaptation_results.json"
ADAPTIVE, _CALIBRATED = "bsnn_arx", "static_feedforward"
# The first windows see the start of learning; from here on a window counts [s].
_SAFE_FROM = 7.0


def condense(cells: Cells) -> Cells:
    """Reduces the results of `leglab.runs.sweep.run_all` to numbers, one dictionary a run.

    Each has `seed`, `completed`, `settled_rms_rad` and `end_rms_rad` by joint, `after_rms_rad`;
    nominal ones `travel_rad`; those of `bsnn_arx` also `readaptation_s` to 1.25 of the error before
    the change ("strict") and of the worse of that and the oracle's end ("fair"), None for never,
    and `safety`: the worst ratio to `static_feedforward` in a 2 s window, its time
    [s], and both errors [mrad].
    """
    small: Cells = {}
    for (name, severity, controller), runs in cells.items():
        for run in runs:
            entry = {
                "seed": run["settings"]["seed"],
                "completed": run["metrics"]["completed"],
                "settled_rms_rad": run["settled_rms_rad"],
                "end_rms_rad": run["end_rms_rad"],
                "after_rms_rad": run["metrics"]["phases"][-1]["rms_rad"]["all"],
            }
            if name == "nominal":
                entry["travel_rad"] = run["travel_rad"]
            if controller == ADAPTIVE:
                others = {c: cells.get((name, severity, c), []) for c in ("oracle", _CALIBRATED)}
                if run["changes"]:
                    entry["readaptation_s"] = _readaptation(run, others["oracle"])
                entry["safety"] = _safety(run, others[_CALIBRATED])
            small.setdefault((name, severity, controller), []).append(rounded(entry))
    return small


def pooled(runs: list[dict[str, Any]], key: str) -> np.ndarray:
    """RMS over joints of every run that has it [mrad]; failed runs count as infinite."""
    values = []
    for run in runs:
        if not run["completed"]:
            values.append(np.inf)
        elif run[key] is not None:
            values.append(1e3 * np.sqrt(np.mean(np.square(list(run[key].values())))))
    return np.array(values) if values else np.array([np.nan])


def stored(runs: list[RunSettings], folder: Path) -> list[dict[str, Any]]:
    """Results with these settings that a folder holds, whatever code they were made with."""
    results = [json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))]
    wanted = [json.loads(json.dumps(asdict(run))) for run in runs]
    return [result for result in results if result["settings"] in wanted]


def save(rigs: dict[str, Cells], command: str, path: Path = DATA) -> None:
    """Writes condensed results, a line a run."""
    lines = []
    for rig, cells in rigs.items():
        rows = [
            json.dumps({"scenario": n, "severity": s, "controller": c, **run}, allow_nan=False)
            for (n, s, c), runs in cells.items()
            for run in runs
        ]
        lines.append(f"{json.dumps(rig)}: [\n" + ",\n".join(rows) + "\n]")
    text = f'{{"made_by": {json.dumps(command)},\n"rigs": {{\n' + ",\n".join(lines) + "\n}}\n"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, lambda file: file.write(text.encode()))


def read(path: Path = DATA) -> tuple[str, dict[str, Cells]]:
    """The command that made the committed results, and the results by rig."""
    content = json.loads(path.read_text())
    rigs: dict[str, Cells] = {}
    for rig, rows in content["rigs"].items():
        cells = rigs.setdefault(rig, {})
        for row in rows:
            key = row["scenario"], row["severity"], row["controller"]
            cells.setdefault(key, []).append(row)
    return content["made_by"], rigs


def _readaptation(run: dict[str, Any], oracle: list[dict[str, Any]]) -> dict[str, float | None]:
    time = np.array(run["time"])
    error = np.array([np.nan if e is None else e for e in run["windowed_error_rad"]])
    change, window = run["changes"][0], run["window"]
    before = error[np.searchsorted(time, change) - 1]
    runs = [{**r, "completed": r["metrics"]["completed"]} for r in oracle]
    bound = np.mean(pooled(runs, "end_rms_rad")) / 1e3
    levels = {"strict": before, "fair": np.fmax(before, bound)}  # no oracle: as strict
    return {
        kind: settling_time(time, error, change, window, READAPTATION_RATIO * level)
        for kind, level in levels.items()
    }


def _safety(run: dict[str, Any], statics: list[dict[str, Any]]) -> tuple[float, ...]:
    worst = (0.0, 0.0, 0.0, 0.0)
    for other in statics:
        if other["settings"]["seed"] != run["settings"]["seed"]:
            continue
        pairs = zip(run["time"], run["safety_error_rad"], other["safety_error_rad"], strict=False)
        for t, ours, theirs in pairs:
            if t >= _SAFE_FROM and ours is not None and theirs:
                worst = max(worst, (ours / theirs, t, 1e3 * ours, 1e3 * theirs))
    return worst
