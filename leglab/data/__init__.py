"""Reading and writing of recordings in files of several formats."""

from collections.abc import Mapping
from copy import copy
from pathlib import Path
from types import ModuleType

import numpy as np

from leglab.base.errors import FileError, LeglabError, RecordingError
from leglab.base.input import no_file
from leglab.base.output import write_atomically
from leglab.base.recording import Recording
from leglab.data import contents, csv, lerobot, matlab, mcap, parquet, sysid
from leglab.data.checks import MAP_HINT, Finding, inspect, to_recording
from leglab.data.clock import Timed, time_axis
from leglab.data.column_map import ColumnMap, read_column_map
from leglab.data.contents import form_at, form_of_folder, format_of
from leglab.data.files import LeftOut, first_line
from leglab.data.scene import Scene
from leglab.data.summary import Summary, summarise
from leglab.data.sysid import from_time_series, to_time_series

__all__ = [
    "FORMATS",
    "SUFFIXES",
    "ColumnMap",
    "Finding",
    "Scene",
    "Summary",
    "form_of_folder",
    "format_of",
    "from_time_series",
    "inspect",
    "losses",
    "read",
    "read_all",
    "read_column_map",
    "read_tables",
    "summarise",
    "to_time_series",
    "write",
    "write_atomically",
]

# Modules of formats. Each has `read_table(path, left_out, columns)`, which returns arrays (n,) by
# column name and metadata, and uses the map `columns` only for settings that the file leaves open;
# `write(recording, path)`; and `losses(recording)` if the format loses more than metadata.
_MODULES = {"parquet": parquet, "csv": csv, "mcap": mcap, "matlab": matlab, "sysid": sysid}
SUFFIXES = tuple(contents.SUFFIXES)
"""Suffixes of files that `read` knows."""

FORMATS = tuple(_MODULES)
"""Names of the formats that `write` knows."""


def read(
    path: str | Path,
    *,
    columns: ColumnMap | str | Path | None = None,
    repair: bool = True,
    partial: bool = False,
    salvage: bool = False,
    recording: str | None = None,
) -> Recording:
    """Reads a recording.

    Args:
        path: A `.parquet`, `.csv`, `.mat` or `.npz` file, a `.mcap` file with joint states, the
            folder of a ROS 2 bag, or a dataset of LeRobot.
        columns: Map from the file's column names and units to leglab's, or the map's file.
        repair: Whether to drop exact repetitions of a row and empty rows at the end (no data are
            invented); the metadata lists them under "repairs".
        partial: Whether to leave out columns that cannot be read (text, different length,
            duplicate), with the reason by column in the metadata under "unreadable", instead of
            rejecting the file.
        salvage: Whether to read the intact parts of a broken file, with a line in the metadata
            under "salvaged" that counts the losses, instead of rejecting the file.
        recording: Name, as in `read_all`, of the recording to read from a file with several.

    Raises:
        LeglabError: There is no such file, it cannot be read, it holds several recordings and none
            is chosen, a column is not numeric, time stamps are missing, repeated or reversed, or
            the map does not fit; names the file, the row and the column.
    """
    tables = read_tables(path, columns=columns, partial=partial, salvage=salvage)
    if recording is None and len(tables) > 1:
        text = f"{path}: {len(tables)} recordings, one at a time: choose by --recording "
        raise RecordingError(text, given=path, allowed=tables)
    if recording is not None and recording not in tables:
        raise RecordingError.unknown(f"recording of {path}", recording, tables)
    table, metadata = tables[recording or next(iter(tables))]
    return to_recording(table, metadata, source=str(path), repair=repair)


def read_all(
    path: str | Path,
    *,
    columns: ColumnMap | str | Path | None = None,
    partial: bool = False,
    salvage: bool = False,
) -> dict[str, Recording]:
    """Reads all recordings of a file or folder, as `read` reads one.

    Returns:
        Recordings by name; the only recording of a file has the name "".
    """
    tables = read_tables(path, columns=columns, partial=partial, salvage=salvage)
    return {
        name: to_recording(table, metadata, source=_place(path, name), repair=True)
        for name, (table, metadata) in tables.items()
    }


def read_tables(
    path: str | Path,
    *,
    columns: ColumnMap | str | Path | None = None,
    partial: bool = False,
    timed: bool = True,
    salvage: bool = False,
) -> dict[str, tuple[dict, dict]]:
    """Reads the columns of all recordings, as `read` does, without checking their values.

    If `timed`, a file without a column `time` is rejected.

    Returns:
        Arrays of shape (n,) by column name, for `inspect`, and the metadata, by the recording's
        name as in `read_all`.
    """
    path = Path(path)
    if columns is not None and not isinstance(columns, ColumnMap):
        columns = read_column_map(columns)
    if not path.is_dir() and not path.is_file():
        raise FileError(f"{path}: {no_file(path)}", given=path)
    form = form_at(path)
    left_out = LeftOut(partial, salvage=salvage)
    try:
        if form == "lerobot":
            found = lerobot.read_tables(path, left_out)
        else:
            found = {"": _MODULES[form].read_table(path, left_out, columns)}
        for _, metadata in found.values():
            if not all(isinstance(metadata.get(key, []), list) for key in ("alignment", "repairs")):
                raise RecordingError("metadata 'alignment' or 'repairs' is no list")
    except LeglabError as error:
        raise error.at(path) from error
    # Any other error of the libraries is caused by the file.
    except Exception as error:
        text = f"{path}: not a complete {path.suffix or form} file: {first_line(error)}"
        raise FileError(text, given=path) from error
    if not found:
        raise RecordingError(f"{path}: there is no recording", given=path)
    return {
        name: _usable(table, metadata, _place(path, name), columns, copy(left_out), timed)
        for name, (table, metadata) in found.items()
    }


def _place(path: str | Path, name: str) -> str:
    return f"{path}: {name}" if name else str(path)


def _usable(
    table: Mapping[str, np.ndarray],
    metadata: dict,
    source: str,
    columns: ColumnMap | None,
    left_out: LeftOut,
    timed: bool,
) -> tuple[dict, dict]:
    """Converts a table as it was read to leglab's names, units and time axis."""
    is_timed, columns = isinstance(table, Timed), columns or ColumnMap()
    table = columns.apply(table, source, left_out)
    given = columns.time if "time" in table else None
    table, metadata = time_axis(
        table, metadata, left_out, source=source, given=given, timed=is_timed
    )
    if left_out:
        reasons = {name: why.removeprefix(f"{source}: ") for name, why in left_out.items()}
        metadata = {**metadata, "unreadable": reasons}
    if timed and "time" not in table:
        found = ", ".join(map(repr, table)) or "no column"
        why = f"no column 'time', found {found}; {MAP_HINT}"
        why = metadata.get("unreadable", {}).get("time", why)
        raise RecordingError(f"{source}: {why}", given="time")
    return table, metadata


def write(
    recording: Recording, path: str | Path, form: str | None = None, *, scene: Scene | None = None
) -> Path:
    """Writes a recording; an existing file is replaced as a whole or left as it was.

    Args:
        recording: Recording to write; `losses` lists what the format cannot hold.
        path: The file.
        form: One of `FORMATS`; None for the format of the suffix.
        scene: The moving machine, from `leglab.machine.scene.scene_of`; only MCAP can hold it.

    Returns:
        The path.

    Raises:
        LeglabError: Suffix or format is not known, the format cannot hold the recording, or the
            folder cannot be written to.
    """
    path = Path(path)
    module = _module(path, form)
    if scene is not None and module is not mcap:
        text = f"{path}: {form or format_of(path)} cannot show a machine; allowed: "
        raise FileError(text, given=form, allowed="mcap")
    module.write(recording, path, *(() if scene is None else (scene,)))
    return path


def losses(recording: Recording, path: str | Path, form: str | None = None) -> tuple[str, ...]:
    """Returns phrases for the parts of a recording lost in writing; none for most formats.

    Args:
        recording: Recording to write.
        path: The file.
        form: See `write`.

    Raises:
        LeglabError: Suffix or format is not known.
    """
    module = _module(Path(path), form)
    if hasattr(module, "losses"):
        return module.losses(recording)
    # Formats that hold nothing but numbers lose the metadata.
    return ("metadata",) if recording.metadata and module in (csv, sysid) else ()


def _module(path: Path, form: str | None) -> ModuleType:
    form = form or format_of(path)
    if form not in _MODULES:
        raise FileError.unknown("format", form, FORMATS)
    return _MODULES[form]
