"""Recordings of a diagnosis: read from files, and split into fitted and held-out ones."""

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from leglab import data
from leglab.diagnosis.machine import Machine
from leglab.diagnosis.workflow import held_out_choice
from leglab.errors import LeglabError, unknown_name
from leglab.recording import Recording

# Share of a single recording that is held out, at its end.
_TAIL = 0.3
_MAP_KEYS = {"column", "scale", "offset"}


def read_recordings(paths: Sequence[Path], columns: Path | None = None) -> dict[str, Recording]:
    """Reads recordings by file name.

    Args:
        paths: Of the files.
        columns: A TOML file that says how the columns of the model are called in the recordings,
            see `mapped`.

    Raises:
        LeglabError: A file cannot be read, or two have one name, or the map is wrong.
    """
    table = _column_map(columns) if columns else {}
    found: dict[str, Recording] = {}
    for path in paths:
        if path.name in found:
            raise LeglabError(f"two recordings are called {path.name!r}; allowed: different names")
        found[path.name] = mapped(data.read(path), table)
    return found


def mapped(recording: Recording, table: Mapping[str, Mapping[str, Any]]) -> Recording:
    """A recording with columns under the names that the model expects.

    Args:
        recording: As measured.
        table: By wanted name: `column`, and where units or zero differ `scale` and `offset`;
            wanted = scale * measured + offset.
    """
    columns = dict(recording.columns)
    for name, rule in table.items():
        samples = recording[rule["column"]]
        columns.pop(rule["column"], None)
        columns[name] = rule.get("scale", 1.0) * samples + rule.get("offset", 0.0)
    return Recording(time=recording.time, columns=columns, metadata=recording.metadata)


def _column_map(path: Path) -> dict[str, dict[str, Any]]:
    try:
        table = tomllib.loads(path.read_text())
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise LeglabError(f"{path}: not a column map: {error}") from error
    rules = {k: {"column": v} if isinstance(v, str) else v for k, v in table.items()}
    for name, rule in rules.items():
        if not isinstance(rule, dict) or "column" not in rule or set(rule) - _MAP_KEYS:
            raise LeglabError(
                f'{path}: entry {name!r}; allowed: {name} = "measured_column" or '
                f"{name} = {{column = ..., scale = ..., offset = ...}}"
            )
    return rules


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
