"""Recordings of a diagnosis: read from files, and split into fitted and held-out ones."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from leglab import data
from leglab.diagnosis.machine import Machine
from leglab.diagnosis.workflow import held_out_choice
from leglab.errors import LeglabError, unknown_name
from leglab.recording import Recording

# Share of a single recording that is held out, at its end.
_TAIL = 0.3


def read_recordings(paths: Sequence[Path], columns: Path | None = None) -> dict[str, Recording]:
    """Reads recordings by file name.

    Args:
        paths: Of the files.
        columns: A column map for all of them, see `leglab.data.read_column_map`.

    Raises:
        LeglabError: A file cannot be read, or two have one name, or the map is wrong.
    """
    column_map = data.read_column_map(columns) if columns else None
    found: dict[str, Recording] = {}
    for path in paths:
        if path.name in found:
            raise LeglabError(f"two recordings are called {path.name!r}; allowed: different names")
        found[path.name] = data.read(path, columns=column_map)
    return found


def split_held_out(
    model: str | Path, recordings: Mapping[str, Recording], wanted: Sequence[str]
) -> tuple[dict[str, Recording], tuple[str, ...]]:
    """Says which recordings are held out; cuts the end off a single one.

    Args:
        model: MJCF file, or the name of a model that ships with leglab.
        recordings: By name.
        wanted: Names, with or without suffix; empty for the tool's choice.

    Raises:
        LeglabError: A name does not exist, or nothing is left to fit.
    """
    recordings = dict(recordings)
    if wanted:
        by_stem = {Path(name).stem: name for name in recordings}
        held = []
        for entry in wanted:
            name = Path(entry).name
            if name not in recordings and name not in by_stem:
                raise unknown_name("recording", entry, recordings)
            held.append(name if name in recordings else by_stem[name])
        if len(set(held)) == len(recordings):
            raise LeglabError("every recording is held out; allowed: at least one to fit")
        return recordings, tuple(held)
    if len(recordings) == 1:
        ((name, whole),) = recordings.items()
        cut = whole.time[0] + (1.0 - _TAIL) * whole.duration
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
