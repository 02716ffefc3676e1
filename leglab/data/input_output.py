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
    stacked = []
    for what, names in (("inputs", inputs), ("outputs", outputs)):
        if isinstance(names, str) or not names:
            told = f"{what} is {names!r}, allowed is "
            raise RecordingError(told, given=names, allowed="a list of one or more columns")
        stacked.append(np.squeeze(np.column_stack([recording[column] for column in names])))
    return Input_output_data(*stacked, sampling_time=recording.sampling_period, name=name)


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
        The recording; a `name` and `state_initialization_window_length` are in its metadata.

    Raises:
        LeglabError: The sampling time is missing or not positive, or names do not fit the columns.
    """
    if data.sampling_time is None:
        raise RecordingError("sampling_time is None, allowed is a positive number of seconds")
    columns: dict[str, np.ndarray] = {}
    for field, names in (("u", inputs), ("y", outputs)):
        samples = np.reshape(getattr(data, field), (len(data), -1))
        if not samples.shape[1] == len(names) == len({*names} - columns.keys()):
            told = f"{field} has {samples.shape[1]} columns, their names are {names!r}; allowed: "
            raise RecordingError(told, given=names, allowed="one name a column, all different")
        columns |= zip(names, samples.T, strict=True)
    metadata: dict[str, Any] = {"name": str(data.name)} if data.name else {}
    window = data.state_initialization_window_length
    metadata |= {} if window is None else {"state_initialization_window_length": int(window)}
    time = start + np.arange(len(data)) * float(data.sampling_time)
    return Recording(time=time, columns=columns, metadata=metadata)
