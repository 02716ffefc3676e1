"""The time axis of a table as it was read: which column it is, its unit, where it begins."""

from collections.abc import Mapping

import numpy as np


class Timed(dict[str, np.ndarray]):
    """Columns of a format that defines `time` in seconds: a reader returns it as it is meant."""


def time_axis(
    table: Mapping[str, np.ndarray], metadata: Mapping[str, object]
) -> tuple[dict[str, np.ndarray], dict]:
    """Brings the time of a table into seconds; all raw columns of all formats pass here.

    Readers hand columns over as they are stored: integers, floats of any size, Booleans,
    datetime64, timedelta64; time of an absolute clock as datetime64, so that no digit is lost.

    Args:
        table: Arrays of shape (n,) by column name.
        metadata: Of the file.

    Returns:
        Arrays of float64 by column name, "time" in s among them where there is one, and the
        metadata with `start_ns`, ns since 1970, where time was moved to begin at 0.
    """
    table, metadata = dict(table), dict(metadata)
    time = table.get("time")
    if time is not None and time.dtype.kind in "Mm":
        ticks = time.astype(f"{time.dtype.kind}8[ns]").astype(np.int64)
        start = int(ticks.min()) if ticks.size and np.abs(ticks).max() > 2**53 else 0
        if start:
            metadata["start_ns"] = start
        table["time"] = (ticks - start) / 1e9
    return {name: samples.astype(np.float64) for name, samples in table.items()}, metadata
