"""Rows of a sweep's dataset: one per run with its settings, status and figures."""

import json
from contextlib import suppress
from datetime import UTC, datetime
from functools import cache
from typing import Any

import pyarrow as pa
from pydantic import ValidationError

from leglab.base.errors import LeglabError
from leglab.base.settings import first_problem
from leglab.runs.preparation import scenario_of
from leglab.runs.sweeps.outcome import Outcome
from leglab.runs.sweeps.plan import MAPPINGS, SweepPlan

OK, FAILED = "ok", "failed"

# Columns by which the dataset is partitioned into folders.
PARTITION = ("scenario", "controller")

_TEXT, _NUMBER, _NUMBERS = pa.string(), pa.float64(), pa.list_(pa.float64())
_SETTINGS = {
    "run": pa.int64(),
    "scenario": _TEXT,
    "controller": _TEXT,
    "model": _TEXT,
    "reference": _TEXT,
    "element": _TEXT,
    "severity": _NUMBER,
    "ramp_duration": _NUMBER,
    "duration": _NUMBER,
    "seed": pa.int64(),
    "tolerance": _NUMBER,
    "vary": pa.bool_(),
    "timestep": _NUMBER,
    **dict.fromkeys(MAPPINGS, _TEXT),
}
_HOW = {"status": _TEXT, "failure": _TEXT, "error": _TEXT}
_OTHER_FIGURES = {
    "not_told": _TEXT,
    "named": pa.list_(_TEXT),
    "metrics": _TEXT,
    "travel_rad": _TEXT,
    **dict.fromkeys(("trace_s", "windowed_rad", "worst_rad", "changes_s"), _NUMBERS),
}
_FIGURES = {name: _OTHER_FIGURES.get(name, _NUMBER) for name in Outcome.model_fields}
# Columns that differ between two executions of the same sweep.
_MADE = {"made_at": _TEXT, "made_by": _TEXT, "made_wall_s": _NUMBER, "made_cpu_s": _NUMBER}
MADE = tuple(_MADE)

_KEPT = {
    "metrics": ("metrics",),
    "traces": ("trace_s", "windowed_rad", "worst_rad", "changes_s", "window_s", "travel_rad"),
}


def schema(plan: SweepPlan) -> pa.Schema:
    """Returns the columns of a plan's dataset: fixed columns, and one column per varied setting.

    The column of a varied setting in a table has its dotted name with `_` in place of dots.
    """
    left_out = _left_out(plan.keep)
    figures = {name: type_ for name, type_ in _FIGURES.items() if name not in left_out}
    own = {column(axis): _type(plan, axis) for axis in plan.axes if "." in axis}
    point = {"point": pa.int64()} if plan.tuned else {}
    columns = {**_SETTINGS, **own, **point, **_HOW, **figures, **_MADE}
    return pa.schema([pa.field(name, type_) for name, type_ in columns.items()])


@cache
def _left_out(keep: tuple[str, ...]) -> frozenset[str]:
    """Returns the columns omitted at this retention level, the `keep` of a plan."""
    return frozenset(c for kind, names in _KEPT.items() if kind not in keep for c in names)


def column(axis: str) -> str:
    """Returns the column name of a setting."""
    return axis.replace(".", "_")


def _type(plan: SweepPlan, axis: str) -> pa.DataType:
    kinds = {type(value) for value in plan.values_of(axis)}
    if kinds == {bool}:
        return pa.bool_()
    return _NUMBER if kinds <= {int, float} else _TEXT


def row_of(plan: SweepPlan, number: int, answer: dict[str, Any], by: str) -> dict[str, Any]:
    """Returns the row of a run; invalid figures make it the row of a failed run.

    Args:
        plan: Plan of the sweep.
        number: Number of the run.
        answer: Answer of `leglab.jobs` for `figures_of`; it is validated.
        by: Name of the worker that made it.
    """
    row = {
        **settings_row(plan, number),
        "status": FAILED,
        "failure": str(answer.get("kind", "died")),
        "error": str(answer.get("error", "it gave no answer")),
        "made_at": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "made_by": by,
        "made_wall_s": _time(answer.get("wall_s")),
        "made_cpu_s": _time(answer.get("cpu_s")),
    }
    if "result" in answer:
        try:
            outcome = Outcome.model_validate(answer["result"])
            row |= outcome.model_dump(exclude=set(_left_out(plan.keep)))
            row |= {"status": OK, "failure": None, "error": None}
        except ValidationError as error:
            where, reason = first_problem(error)
            text = f"it gave no valid figures: {where}: {reason}"
            row |= {"failure": "ended early", "error": text}
    return row


def settings_row(plan: SweepPlan, number: int) -> dict[str, Any]:
    """Returns number and settings of a run, with the columns of the plan's varied settings."""
    settings, given = plan.settings(number), plan.values(number)
    row: dict[str, Any] = {name: getattr(settings, name) for name in _SETTINGS if name != "run"}
    row["run"] = number
    row |= {name: json.dumps(dict(row[name]), sort_keys=True) for name in MAPPINGS}
    with suppress(LeglabError):  # Checked before, so it fails only if a plug-in has changed.
        scenario = scenario_of(settings)
        row["severity"], row["duration"] = scenario.severity, scenario.duration
        row["reference"] = settings.reference or scenario.reference
    if plan.tuned:
        row["point"] = plan.point(number)
    for axis in plan.axes:
        if "." in axis:
            value = given.get(axis)
            text = _type(plan, axis) == _TEXT and value is not None
            row[column(axis)] = json.dumps(value) if text and not isinstance(value, str) else value
    return row


def _time(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) else None
