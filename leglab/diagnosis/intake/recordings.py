"""Recordings for a diagnosis: read, and one of them held out."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from leglab import data
from leglab.base.errors import SettingsError
from leglab.base.recording import Recording
from leglab.diagnosis.intake.admission import admit
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.thresholds import DEFAULT, Thresholds


def read_recordings(paths: Sequence[Path], columns: Path | None = None) -> dict[str, Recording]:
    """Reads recordings by file name, or by folder and file name where file names are the same.

    Columns that cannot be read are left out: only the model says whether they are needed. `columns`
    is the file of a column map for all of them, see `leglab.data.read_column_map`.

    Raises:
        LeglabError: A file cannot be read, or is given twice, or the map is wrong.
    """
    plain = Counter(path.name for path in paths)
    found: dict[str, Recording] = {}
    for path in paths:
        # Every `leglab run` calls its recording the same, in a folder of its own.
        folder = "" if plain[path.name] == 1 else f"{path.resolve().parent.name}/"
        name = folder + path.name
        if name in found:
            told = f"two recordings are called {name!r}; allowed: "
            raise SettingsError(
                told, given=name, allowed="different names, or names of their folders"
            )
        found[name] = data.read(path, columns=columns, partial=True)
    return found


def split_held_out(
    model: str | Path,
    recordings: Mapping[str, Recording],
    wanted: Sequence[str],
    thresholds: Thresholds = DEFAULT,
) -> tuple[dict[str, Recording], tuple[str, ...]]:
    """Says which recordings are held out; cuts the end off a single one.

    Those `wanted` go by names, with or without suffix; the tool chooses where there are none.

    Raises:
        LeglabError: A name does not exist, or nothing is left to fit.
    """
    recordings = dict(recordings)
    if wanted:
        held = []
        for entry in wanted:
            meant = [name for name in recordings if _names(entry, name)]
            if len(meant) != 1:
                raise SettingsError.unknown("recording", entry, recordings)
            held += meant
        if len(set(held)) == len(recordings):
            told = "every recording is held out; allowed: "
            raise SettingsError(told, given=tuple(wanted), allowed="at least one to fit")
        return recordings, tuple(held)
    machine = Machine(model)
    usable = admit(machine, recordings, (), thresholds).recordings
    if len(usable) > 1:
        return recordings, held_out_choice(usable, machine)
    (name,) = usable
    whole, tail = recordings.pop(name), f"{name} (end)"
    cut = whole.time[0] + (1.0 - thresholds.held_out_share) * whole.duration
    recordings[name] = whole.between(whole.time[0], cut)
    recordings[tail] = whole.between(cut, whole.time[-1] + 1.0)
    return recordings, (tail,)


def _names(entry: str, name: str) -> bool:
    """Whether what a user wrote means a recording: its path or the end of it, or its folder."""
    parts, wanted = Path(name).parts, Path(entry).parts
    ends = {parts, (*parts[:-1], Path(name).stem), *([parts[:1]] if len(parts) > 1 else [])}
    return any(wanted[-len(end) :] == end for end in ends)


def held_out_choice(recordings: Mapping[str, Recording], machine: Machine) -> tuple[str, ...]:
    """Of two recordings or more, that to hold out: most within the ranges of the others.

    A model is judged by another excitation than it was fitted to, yet not by extrapolation. Among
    equals the one with the fastest motion says most.
    """
    tables = {}
    for name, recording in recordings.items():
        rows = [recording[c] for c in machine.columns]
        rows += [np.gradient(recording[f"{j}_position"], recording.time) for j in machine.joints]
        tables[name] = np.stack(rows)[:, :: max(1, len(recording) // 2000)]
    scores = {}
    for name, table in tables.items():
        others = np.concatenate([t for n, t in tables.items() if n != name], axis=1)
        low, high = np.nanmin(others, axis=1), np.nanmax(others, axis=1)
        inside = ((table >= low[:, None]) & (table <= high[:, None])).mean()
        speed = np.nanmean(np.abs(table[-1]))
        scores[name] = (round(float(inside), 2), float(speed))
    return (max(scores, key=lambda n: scores[n]),)
