"""Recordings as time series of MuJoCo's system identification, `mujoco.sysid.TimeSeries`.

The class is part of MuJoCo and needs none of the packages of `mujoco[sysid]`.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from leglab.base.errors import RecordingError
from leglab.base.output import write_atomically
from leglab.base.recording import Recording
from leglab.data.clock import Timed
from leglab.data.column_map import ColumnMap
from leglab.data.files import LeftOut
from leglab.data.variables import elements, table_of

if TYPE_CHECKING:
    from mujoco.sysid import TimeSeries

# Ending of MuJoCo's signal name and type of the signal, by the ending of leglab's column name.
_SIGNALS = {
    "position": ("qpos", "MjStateQPos"),
    "velocity": ("qvel", "MjStateQVel"),
    "command": ("ctrl", "MjCtrl"),
}
_QUANTITIES = {signal: quantity for quantity, signal in _SIGNALS.items()}


def to_time_series(recording: Recording) -> "TimeSeries":
    """Returns the recording as a time series; its metadata is lost, NaN stays NaN.

    `mujoco.sysid.ModelSequences` takes controls and measurements separately: select columns first.

    Raises:
        LeglabError: Two columns get one signal name.
    """
    # `mujoco.sysid` exports the class only if all of its optional packages are installed.
    from mujoco.sysid._src.timeseries import SignalType, TimeSeries

    mapping: dict[str, Any] = {}
    for index, column in enumerate(recording.columns):
        owner, _, quantity = column.rpartition("_")
        end, kind = _SIGNALS.get(owner and quantity, (quantity, "CustomObs"))
        signal = column.removesuffix(quantity) + end
        if signal in mapping:
            text = f"two columns become the signal {signal!r}, {column!r} among them"
            raise RecordingError(text, given=column)
        mapping[signal] = (SignalType[kind], np.array([index]))
    data = np.column_stack([np.empty((len(recording), 0)), *recording.columns.values()])
    return TimeSeries(times=np.array(recording.time), data=data, signal_mapping=mapping)


def from_time_series(series: "TimeSeries") -> Recording:
    """Returns a time series as a recording.

    A signal of several numbers gives `name[0]`, `name[1]`, and so on; without a mapping the columns
    are `signal[0]`, `signal[1]`, and so on.

    Args:
        series: Data of shape (n,) or (n, m).

    Raises:
        LeglabError: Times are not finite, an index of the mapping is outside the data, or two
            signals have the same column name.
    """
    table = _table_of(series)
    return Recording(time=table.pop("time"), columns=table)


def read_table(
    path: Path, left_out: LeftOut, columns: ColumnMap | None = None
) -> tuple[dict[str, np.ndarray], dict]:
    """Reads a file of `TimeSeries.save_to_disk`, or the arrays of any `.npz` (`variables`).

    Raises:
        LeglabError: An array holds Python objects, or lengths differ.
    """
    from mujoco.sysid._src.timeseries import TimeSeries

    arrays = _arrays(path, left_out)
    if not {"times", "data"} <= arrays.keys():
        return table_of(arrays, left_out, columns)
    return Timed(_table_of(TimeSeries.load_from_disk(path))), {}


def write(recording: Recording, path: Path) -> None:
    """Writes a file that `TimeSeries.load_from_disk` reads; the metadata is lost.

    Raises:
        LeglabError: The folder cannot be written to, or two columns get one signal name.
    """
    write_atomically(path, to_time_series(recording).save_to_disk)


def _arrays(path: Path, left_out: LeftOut) -> dict[str, Any]:
    """Returns a file's arrays by name; fields of a structured array as `<array>/<field>`."""
    found: dict[str, Any] = {}
    with np.load(path) as file:
        for name in file.files:
            try:
                array = file[name]
            except ValueError as error:
                if "allow_pickle" not in str(error):
                    raise
                text = f"array {name!r} holds Python objects (pickled), which are not read; "
                text += f"save numbers: numpy.savez({path.name!r}, {name}=...)"
                left_out.add(name, RecordingError(text, given=name))
                continue
            fields = array.dtype.names or ()
            found |= {f"{name}/{field}": array[field] for field in fields} or {name: array}
    return found


def _table_of(series: Any) -> dict[str, np.ndarray]:
    # Integers become floats; types other than numbers are rejected.
    time = series.times.astype(np.float64, casting="same_kind")
    data = series.data.astype(np.float64, casting="same_kind").reshape(time.size, -1)
    table, width = {"time": time}, data.shape[1]
    named = (series.signal_mapping or {}).items()
    signals = [(name, kind.name, np.ravel(i)) for name, (kind, i) in named]
    signals = signals or [(f"signal[{i}]", "CustomObs", np.array([i])) for i in range(width)]
    for name, kind, indices in signals:
        if far := [i for i in indices.tolist() if not 0 <= i < width]:
            raise RecordingError(f"signal {name!r} is in column {far[0]} of {width}", given=name)
        owner, _, end = name.rpartition("_")
        column = name.removesuffix(end) + _QUANTITIES.get((owner and end, kind), end)
        for key, samples in elements(column, data[:, indices], time.size):
            if key in table:
                raise RecordingError(f"signal {name!r}: the column {key!r} is taken", given=name)
            table[key] = samples
    return table
