"""The gate: what is wrong with recordings before anything is fitted to them."""

from collections.abc import Iterator, Mapping

import mujoco
import numpy as np

from leglab.data import inspect
from leglab.diagnosis.machine import CYLINDER, Machine
from leglab.errors import LeglabError
from leglab.recording import Recording

_DEGREES = 180.0 / np.pi
# A position may pass the joint's range by this share before its unit is doubted.
_BEYOND = 0.5
# No hydraulic machine runs its whole recording below this pressure [Pa]: 10 kPa are 0.1 bar.
_NO_PRESSURE = 1e4
_STUCK = 20  # equal samples at a limit in a row


def check_recordings(machine: Machine, recordings: Mapping[str, Recording]) -> tuple[str, ...]:
    """Refuses what cannot be meant, and notes what a reader should know.

    Returns:
        Notes: gaps, constant columns, saturated sensors, commands beyond their range.

    Raises:
        LeglabError: Units that cannot be right; names recording, column, range and what is
            allowed.
    """
    notes = []
    for name, recording in recordings.items():
        _check_positions(machine, name, recording)
        _check_pressures(machine, name, recording)
        notes += [f"{name}: {text}" for text in _notes(machine, recording)]
    return tuple(notes)


def _check_positions(machine: Machine, name: str, recording: Recording) -> None:
    model = machine.base.model
    for joint in machine.joints:
        values = recording[f"{joint}_position"]
        low, high = np.nanmin(values), np.nanmax(values)
        entry = model.joint(joint)
        hinge = int(entry.type[0]) == int(mujoco.mjtJoint.mjJNT_HINGE)
        lower, upper = (float(x) for x in entry.range)
        if lower == upper == 0.0:
            lower, upper = (-4.0 * np.pi, 4.0 * np.pi) if hinge else (-np.inf, np.inf)
        room = _BEYOND * (upper - lower)
        if low < lower - room or high > upper + room:
            inside = hinge and low / _DEGREES > lower - room and high / _DEGREES < upper + room
            hint = "; is it in degrees?" if inside else ""
            raise LeglabError(
                f"{name}: column '{joint}_position' covers [{low:.4g}, {high:.4g}], joint "
                f"{joint!r} allows [{lower:.4g}, {upper:.4g}] {'rad' if hinge else 'm'}{hint}"
            )


def _check_pressures(machine: Machine, name: str, recording: Recording) -> None:
    for cylinder in machine.instances(CYLINDER):
        joint = machine.driven[cylinder][0]
        supply = machine.parameter(cylinder, "supply_pressure")
        for chamber in ("pressure_a", "pressure_b"):
            column = f"{joint}_{chamber}"
            if column in recording and np.nanmax(np.abs(recording[column])) < _NO_PRESSURE:
                raise LeglabError(
                    f"{name}: column {column!r} stays below "
                    f"{np.nanmax(np.abs(recording[column])):.4g}, the supply of {cylinder!r} "
                    f"is {supply:.4g} Pa; is it in bar? allowed: Pa"
                )


def _notes(machine: Machine, recording: Recording) -> Iterator[str]:
    for finding in inspect(recording):
        yield finding.message
    model = machine.base.model
    for actuator in machine.actuators:
        entry = model.actuator(actuator)
        if not entry.ctrllimited[0]:
            continue
        low, high = (float(x) for x in entry.ctrlrange)
        values = recording[f"{actuator}_command"]
        outside = int(((values < low) | (values > high)).sum())
        if outside:
            yield (
                f"column '{actuator}_command' leaves [{low:g}, {high:g}] in {outside} samples; "
                "the model clips it"
            )
    for column, values in recording.columns.items():
        if column.endswith("_command"):
            continue
        for limit, word in ((np.nanmin(values), "smallest"), (np.nanmax(values), "largest")):
            run = _longest_run(values == limit)
            if _STUCK <= run < 0.9 * values.size:
                yield (
                    f"column {column!r} holds its {word} value {limit:.6g} for {run} samples in a "
                    "row: is the sensor saturated?"
                )


def _longest_run(mask: np.ndarray) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return int((edges[1::2] - edges[::2]).max()) if edges.size else 0
