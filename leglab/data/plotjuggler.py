"""Recordings as CSV that PlotJuggler opens as it is.

What its loader asks for (plotjuggler_plugins/DataLoadCSV in PlotJuggler's sources): names in the
first line and no line before it; the delimiter is guessed from what is not in quotes there, and a
quote cannot be escaped; the first value of a column settles its type, and a number with an
exponent would make it text, a whole number of ten digits a date; an empty cell is no sample.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from leglab.base.errors import LeglabError
from leglab.base.output import write_atomically
from leglab.base.recording import Recording
from leglab.data import csv

# Our own reader takes these files as well.
read_table = csv.read_table

# Beyond, decimals without an exponent become long; only first values must do without it.
_POSITIONAL = (1e-6, 1e16)


def write(recording: Recording, path: Path) -> None:
    """Writes a recording with all digits; missing and infinite samples are empty cells.

    Raises:
        LeglabError: The folder cannot be written to, or two columns get one name.
    """
    names = _names(recording)
    cells = [_cells(samples) for samples in (recording.time, *recording.columns.values())]
    header = ",".join(f'"{name}"' for name in ("time", *names.values()))
    lines = (",".join(row) for row in zip(*cells, strict=True))
    text = "\n".join((header, *lines)) + "\n"
    write_atomically(path, lambda stream: stream.write(text.encode()))


def losses(recording: Recording) -> tuple[str, ...]:
    """Returns what the format cannot hold."""
    found = ["metadata"] if recording.metadata else []
    for old, new in _names(recording).items():
        if old != new:
            found.append(f"column {old!r} is called {new!r}")
    for name, samples in recording.columns.items():
        count = int(np.isinf(samples).sum())
        if count:
            found.append(f"{count} infinite samples of {name!r} become empty cells")
    return tuple(found)


def _names(recording: Recording) -> dict[str, str]:
    """Returns the names in the header by column: no quotes, no line ends, no spaces around."""
    names: dict[str, str] = {}
    for column in recording.columns:
        name = " ".join(column.replace('"', "'").split())
        if name in ("", "time") or name in names.values():
            raise LeglabError(
                f"column {column!r} would be called {name!r} in PlotJuggler; allowed: names that "
                "differ in more than quotes and spaces"
            )
        names[column] = name
    return names


def _cells(samples: np.ndarray) -> Iterator[str]:
    (small, large), first = _POSITIONAL, True
    for value in samples.tolist():
        if not np.isfinite(value):
            yield ""
            continue
        # Shortest decimals that give the same float64, always with a point.
        short = first or value == 0.0 or small <= abs(value) < large
        yield np.format_float_positional(value, unique=True, trim="0") if short else repr(value)
        first = False
