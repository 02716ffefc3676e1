"""Recordings for a diagnosis: read, checked before anything is fitted, and one held out."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np

from leglab import data
from leglab.base.errors import LeglabError, unknown_name
from leglab.base.recording import Recording
from leglab.data import inspect
from leglab.diagnosis.model import CHAMBERS, CYLINDER, Machine
from leglab.diagnosis.thresholds import DEFAULT, Thresholds

_DEGREES = 180.0 / np.pi


def check_recordings(
    machine: Machine, recordings: Mapping[str, Recording], thresholds: Thresholds = DEFAULT
) -> tuple[str, ...]:
    """Refuses recordings in wrong units, and notes repairs and doubts.

    Returns:
        Notes: gaps, constant columns, saturated sensors, commands beyond their range.

    Raises:
        LeglabError: Units that cannot be right; names recording, column, range and what is
            allowed.
    """
    notes = []
    for name, recording in recordings.items():
        _check_positions(machine, name, recording, thresholds.beyond_range)
        _check_pressures(machine, name, recording, thresholds.no_pressure)
        notes += [f"{name}: {text}" for text in _notes(machine, recording, thresholds)]
    return tuple(notes)


def _check_positions(machine: Machine, name: str, recording: Recording, beyond: float) -> None:
    model = machine.base.model
    for joint in machine.joints:
        values = recording[f"{joint}_position"]
        low, high = np.nanmin(values), np.nanmax(values)
        entry = model.joint(joint)
        hinge = int(entry.type[0]) == int(mujoco.mjtJoint.mjJNT_HINGE)
        lower, upper = (float(x) for x in entry.range)
        if lower == upper == 0.0:
            lower, upper = (-4.0 * np.pi, 4.0 * np.pi) if hinge else (-np.inf, np.inf)
        room = beyond * (upper - lower)
        if low < lower - room or high > upper + room:
            inside = hinge and low / _DEGREES > lower - room and high / _DEGREES < upper + room
            hint = "; is it in degrees?" if inside else ""
            raise LeglabError(
                f"{name}: column '{joint}_position' covers [{low:.4g}, {high:.4g}], joint "
                f"{joint!r} allows [{lower:.4g}, {upper:.4g}] {'rad' if hinge else 'm'}{hint}"
            )


def _check_pressures(machine: Machine, name: str, recording: Recording, least: float) -> None:
    for cylinder in machine.instances(CYLINDER):
        joint = machine.driven[cylinder][0]
        supply = machine.parameter(cylinder, "supply_pressure")
        for chamber in CHAMBERS:
            column = f"{joint}_{chamber}"
            highest = np.nanmax(np.abs(recording[column])) if column in recording else least
            if highest < least:
                raise LeglabError(
                    f"{name}: column {column!r} stays below {highest:.4g}, the supply of "
                    f"{cylinder!r} is {supply:.4g} Pa; is it in bar? allowed: Pa"
                )


def _notes(machine: Machine, recording: Recording, thresholds: Thresholds) -> Iterator[str]:
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
            if thresholds.saturated_samples <= run < 0.9 * values.size:
                yield (
                    f"column {column!r} holds its {word} value {limit:.6g} for {run} samples in a "
                    "row: is the sensor saturated?"
                )


def _longest_run(mask: np.ndarray) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return int((edges[1::2] - edges[::2]).max()) if edges.size else 0


def read_recordings(paths: Sequence[Path], columns: Path | None = None) -> dict[str, Recording]:
    """Reads recordings by file name, or by folder and file name where file names are the same.

    Args:
        paths: Of the files.
        columns: A column map for all of them, see `leglab.data.read_column_map`.

    Raises:
        LeglabError: A file cannot be read, or is given twice, or the map is wrong.
    """
    column_map = data.read_column_map(columns) if columns else None
    plain = Counter(path.name for path in paths)
    found: dict[str, Recording] = {}
    for path in paths:
        # Every `leglab run` calls its recording the same, in a folder of its own.
        whole = path.resolve()
        name = path.name if plain[path.name] == 1 else f"{whole.parent.name}/{path.name}"
        if name in found:
            raise LeglabError(
                f"two recordings are called {name!r}; allowed: different names, or names of "
                "their folders"
            )
        found[name] = data.read(path, columns=column_map)
    return found


def split_held_out(
    model: str | Path,
    recordings: Mapping[str, Recording],
    wanted: Sequence[str],
    thresholds: Thresholds = DEFAULT,
) -> tuple[dict[str, Recording], tuple[str, ...]]:
    """Says which recordings are held out; cuts the end off a single one.

    Args:
        model: MJCF file, or the name of a model that ships with leglab.
        recordings: By name.
        wanted: Names, with or without suffix; empty for the tool's choice.
        thresholds: Say how much of a single recording is held out.

    Raises:
        LeglabError: A name does not exist, or nothing is left to fit.
    """
    recordings = dict(recordings)
    if wanted:
        held = []
        for entry in wanted:
            meant = [name for name in recordings if _names(entry, name)]
            if len(meant) != 1:
                raise unknown_name("recording", entry, recordings)
            held += meant
        if len(set(held)) == len(recordings):
            raise LeglabError("every recording is held out; allowed: at least one to fit")
        return recordings, tuple(held)
    if len(recordings) == 1:
        ((name, whole),) = recordings.items()
        cut = whole.time[0] + (1.0 - thresholds.held_out_share) * whole.duration
        tail = f"{name} (end)"
        parts = {
            name: whole.between(whole.time[0], cut),
            tail: whole.between(cut, whole.time[-1] + 1.0),
        }
        return parts, (tail,)
    machine = Machine(model)
    for name, recording in recordings.items():
        missing = [c for c in machine.columns if c not in recording]
        if missing:
            raise LeglabError(
                f"{name}: no column {', '.join(map(repr, missing))}: the model needs "
                f"{', '.join(machine.columns)}; the recording has "
                f"{', '.join(recording.columns)}. Measured under other names? Give a column map"
            )
    return recordings, held_out_choice(recordings, machine)


def _names(entry: str, name: str) -> bool:
    """Whether what a user wrote means a recording: its path or the end of it, or its folder."""
    parts, wanted = Path(name).parts, Path(entry).parts
    ends = {parts, (*parts[:-1], Path(name).stem), *([parts[:1]] if len(parts) > 1 else [])}
    return any(wanted[-len(end) :] == end for end in ends)


def held_out_choice(recordings: Mapping[str, Recording], machine: Machine) -> tuple[str, ...]:
    """Recording to hold out: that which lies most within the ranges of the others.

    A model is judged by another excitation than it was fitted to, yet not by extrapolation. Among
    equals the one with the fastest motion says most.
    """
    if len(recordings) < 2:
        return ()

    def features(recording: Recording) -> np.ndarray:
        rows = [recording[c] for c in machine.columns]
        rows += [np.gradient(recording[f"{j}_position"], recording.time) for j in machine.joints]
        return np.stack(rows)[:, :: max(1, len(recording) // 2000)]

    tables = {name: features(recording) for name, recording in recordings.items()}
    scores = {}
    for name, table in tables.items():
        others = np.concatenate([t for n, t in tables.items() if n != name], axis=1)
        low, high = np.nanmin(others, axis=1), np.nanmax(others, axis=1)
        inside = ((table >= low[:, None]) & (table <= high[:, None])).mean()
        speed = np.nanmean(np.abs(table[-1]))
        scores[name] = (round(float(inside), 2), float(speed))
    return (max(scores, key=lambda n: scores[n]),)
