"""Discrete states in a log (enabled, mode, contact) and the times at which they change."""

from collections.abc import Collection

import numpy as np

from leglab.base.recording import Recording
from leglab.base.units import unit_of

# Maximum number of different values of a discrete state; signals in counts have more.
_VALUES = 8


def state_changes(
    recording: Recording, signals: Collection[str], window: float
) -> dict[str, np.ndarray]:
    """Returns the sample indices at which the states of a recording change, by column.

    A state is a column that has few integer values, rare changes and no unit, and is not among the
    `signals`. A column that changes more often than once in two windows of length `window` [s] is
    not a state but a counter or a clock.
    """
    found = {}
    most = 0.5 * recording.duration / window
    for column, samples in recording.columns.items():
        if column in signals or unit_of(column, recording.metadata):
            continue
        rows = np.flatnonzero(np.isfinite(samples))
        values = samples[rows]
        changed = rows[1:][np.diff(values) != 0.0]
        few = 0 < changed.size <= most and np.unique(values).size <= _VALUES
        if few and np.all(values == np.rint(values)):
            found[column] = changed
    return found
