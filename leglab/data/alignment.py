"""Resampling of series with different clocks to one clock."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from leglab.base.errors import LeglabError, RecordingError
from leglab.data.column_map import ColumnMap
from leglab.data.files import LeftOut

# Ratio of an interval between messages to the usual interval above which nothing is interpolated.
# It exceeds the jitter on a busy computer, where single messages come one or two periods late.
_GAP = 3.5


@dataclass(frozen=True, eq=False)
class TopicSeries:
    """Numbers of one topic, or of one variable of a workspace, with their time stamps."""

    topic: str  #: The topic, or the variable
    stamps: np.ndarray  #: Time of each message [ns]. Shape (m,), int64.
    columns: Mapping[str, np.ndarray]  #: Values by name, (m,) each; NaN if a message lacks it
    stamped_by: str = "its own"  #: "header" or "log" for a topic

    @property
    def span(self) -> str:
        """First and last stamp in seconds, as text for error messages."""
        if not self.stamps.size:
            return "no message"
        first, last = self.stamps.min() / 1e9, self.stamps.max() / 1e9
        return f"[{first:.3f}, {last:.3f}] s by {self.stamped_by} stamps"


def on_clock(
    series: Iterable[TopicSeries], clock: TopicSeries, columns: ColumnMap, left_out: LeftOut
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Resamples series to the clock of one of them.

    Columns named `..._command` (by the map; without a map by the file) hold their last value; other
    columns are interpolated linearly.

    Args:
        series: Series to resample.
        clock: Series whose stamps become the rows.
        columns: Map, whose names identify commands; its columns must overlap the clock in time.
        left_out: Gets duplicate columns and columns with errors.

    Returns:
        Arrays of shape (n,) by column name, the clock's first, and notes on the resampling.

    Raises:
        RecordingError: Stamps go backwards, or a column of the map shares no time with the clock.
    """
    table, notes, rows = dict(clock.columns), [], clock.stamps
    for one, name in ((each, name) for each in series for name in each.columns):
        hold = columns.name_of(name).endswith("_command")
        first, last = one.stamps.min(), one.stamps.max()
        try:
            if not rows.size or first > rows.max() or (last < rows.min() and not hold):
                apart = f"{name!r} covers {one.span}, {clock.topic!r} covers {clock.span}"
                notes.append(f"left out, no time in common: {apart}")
                if name in columns.rules:
                    by_header = "header" in (one.stamped_by, clock.stamped_by)
                    way = f'; try stamps = "log" in {columns.source}' if by_header else ""
                    raise RecordingError(f"column {apart}{way}", given=name)
                continue
            if name in table:
                both = f"{one.topic!r} and another one both give column {name!r}"
                raise RecordingError(both, given=name)
            table[name] = _aligned(one, name, rows, hold=hold)
            if not np.array_equal(one.stamps, rows):
                how = "last value held" if hold else "linear"
                taken = f"{one.stamps.size} samples by {one.stamped_by} time, {how} on the "
                lacking = f"{np.isnan(table[name]).sum()} rows without a value"
                notes.append(f"{name}: {taken}{rows.size} stamps of {clock.topic}; {lacking}")
        except LeglabError as error:
            left_out.add(name, error)
    return {name: samples for name, samples in table.items() if name not in left_out}, notes


def _aligned(series: TopicSeries, name: str, clock: np.ndarray, *, hold: bool) -> np.ndarray:
    """Resamples a column to the stamps of a clock, (n,); the clock's stamps may be in any order.

    Values are held (zero-order hold) or interpolated linearly. They are NaN before the first
    message, and with interpolation also after the last message and in gaps.
    """
    stamps, values = series.stamps, series.columns[name]
    if np.array_equal(stamps, clock):
        return values
    interval = np.diff(stamps)
    if (interval < 0).any():
        row = int(np.argmax(interval < 0)) + 1
        text = f"topic {series.topic!r}, message {row}: {series.stamped_by} stamp {stamps[row]} ns "
        text += f"comes after {stamps[row - 1]} ns: stamps must not go backwards"
        raise RecordingError(text, given=int(stamps[row]))
    latest = np.append(interval > 0, True)  # last of several messages with equal stamps
    stamps, values = stamps[latest], values[latest]
    before = np.searchsorted(stamps, clock, side="right") - 1
    if hold:
        return np.where(before >= 0, values[before], np.nan)
    # Nanoseconds since the first message fit into a float64; nanoseconds since 1970 do not.
    drawn = np.interp(clock - stamps[0], stamps - stamps[0], values, left=np.nan, right=np.nan)
    width = np.diff(stamps, append=stamps[-1])
    usual = np.median(width[:-1]) if stamps.size > 1 else 0
    in_gap = (width[before] > _GAP * usual) & (clock != stamps[before])
    return np.where(in_gap, np.nan, drawn)
