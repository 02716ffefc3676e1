"""The figures that a run leaves behind: the content of `metrics.json`."""

from typing import Any

import numpy as np

from leglab import metrics
from leglab.rollout import History
from leglab.scenario import Scenario


def summary(
    scenario: Scenario, window: float, history: History, joints: tuple[str, ...]
) -> dict[str, Any]:
    """Summarises a run, as far as it came.

    Args:
        scenario: What happened to the machine, and when.
        window: One stride [s], over which the moving error is taken.
        history: What the loop left behind.
        joints: Names of the driven joints.

    Returns:
        Real-time factor, completion, tracking error and its costs by phase (`metrics.phase_table`,
        `metrics.usage_table`), RMS error of the controller's model where it has one, by joint and
        in its own unit, re-adaptation and the area of the excess error; plain Python types.
    """
    finite = np.isfinite(history.error).all(axis=1)
    error, time = history.error[finite], history.time[finite]
    energy = np.column_stack([history.states[f"{joint}_energy_supply"] for joint in joints])
    errors = metrics.phase_table(time, error, joints, scenario.phases)
    usage = metrics.usage_table(
        time, history.command[finite], energy[finite], joints, scenario.phases
    )
    for row, costs in zip(errors, usage, strict=True):
        row.update(costs)
        if "model_error" in history.diagnostics:
            part = (history.time >= row["start"]) & (history.time <= row["end"])
            values = metrics.rms(history.diagnostics["model_error"][part & finite])
            row["model_error"] = dict(zip(joints, values.tolist(), strict=True))
    result: dict[str, Any] = {
        "duration": float(history.time[-1]),
        "severity": scenario.severity,
        "real_time_factor": float(history.time[-1] / max(history.wall_time, 1e-9)),
        "completed": not history.failure,
        "failure": history.failure or None,
        "phases": errors,
        "readaptation": {"time_s": None, "threshold": None, "reason": "nothing changes"},
        "excess_error_area_rad_s": None,
    }
    if scenario.changes:
        change = scenario.changes[0].start
        found = metrics.readaptation(time, error, change, window)
        result["readaptation"] = {
            "time_s": found.time,
            "threshold": found.threshold,
            "reason": found.reason or None,
        }
        result["excess_error_area_rad_s"] = metrics.excess_error_area(time, error, change, window)
    return result
