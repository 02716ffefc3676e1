"""Adaptation metrics: error that a fault adds, share of it removed, time until 90 % are removed.

`metrics.json`, comparisons, pages and tables all take adaptation figures from this module.
Errors are RMS over the driven joints and over time, of the true positions, in rad. The recovery
time is computed from errors averaged over whole strides, because the error varies within a stride;
the time of a stride is the time at which it begins.
"""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from leglab.base.scenario import Scenario
from leglab.runs.metrics import by_joint, joint_rms, settling_time, sliding_rms
from leglab.runs.record import AdaptationMetrics

NOTHING_CHANGES = "nothing changes"  # reason why there are no adaptation figures
# The errors before the change and at the end average the whole strides in this share of the run.
QUARTER = 0.25

# Share of the damage (the error that the change adds) that is removed at `t90_s`.
UNDONE = 0.9

# Minimum factor by which damage raises the error; smaller differences occur between any strides.
HURT = 1.25

# Tolerance for rounding errors of sums of times [s, or strides].
_ROUNDING = 1e-9

TWIN, OWN_PEAK = "frozen twin", "own peak"


def adaptation(
    scenario: Scenario,
    stride: float,
    time: np.ndarray,
    error: np.ndarray,
    joints: Sequence[str],
    *,
    twin: np.ndarray | None = None,
    failure: str = "",
) -> AdaptationMetrics:
    """Computes the adaptation figures of a run.

    Args:
        scenario: Scenario with the changes of the machine and their times.
        stride: Period of the reference [s].
        time: Sample times [s], increasing. Shape (n,).
        error: Tracking error [rad]. Shape (n, joints).
        joints: Names of the columns.
        twin: Tracking error of the frozen twin, the same run with adaptation stopped just before
            the change, at the same times; None to use the run's own worst stride instead.
        failure: Reason why the run ended early; empty if it did not.

    Returns:
        Figures as `AdaptationMetrics` defines them; a figure that cannot be computed is None, and
        `reason` says why.
    """
    # Total duration of the whole strides that fit into a quarter of the run.
    span = math.floor(QUARTER * scenario.duration / stride + _ROUNDING) * stride
    figures: dict[str, Any] = dict.fromkeys(AdaptationMetrics.model_fields)
    figures.update(span_s=span, stride_s=stride)
    error_of = partial(_error_of, time, joints)
    if span and not failure:
        figures["end_rad"] = error_of(error, scenario.duration - span, math.inf)
    figures["reason"] = _why_untold(scenario, stride, span, failure)
    if figures["reason"]:
        return AdaptationMetrics(**figures)

    change, done = scenario.breakpoints[0], scenario.breakpoints[-1]
    before = error_of(error, change - span, change)
    strides = sliding_rms(time, error, stride)
    if twin is None:
        hurt = float(np.max(strides[time >= change + stride]))
    else:
        hurt = error_of(twin, done, math.inf)["all"]
        figures["twin_end_rad"] = error_of(twin, scenario.duration - span, math.inf)["all"]
    damage = hurt - before["all"]
    figures.update(before_rad=before, damage_rad=damage)
    figures["damage_of"] = OWN_PEAK if twin is None else TWIN
    if hurt < HURT * before["all"]:
        figures["reason"] = "the change does no damage: it raises the error by less than a quarter"
        return AdaptationMetrics(**figures)
    level = before["all"] + (1 - UNDONE) * damage
    undone = settling_time(time, strides, change, stride, level)
    figures.update(
        recovered=1.0 - (figures["end_rad"]["all"] - before["all"]) / damage,
        t90_s=None if undone is None else round(undone, 6),
        level_rad=level,
    )
    return AdaptationMetrics(**figures)


def _error_of(
    time: np.ndarray, joints: Sequence[str], values: np.ndarray, start: float, end: float
) -> dict[str, float]:
    """Computes RMS errors, by joint and under "all", of `values` from `start` to `end` [s]."""
    first, last = np.searchsorted(time, [start - _ROUNDING, end - _ROUNDING])
    return by_joint(joint_rms, values[first:last], joints)


def _why_untold(scenario: Scenario, stride: float, span: float, failure: str) -> str | None:
    """Returns why a run has no adaptation figures besides `end_rad`; None if it has them."""
    quarter, change = QUARTER * scenario.duration, min(scenario.breakpoints, default=0.0)
    if failure:
        return f"the run stopped early: {failure}"
    if not scenario.changes:
        return NOTHING_CHANGES
    if not span:
        return f"a quarter of the run, {quarter:g} s, is less than a stride, {stride:g} s"
    if change < span:
        return f"the change at {change:g} s leaves less than {span:g} s before it"
    if max(scenario.breakpoints, default=0.0) > scenario.duration - span:
        return f"the machine still changes in the last {span:g} s"
    return None
