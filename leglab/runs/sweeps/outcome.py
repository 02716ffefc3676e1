"""Figures and traces of one run in the dataset of a sweep."""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, FiniteFloat

from leglab.runs.metrics import sliding_rms
from leglab.runs.run import Run

# `TRACE_PERIOD`: sampling period of traces [s]. `WORST_WINDOW`: window of the worst error [s].
TRACE_PERIOD, WORST_WINDOW = 0.02, 2.0


class Outcome(BaseModel):
    """Figures of one run; None where there is none.

    Errors are RMS over the driven joints and over time, of the true positions; what `before`,
    `end`, `damage`, `recovered` and `t90` mean is in `leglab.runs.record.AdaptationMetrics`.
    """

    model_config = ConfigDict(extra="forbid")

    came_to_s: FiniteFloat  #: How far the run came [s]
    rms_rad: FiniteFloat  #: Error of the whole run [rad]
    peak_rad: FiniteFloat  #: Largest error of a joint [rad]
    #: Error over the whole strides before the change [rad]: the nominal error.
    before_rad: FiniteFloat | None = None
    #: Error after the change, of a run without one the whole [rad].
    after_rad: FiniteFloat | None = None
    end_rad: FiniteFloat | None = None  #: Error over the last strides [rad]
    damage_rad: FiniteFloat | None = None  #: What the change costs [rad]
    twin_end_rad: FiniteFloat | None = None  #: Error of the frozen twin over the last strides [rad]
    recovered: FiniteFloat | None = None  #: Share of the damage that is undone at the end
    t90_s: FiniteFloat | None = None  #: From the change until nine tenths are undone [s]
    level_rad: FiniteFloat | None = None  #: Error at which nine tenths are undone [rad]
    not_told: str | None = None  #: Why `recovered` and `t90_s` cannot be told
    #: Largest error over 2 s that end after the change, of a run without one in all of it [rad].
    worst_2s_rad: FiniteFloat | None = None
    #: Area of the moving error above its value before [rad s].
    excess_error_area_rad_s: FiniteFloat | None = None
    #: Sum of all movements of the valve commands, over all joints; full stroke is 2.
    valve_travel: FiniteFloat
    effort: FiniteFloat  #: RMS valve command
    energy_j: FiniteFloat | None = None  #: Energy drawn from the supply [J]
    #: Faults that the controller named and did not withdraw, as FAULT at ELEMENT.
    named: list[str] = []
    #: From the change until the first name that came after it [s].
    named_after_s: FiniteFloat | None = None
    metrics: str | None = None  #: Content of `metrics.json` as text, where it is kept
    trace_s: list[FiniteFloat] | None = None  #: Times of the traces [s], where they are kept
    #: Error over one stride that ends then [rad].
    windowed_rad: list[FiniteFloat | None] | None = None
    worst_rad: list[FiniteFloat | None] | None = None  #: Error over 2 s that end then [rad]
    #: When the machine begins to change [s], with the traces.
    changes_s: list[FiniteFloat] | None = None
    window_s: FiniteFloat | None = None  #: One stride [s], with the traces
    #: Travel of the reference by joint [rad], with the traces, as text.
    travel_rad: str | None = None


# Numeric figures that are stored for every run.
FIGURES = tuple(
    name
    for name, field in Outcome.model_fields.items()
    if field.annotation in (float, FiniteFloat | None) and name != "window_s"
)


# Figures that are copied from `AdaptationMetrics`.
_ADAPTATION = ("damage_rad", "twin_end_rad", "recovered", "t90_s", "level_rad")


def outcome_of(run: Run, keep: Sequence[str]) -> dict[str, Any]:
    """Returns the figures of a completed run by the field names of `Outcome`.

    Args:
        run: The run.
        keep: Optional parts to include: `metrics`, `traces`.
    """
    metrics, found, history = run.record, run.record.adaptation, run.history
    phases = metrics.phases
    time, error = history.time, history.error
    change = min(run.scenario.breakpoints, default=None)
    worst = sliding_rms(time, error, WORST_WINDOW)
    since = worst if change is None else worst[time >= change]
    since = since[np.isfinite(since)]
    energy = [phase.energy_j.get("all") for phase in phases]
    names = [event.names[-1] for event in metrics.events if event.withdrawn is None]
    said = [n.time for event in metrics.events for n in event.names]
    after = [when - change for when in said if change is not None and when >= change]
    kept: dict[str, Any] = {
        **{name: getattr(found, name) for name in _ADAPTATION},
        "came_to_s": metrics.duration,
        "rms_rad": float(np.sqrt(np.mean(error**2))),
        "peak_rad": float(np.max(np.abs(error))),
        "before_rad": found.before_rad and found.before_rad["all"],
        "after_rad": phases[-1].rms_rad["all"] if phases[-1].name != "before" else None,
        "end_rad": found.end_rad and found.end_rad["all"],
        "not_told": found.reason,
        "worst_2s_rad": float(since.max()) if since.size else None,
        "excess_error_area_rad_s": metrics.excess_error_area_rad_s,
        "valve_travel": float(np.abs(np.diff(history.command, axis=0)).sum()),
        "effort": float(np.sqrt(np.mean(history.command**2))),
        "energy_j": None if None in energy else float(sum(e for e in energy if e is not None)),
        "named": [f"{name.fault} at {name.element}" for name in names],
        "named_after_s": min(after, default=None),
    }
    if "metrics" in keep:
        kept["metrics"] = json.dumps(run.metrics, allow_nan=False)
    if "traces" in keep:
        kept |= traces(run)
    return kept


def traces(run: Run) -> dict[str, Any]:
    """Returns windowed errors of a run every 20 ms, finite samples only; names as in `Outcome`."""
    history = run.history
    finite = np.isfinite(history.error).all(axis=1)
    time, error = history.time[finite], history.error[finite]
    # Whole number of samples per trace step, at least 1 if the control period exceeds 20 ms.
    step = max(round(TRACE_PERIOD / (time[1] - time[0])), 1) if len(time) > 1 else 1
    windowed, worst = (sliding_rms(time, error, span) for span in (run.window, WORST_WINDOW))
    travel = np.ptp(history.reference.position, axis=0).tolist()
    return {
        "trace_s": time[::step].tolist(),
        "windowed_rad": _numbers(windowed[::step]),
        "worst_rad": _numbers(worst[::step]),
        "changes_s": list(run.scenario.breakpoints),
        "window_s": run.window,
        "travel_rad": json.dumps(dict(zip(run.joints, travel, strict=True))),
    }


def _numbers(values: np.ndarray) -> list[float | None]:
    return [None if math.isnan(value) else value for value in values.tolist()]


def recording_folder(folder: Path, number: int) -> Path:
    """Returns the folder of a run's recording in a sweep; parent folders hold a thousand runs."""
    return folder / "recordings" / f"{number // 1000:05d}" / str(number)
