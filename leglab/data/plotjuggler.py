"""Recordings as CSV that PlotJuggler opens as it is.

What its loader asks for (plotjuggler_plugins/DataLoadCSV in PlotJuggler's sources): names in the
first line and no line before it; the delimiter is guessed from what is not in quotes there, and a
quote cannot be escaped; the first value of a column settles its type, and a number with an
exponent would make it text, a whole number of ten digits a date; an empty cell is no sample.
"""

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np

from leglab.base.errors import RecordingError
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


# Plots of a joint in a layout: columns by their endings.
_PLOTS = (
    ("reference", "truth", "position"),
    ("valve_command", "command", "feedforward", "feedback"),
    ("pressure_a", "pressure_b"),
    ("effort",),
)
_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")


def write_layout(recording: Recording, path: Path) -> None:
    """Writes a layout for PlotJuggler that shows what `write` writes: a tab a joint.

    Args:
        recording: Whose columns are shown.
        path: The file, XML, for *File > Load layout*.

    Raises:
        LeglabError: The recording has no joint, or the folder cannot be written to.
    """
    if not recording.joints:
        raise RecordingError(f"{path}: a layout shows joints, and the recording has none")
    names = _names(recording)
    root = Xml.Element("root")
    tabs = Xml.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    for joint in recording.joints:
        shown = [[names[c] for c in _columns(recording, joint, ends)] for ends in _PLOTS]
        shown = [curves for curves in shown if curves]
        tab = Xml.SubElement(tabs, "Tab", tab_name=joint, containers="1")
        sizes = ";".join(f"{1 / len(shown):.6f}" for _ in shown)
        split = Xml.SubElement(
            Xml.SubElement(tab, "Container"),
            "DockSplitter",
            orientation="|",
            count=str(len(shown)),
            sizes=sizes,
        )
        for curves in shown:
            area = Xml.SubElement(split, "DockArea", name="...")
            plot = Xml.SubElement(area, "plot", mode="TimeSeries", style="Lines")
            for curve, color in zip(curves, _COLORS, strict=False):
                Xml.SubElement(plot, "curve", name=curve, color=color)
    Xml.SubElement(tabs, "currentTabIndex", index="0")
    Xml.SubElement(root, "use_relative_time_offset", enabled="1")
    Xml.indent(root)
    text = Xml.tostring(root, encoding="utf-8", xml_declaration=True)
    write_atomically(path, lambda stream: stream.write(text))


def _columns(recording: Recording, joint: str, ends: tuple[str, ...]) -> list[str]:
    """Columns of a joint with these endings, or of its actuator's command."""
    actuator = recording.actuator_of(joint)
    found = [f"{joint}_{end}" for end in ends]
    if "command" in ends and actuator is not None:
        found.append(f"{actuator}_command")
    return [name for name in dict.fromkeys(found) if name in recording]


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
            raise RecordingError(
                f"column {column!r} would be called {name!r} in PlotJuggler; allowed: ",
                given=column,
                allowed="names that differ in more than quotes and spaces",
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
