"""Reading of recordings for a diagnosis, and choice of the recordings to hold out."""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from leglab import data
from leglab.base.errors import FileError, LeglabError, SettingsError
from leglab.base.recording import Recording
from leglab.diagnosis.intake.admission import admit, check_roles
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.thresholds import DEFAULT, Thresholds


def recording_files(paths: Sequence[Path]) -> tuple[list[Path], list[str]]:
    """Lists recordings, including those in folders; a bag or a dataset counts as one recording.

    Returns:
        The recordings, and a line of text for each folder that contains other files as well.

    Raises:
        LeglabError: A folder holds no recording.
    """
    recordings, notes = [], []
    for path in paths:
        files = _below(path)
        known = [f for f in files if f == path or f.is_dir() or _suffix(f) in data.SUFFIXES]
        if not known:
            text = f"{path}: a folder without recordings; allowed: "
            raise FileError(text, given=path, allowed=data.SUFFIXES)
        if others := sorted(set(files) - set(known)):
            names = ", ".join(str(other.relative_to(path)) for other in others[:3])
            names += ", ..." * (len(others) > 3)
            notes.append(f"{path}: {len(others)} files are no recordings ({names})")
        recordings += known
    return recordings, notes


def _below(path: Path) -> list[Path]:
    """Returns all files below a path, sorted by name; a bag or dataset counts as one file."""
    if not path.is_dir() or data.form_of_folder(path):
        return [path]
    entries = sorted(e for e in path.iterdir() if not e.name.startswith("."))
    return [file for entry in entries for file in _below(entry)]


def _suffix(file: Path) -> str:
    return Path(file.name.removesuffix(".gz")).suffix.lower()


def read_recordings(
    paths: Sequence[Path],
    columns: Path | None = None,
    *,
    span: tuple[float | None, float | None] = (None, None),
    salvage: bool = False,
    tell: Callable[[str], object] = lambda line: None,
) -> dict[str, Recording]:
    """Reads recordings; a name is the file's, preceded by folders until all names differ.

    If a file contains several recordings, the name within the file is appended.

    Columns that cannot be read are left out, because they may not be needed.

    Args:
        paths: Files and folders; files in folders are left out if they cannot be read.
        columns: File of a column map for all recordings, see `leglab.data.read_column_map`.
        span: First and last time [s] of each recording that is used; None for no limit.
        salvage: Whether the intact part of broken files is read.
        tell: Called with lines of text about files that are no recordings or are left out.

    Raises:
        LeglabError: A file cannot be read, is given twice or has no sample in the span, or the map
            is wrong.
    """
    files, notes = recording_files(paths)
    names = _different_names(files)
    found: dict[str, Recording] = {}
    refused: list[LeglabError] = []
    for file in files:
        try:
            several = data.read_all(file, columns=columns, partial=True, salvage=salvage)
        except LeglabError as error:
            if file in paths:
                raise
            refused.append(error)
            notes.append(f"left out: {error}")
            continue
        for part, recording in several.items():
            name = f"{names[file]}/{part}" if part else names[file]
            try:
                found[name] = recording.between(*span)
            except LeglabError as error:
                raise error.at(name) from error
            notes += [f"{name}: {line}" for line in recording.metadata.get("salvaged", ())]
    if not found:
        raise refused[0]
    for line in notes:
        tell(line)
    return found


def _different_names(paths: Sequence[Path]) -> dict[Path, str]:
    """Returns the shortest endings by which paths differ, as leglab's runs share a file name."""
    parts = [Path(os.path.abspath(path)).parts for path in paths]
    names = {}
    for path, own in zip(paths, parts, strict=True):
        ends = (own[-count:] for count in range(1, len(own) + 1))
        end = next((e for e in ends if sum(p[-len(e) :] == e for p in parts) == 1), ())
        if not end:
            text = f"two recordings are called {path.name!r}; allowed: "
            raise SettingsError(text, given=path, allowed="each recording once")
        names[path] = "/".join(end)
    return names


def split_held_out(
    model: str | Path | Machine,
    recordings: Mapping[str, Recording],
    wanted: Sequence[str],
    thresholds: Thresholds = DEFAULT,
) -> tuple[dict[str, Recording], tuple[str, ...]]:
    """Returns the recordings and the held-out names; the end of a single recording is held out.

    `wanted` are names to hold out, with or without suffix; if empty, `held_out_choice` decides.

    Raises:
        LeglabError: A name does not exist, or nothing is left to fit.
    """
    recordings = dict(recordings)
    held: tuple[str, ...] = ()
    for entry in wanted:
        fits = {name: _fit(entry, name) for name in recordings}
        meant = [name for name, fit in fits.items() if fit == max(fits.values()) > 0]
        if len(meant) != 1:
            raise SettingsError.unknown("recording", entry, recordings)
        held += (*meant,)
    if wanted:
        check_roles(recordings, {}, held)
        return recordings, held
    machine = machine_for(model, recordings.values())
    usable = admit(machine, recordings, (), thresholds).recordings
    if len(usable) > 1:
        return recordings, held_out_choice(usable, machine)
    (name,) = usable
    whole, tail = recordings.pop(name), f"{name} (end)"
    cut = whole.time[0] + (1.0 - thresholds.held_out_share) * whole.duration
    recordings[name] = whole.between(whole.time[0], cut)
    recordings[tail] = whole.between(cut, whole.time[-1] + 1.0)
    return recordings, (tail,)


def machine_for(model: str | Path | Machine, recordings: Iterable[Recording]) -> Machine:
    """Returns the machine of a model; unmeasured joints may be followers (see `Followers`).

    Raises:
        LeglabError: The model cannot be loaded or replayed.
    """
    machine = model if isinstance(model, Machine) else Machine(model)
    return machine.measured_by(frozenset.intersection(*(frozenset(r.columns) for r in recordings)))


def _fit(entry: str, name: str) -> int:
    """Returns how many path components of `entry` match a recording's path, end or folder."""
    parts, wanted = Path(name).parts, Path(entry).parts
    ends = {parts, (*parts[:-1], Path(name).stem), *([parts[:1]] if len(parts) > 1 else [])}
    ends.add(parts[-1:])
    return max((len(end) for end in ends if wanted[-len(end) :] == end), default=0)


def held_out_choice(recordings: Mapping[str, Recording], machine: Machine) -> tuple[str, ...]:
    """Chooses the recording, of at least two, whose values lie most within the others' ranges.

    The held-out recording then tests the model by another excitation, without extrapolation. If
    several are equal, the recording with the fastest motion is chosen as the most informative.
    """
    tables = {}
    for name, recording in recordings.items():
        rows = [recording[c] for c in machine.columns]
        rows += [np.gradient(recording[f"{j}_position"], recording.time) for j in machine.joints]
        tables[name] = np.stack(rows)[:, :: max(1, len(recording) // 2000)]

    def score(name: str) -> tuple[float, float]:
        others = np.concatenate([t for n, t in tables.items() if n != name], axis=1)
        low, high = np.nanmin(others, axis=1)[:, None], np.nanmax(others, axis=1)[:, None]
        inside = ((tables[name] >= low) & (tables[name] <= high)).mean()
        return round(float(inside), 2), float(np.nanmean(np.abs(tables[name][-1])))

    return (max(tables, key=score),)
