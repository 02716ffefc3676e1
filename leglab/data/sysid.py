"""Recordings as time series of MuJoCo's system identification, `mujoco.sysid.TimeSeries`.

The class comes with MuJoCo and needs none of the packages of `mujoco[sysid]`.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from leglab.base.errors import FileError, LeglabError, RecordingError
from leglab.base.output import write_atomically
from leglab.base.recording import Recording
from leglab.data.clock import Timed
from leglab.data.column_map import ColumnMap
from leglab.data.files import LeftOut, first_line
from leglab.data.variables import table_of

if TYPE_CHECKING:
    from mujoco.sysid import TimeSeries

# End of a column's name here, of a signal's name there, and the signal's type.
_ENDINGS = (
    ("_position", "_qpos", "MjStateQPos"),
    ("_velocity", "_qvel", "MjStateQVel"),
    ("_command", "_ctrl", "MjCtrl"),
)


def to_time_series(recording: Recording) -> "TimeSeries":
    """Returns the recording as a time series; its metadata is lost, NaN stays NaN.

    `mujoco.sysid.ModelSequences` takes controls and measurements apart: select the columns first.

    Raises:
        LeglabError: Two columns get one signal name.
    """
    series, types = _classes()
    mapping: dict[str, Any] = {}
    for index, column in enumerate(recording.columns):
        signal, kind = _signal_of(column)
        if signal in mapping:
            told = f"column {column!r} and another one both become signal {signal!r} of "
            raise RecordingError(f"{told}mujoco.sysid", given=column)
        mapping[signal] = (types[kind], np.array([index]))
    empty = np.empty((len(recording), 0))
    data = np.column_stack([empty, *recording.columns.values()])
    return series(times=np.array(recording.time), data=data, signal_mapping=mapping)


def from_time_series(series: "TimeSeries") -> Recording:
    """Returns a time series as a recording.

    A signal of several numbers gives `name[0]`, `name[1]`, and so on; without a mapping the columns
    are `signal[0]`, `signal[1]`, and so on.

    Args:
        series: Data of shape (n,) or (n, m).

    Raises:
        LeglabError: Times are not finite, an index of the mapping is outside the data, or two
            signals give one column.
    """
    table = _table_of(series)
    return Recording(time=table.pop("time"), columns=table)


def read_table(
    path: Path, left_out: LeftOut, columns: ColumnMap | None = None
) -> tuple[dict[str, np.ndarray], dict]:
    """Reads a file of `TimeSeries.save_to_disk`, or the arrays of another, see `variables`.

    Raises:
        LeglabError: The file is truncated, an array holds Python objects, or lengths differ.
    """
    try:
        arrays = _arrays(path, left_out)
        if not {"times", "data"} <= arrays.keys():
            return table_of(arrays, left_out, columns)
        return Timed(_table_of(_classes()[0].load_from_disk(path))), {}
    except LeglabError:
        raise
    # A foreign archive can fail anywhere in the loaders; the cause is the file.
    except Exception as error:
        told = f"{path}: not a complete .npz file: {first_line(error)}"
        raise FileError(told, given=path) from error


def write(recording: Recording, path: Path) -> None:
    """Writes a file that `TimeSeries.load_from_disk` reads; the metadata is lost.

    Raises:
        LeglabError: The folder cannot be written to, or two columns get one signal name.
    """
    write_atomically(path, to_time_series(recording).save_to_disk)


def _arrays(path: Path, left_out: LeftOut) -> dict[str, Any]:
    """Arrays of a file by name; the fields of a structured one have its name before them."""
    found: dict[str, Any] = {}
    with np.load(path) as file:
        for name in file.files:
            try:
                array = file[name]
            except ValueError as error:
                if "allow_pickle" not in str(error):
                    raise
                told = f"array {name!r} holds Python objects (pickled), which are not read; "
                told += f"save numbers: numpy.savez({path.name!r}, {name}=...)"
                left_out.add(name, RecordingError(told, given=name))
                continue
            fields = array.dtype.names or ()
            found |= {f"{name}/{field}": array[field] for field in fields} or {name: array}
    return found


def _classes() -> tuple[Any, Any]:
    # `mujoco.sysid` shows the class only if all of its own optional packages are there.
    from mujoco.sysid._src.timeseries import SignalType, TimeSeries

    return TimeSeries, SignalType


def _signal_of(column: str) -> tuple[str, str]:
    for ours, theirs, kind in _ENDINGS:
        if column.endswith(ours) and column != ours:
            return column.removesuffix(ours) + theirs, kind
    return column, "CustomObs"


def _column_of(signal: str, kind: str) -> str:
    for ours, theirs, its_kind in _ENDINGS:
        if kind == its_kind and signal.endswith(theirs):
            return signal.removesuffix(theirs) + ours
    return signal


def _table_of(series: Any) -> dict[str, np.ndarray]:
    data = np.asarray(series.data)
    data = data[:, None] if data.ndim == 1 else data
    if data.ndim != 2 or data.dtype.kind not in "fiub" or series.times.dtype.kind not in "fiub":
        told = f"a time series of shape {data.shape} and type {data.dtype}; allowed: "
        raise RecordingError(told, given=data.shape, allowed="real, (n, m)")
    table = {"time": series.times.astype(np.float64)}
    mapping = series.signal_mapping
    signals = [("signal", "CustomObs", np.arange(data.shape[1]))]
    if mapping is not None:
        signals = [(name, kind.name, np.atleast_1d(i)) for name, (kind, i) in mapping.items()]
    for name, kind, indices in signals:
        column = _column_of(name, kind)
        for i, index in enumerate(indices.tolist()):
            if not 0 <= index < data.shape[1]:
                told = f"signal {name!r} is in column {index} of {data.shape[1]}"
                raise RecordingError(told, given=name)
            key = column if len(indices) == 1 and mapping is not None else f"{column}[{i}]"
            if not key or key in table:
                told = f"signal {name!r} gives the column {key!r}, which is taken"
                raise RecordingError(told, given=name)
            table[key] = data[:, index].astype(np.float64)
    return table
