"""Series with clocks of their own, brought onto one."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from leglab.base.errors import RecordingError

# A pause this many times the usual interval is a gap that no value is drawn across: above the
# jitter of a topic on a busy computer, where single messages come one or two periods late.
_GAP = 3.5


@dataclass(frozen=True, eq=False)
class TopicSeries:
    """The numbers of one topic."""

    topic: str  #: The topic
    stamps: np.ndarray  #: Time of each message [ns]. Shape (m,), int64.
    #: Numbers by column name, NaN where a message has none. Each of shape (m,).
    columns: Mapping[str, np.ndarray]
    stamped_by: str  #: "header" or "log"

    @property
    def span(self) -> str:
        """First and last stamp in seconds, for messages."""
        if not self.stamps.size:
            return "no message"
        first, last = self.stamps.min() / 1e9, self.stamps.max() / 1e9
        return f"[{first:.3f}, {last:.3f}] s by {self.stamped_by} stamps"


def overlaps(series: TopicSeries, clock: np.ndarray, *, hold: bool) -> bool:
    """Returns whether any row of the clock gets a value.

    Args:
        series: The series.
        clock: Times of the rows [ns]. Shape (n,).
        hold: See `aligned`.
    """
    if not series.stamps.size or not clock.size:
        return False
    begins_in_time = bool(series.stamps.min() <= clock.max())
    return begins_in_time and (hold or bool(series.stamps.max() >= clock.min()))


def aligned(series: TopicSeries, name: str, clock: np.ndarray, *, hold: bool) -> np.ndarray:
    """Brings one column onto a clock.

    Args:
        series: The series, with at least one message.
        name: The column.
        clock: Times of the rows [ns], in any order. Shape (n,).
        hold: Whether the last value holds (a command), else values are drawn linearly between
            neighbours, not across gaps (a measurement).

    Returns:
        Values; NaN before the first message, and for a measurement after the last one and in
        gaps. Shape (n,).

    Raises:
        RecordingError: Stamps go backwards; names the topic and the message.
    """
    stamps, values = series.stamps, series.columns[name]
    if np.array_equal(stamps, clock):
        return values
    interval = np.diff(stamps)
    if (interval < 0).any():
        row = int(np.argmax(interval < 0)) + 1
        raise RecordingError(
            f"topic {series.topic!r}, message {row}: {series.stamped_by} stamp {stamps[row]} ns "
            f"comes after {stamps[row - 1]} ns; allowed: ",
            given=int(stamps[row]),
            allowed="stamps that do not go backwards",
        )
    latest = np.append(interval > 0, True)  # Of several messages at one time the last one counts.
    stamps, values = stamps[latest], values[latest]
    before = np.searchsorted(stamps, clock, side="right") - 1
    if hold:
        return np.where(before >= 0, values[np.maximum(before, 0)], np.nan)
    after = np.minimum(before + 1, stamps.size - 1)
    start = np.maximum(before, 0)
    # Differences of integers: nanoseconds since 1970 do not fit into a float64.
    width = stamps[after] - stamps[start]
    share = (clock - stamps[start]) / np.maximum(width, 1)
    with np.errstate(invalid="ignore", over="ignore"):
        between = values[start] + share * (values[after] - values[start])
    usual = np.median(np.diff(stamps)) if stamps.size > 1 else 0
    known = (before >= 0) & (clock <= stamps[-1]) & (width <= _GAP * usual)
    on_stamp = clock == stamps[start]
    return np.where(on_stamp, values[start], np.where(known, between, np.nan))
