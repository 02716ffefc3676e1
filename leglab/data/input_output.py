"""Recordings as data objects of the `nonlinear_benchmarks` package."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from leglab.base.errors import LeglabError, RecordingError
from leglab.base.recording import Recording

if TYPE_CHECKING:
    from nonlinear_benchmarks import Input_output_data


def to_input_output(
    recording: Recording, inputs: Sequence[str], outputs: Sequence[str], *, name: str | None = None
) -> "Input_output_data":
    """Returns columns as input and output of a benchmark.

    Args:
        recording: Uniformly sampled. NaN stays NaN; metadata and the first time stamp are lost.
        inputs: Columns of `u`; one gives shape (n,), several (n, len(inputs)).
        outputs: Columns of `y`, likewise.
        name: The name of the data.

    Raises:
        LeglabError: The package is missing, a column does not exist, none is named, there is one
            sample only, or samples are not uniform.
    """
    try:
        from nonlinear_benchmarks import Input_output_data
    except ImportError as error:
        told = "the package nonlinear_benchmarks is missing: pip install nonlinear-benchmarks"
        raise LeglabError(told) from error
    return Input_output_data(
        u=_stacked(recording, inputs, "inputs"),
        y=_stacked(recording, outputs, "outputs"),
        sampling_time=recording.sampling_period,
        name=name,
    )


def from_input_output(
    data: "Input_output_data", inputs: Sequence[str], outputs: Sequence[str], *, start: float = 0.0
) -> Recording:
    """Returns the data of a benchmark as a recording.

    Args:
        data: With a `sampling_time` [s]; `u` and `y` of shape (n,) or (n, m).
        inputs: Names of the columns of `u`.
        outputs: Names of the columns of `y`.
        start: Time of the first sample [s].

    Returns:
        The recording; `name` and `state_initialization_window_length`, where given, are in its
        metadata.

    Raises:
        LeglabError: The sampling time is missing, or the numbers of names and columns differ.
    """
    period = data.sampling_time
    if not isinstance(period, (int, float, np.number)) or not 0 < period < np.inf:
        told = f"sampling_time is {period!r}, allowed is "
        raise RecordingError(told, given=period, allowed="a positive number of seconds")
    columns = _split(data.u, inputs, "u", "inputs") | _split(data.y, outputs, "y", "outputs")
    if len(columns) < len(inputs) + len(outputs):
        told = f"columns {', '.join(map(repr, (*inputs, *outputs)))} are not all different"
        raise RecordingError(told, given=(*inputs, *outputs))
    metadata: dict[str, Any] = {"name": str(data.name)} if data.name else {}
    window = data.state_initialization_window_length
    metadata |= {} if window is None else {"state_initialization_window_length": int(window)}
    time = start + np.arange(len(data.y)) * float(period)
    return Recording(time=time, columns=columns, metadata=metadata)


def _stacked(recording: Recording, names: Sequence[str], what: str) -> np.ndarray:
    if isinstance(names, str) or not names:
        told = f"{what} is {names!r}, allowed is "
        raise RecordingError(told, given=names, allowed="a list of one or more columns")
    columns = [np.array(recording[name]) for name in names]
    return columns[0] if len(columns) == 1 else np.column_stack(columns)


def _split(array: Any, names: Sequence[str], field: str, what: str) -> dict[str, np.ndarray]:
    columns = np.asarray(array).T if np.ndim(array) != 1 else np.asarray(array)[None]
    if isinstance(names, str) or columns.ndim != 2 or len(columns) != len(names):
        told = f"{field} has shape {np.shape(array)}, {what} is {names!r}; allowed: "
        raise RecordingError(told, given=names, allowed="one name a column")
    return dict(zip(names, columns, strict=True))
