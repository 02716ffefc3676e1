"""Recordings in files: the suffix picks the format, or its name does."""

from pathlib import Path
from types import ModuleType

from leglab.base.errors import FileError, RecordingError
from leglab.base.input import no_file
from leglab.base.output import write_atomically
from leglab.base.recording import Recording
from leglab.data import csv, matlab, mcap, parquet, plotjuggler, rerun, sysid
from leglab.data.checks import MAP_HINT, Finding, inspect, to_recording
from leglab.data.clock import Timed, time_axis
from leglab.data.column_map import ColumnMap, read_column_map
from leglab.data.files import LeftOut
from leglab.data.input_output import from_input_output, to_input_output
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
    "format_of",
    "from_input_output",
    "from_time_series",
    "inspect",
    "losses",
    "read",
    "read_column_map",
    "read_table",
    "summarise",
    "to_input_output",
    "to_time_series",
    "write",
    "write_atomically",
]

# A format has `read_table(path, left_out)`, which returns arrays of shape (n,) by column name and
# the metadata, and `write(recording, path)`; `losses(recording)` where more than metadata is lost.
_MODULES = {
    "parquet": parquet,
    "csv": csv,
    "mcap": mcap,
    "matlab": matlab,
    "sysid": sysid,
    "plotjuggler": plotjuggler,
    "rerun": rerun,
}
# Formats by suffix, where no format is named.
_SUFFIXES = {
    ".parquet": "parquet",
    **dict.fromkeys((".csv", ".txt", ".tsv", ".log", ".dat", ".asc"), "csv"),
    ".mcap": "mcap",
    ".mat": "matlab",
    ".npz": "sysid",
    ".rrd": "rerun",
}

SUFFIXES = tuple(suffix for suffix, form in _SUFFIXES.items() if form != "rerun")
"""Suffixes of files that `read` knows."""

FORMATS = tuple(_MODULES)
"""Names of the formats that `write` knows."""


def read(
    path: str | Path,
    *,
    columns: ColumnMap | str | Path | None = None,
    repair: bool = True,
    partial: bool = False,
) -> Recording:
    """Reads a recording.

    Args:
        path: A `.parquet`, `.csv` or `.mat` file with a `time` column, a `.mcap` file with joint
            states, the folder of a ROS 2 bag, or a `.npz` file of `mujoco.sysid`.
        columns: How the columns of the file are called here, and their units: a map, or its file.
        repair: Whether what can be repaired without inventing data is: exact repetitions of a row
            and empty rows at the end are dropped, and noted in the metadata under "repairs".
        partial: Whether columns that cannot be read (text, of another length, there twice) are left
            out, with the reason by column in the metadata under "unreadable", instead of refusing
            the file.

    Raises:
        LeglabError: There is no such file, it cannot be read, a column is not numeric, time stamps
            are missing, repeated or reversed, or the map does not fit; names the file, the row and
            the column.
    """
    table, metadata = read_table(path, columns=columns, partial=partial)
    return to_recording(table, metadata, source=str(path), repair=repair)


def read_table(
    path: str | Path,
    *,
    columns: ColumnMap | str | Path | None = None,
    partial: bool = False,
    timed: bool = True,
) -> tuple[dict, dict]:
    """Reads the columns of a file without checking the values.

    Args:
        path: The file.
        columns: See `read`.
        partial: See `read`.
        timed: Whether a file without a column `time` is refused.

    Returns:
        Arrays of shape (n,) by column name, for `inspect`, and the metadata.

    Raises:
        LeglabError: There is no such file, it cannot be read, a column is not numeric, there is no
            `time`, or the map does not fit.
    """
    path = Path(path)
    if columns is not None and not isinstance(columns, ColumnMap):
        columns = read_column_map(columns)
    is_bag = path.is_dir()
    if not is_bag and not path.is_file():
        raise FileError(f"{path}: {no_file(path)}", given=path)
    packed = path.suffix == ".gz" and format_of(path.stem) == "csv"
    form = mcap if is_bag else csv if packed else _MODULES[format_of(path)]
    left_out = LeftOut(partial)
    # Only topics have clocks of their own, and how they are brought onto one depends on the names;
    # of text the map says what cannot be known.
    if form in (mcap, csv):
        table, metadata = form.read_table(path, left_out, columns)
    else:
        table, metadata = form.read_table(path, left_out)
    is_timed = isinstance(table, Timed)
    if columns is not None:
        table = columns.apply(table, str(path), left_out)
    given = columns.time if columns is not None and "time" in table else None
    table, metadata = time_axis(
        table, metadata, left_out, source=str(path), given=given, timed=is_timed
    )
    if left_out:
        reasons = {name: why.removeprefix(f"{path}: ") for name, why in left_out.items()}
        metadata = {**metadata, "unreadable": reasons}
    if timed and "time" not in table:
        if "time" in left_out:
            raise RecordingError(f"{path}: {metadata['unreadable']['time']}", given="time")
        found = ", ".join(map(repr, table)) or "no column"
        raise RecordingError(
            f"{path}: no column 'time', found {found}; {MAP_HINT}", given=tuple(table)
        )
    return table, metadata


def write(
    recording: Recording,
    path: str | Path,
    form: str | None = None,
    *,
    scene: Scene | None = None,
) -> Path:
    """Writes a recording; an existing file is replaced as a whole or left as it was.

    Args:
        recording: To write. `losses` says what the format cannot hold.
        path: The file.
        form: One of `FORMATS`; None: what the suffix says.
        scene: The machine that moves, from `leglab.machine.scene.scene_of`; MCAP and rerun show it.

    Returns:
        The path.

    Raises:
        LeglabError: Suffix or format is not known, the format does not allow what the recording
            holds, or the folder cannot be written to.
    """
    path = Path(path)
    module = _module(path, form)
    if scene is None:
        module.write(recording, path)
    elif module in (mcap, rerun):
        module.write(recording, path, scene)
    else:
        form = form or format_of(path)
        told = f"{path}: {form} cannot show a machine; allowed: "
        raise FileError(told, given=form, allowed=("mcap", "rerun"))
    return path


def losses(recording: Recording, path: str | Path, form: str | None = None) -> tuple[str, ...]:
    """Returns what would not survive writing, one phrase each; nothing for most formats.

    Args:
        recording: To write.
        path: The file.
        form: See `write`.

    Raises:
        LeglabError: Suffix or format is not known.
    """
    module = _module(Path(path), form)
    if hasattr(module, "losses"):
        return module.losses(recording)
    # Of the others these hold nothing but numbers.
    return ("metadata",) if recording.metadata and module in (csv, sysid, rerun) else ()


def format_of(path: str | Path) -> str:
    """Returns the format that the suffix of a file stands for.

    Raises:
        LeglabError: The suffix is not known.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _SUFFIXES:
        told = f"{path}: suffix {suffix!r} is not a known format, allowed: "
        raise FileError(told, given=suffix, allowed=_SUFFIXES)
    return _SUFFIXES[suffix]


def _module(path: Path, form: str | None) -> ModuleType:
    form = form or format_of(path)
    if form not in _MODULES:
        raise FileError.unknown("format", form, FORMATS)
    return _MODULES[form]
