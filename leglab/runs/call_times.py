"""Duration of the controller's `command` calls relative to the control period."""

from bisect import bisect_left
from dataclasses import dataclass
from itertools import accumulate

_BINS = 8  # histogram bins per octave (factor 2) of the duration


@dataclass(frozen=True)
class CallTime:
    """Statistics of call durations [s]."""

    median: float  #: Median, accurate to an eighth of its value
    worst: float
    late: float  #: Share of the calls that took longer than the control period


class CallTimes:
    """Histogram of call durations; its memory use does not depend on the length of the run.

    Args:
        period: Control period [s].
    """

    def __init__(self, period: float) -> None:
        self._period = round(1e9 * period)
        self._count = [0] * (64 * _BINS)
        self._worst = self._late = self._calls = 0

    def add(self, duration: int) -> None:
        """Counts a call of the given duration [ns]."""
        duration = max(duration, _BINS)
        octave = duration.bit_length() - 4
        self._count[_BINS * octave + (duration >> octave) - _BINS] += 1
        self._calls += 1
        if duration > self._worst:
            self._worst = duration
        if duration > self._period:
            self._late += 1

    def told(self) -> CallTime | None:
        """Returns median, worst and share of late calls; None before the first call."""
        if not self._calls:
            return None
        place = bisect_left(list(accumulate(self._count)), self._calls / 2)
        octave, part = divmod(place, _BINS)
        median = (_BINS + part + 0.5) * 2.0**octave
        return CallTime(
            median=1e-9 * min(median, self._worst),
            worst=1e-9 * self._worst,
            late=self._late / self._calls,
        )
