"""Summaries of recording files: time axis, columns, findings."""

from collections.abc import Mapping
from dataclasses import asdict, astuple, dataclass
from typing import Any

import numpy as np

from leglab.base.units import unit_of
from leglab.data.checks import Finding, inspect
from leglab.data.clock import usual_step


@dataclass(frozen=True)
class ColumnSummary:
    """One column."""

    name: str  #: The column
    unit: str  #: Its unit, "" where nothing is known
    smallest: float | None  #: Smallest finite sample; None without one
    largest: float | None  #: Largest finite sample; None without one
    missing: int  #: Samples that are no finite numbers


@dataclass(frozen=True, kw_only=True)
class Summary:
    """A table as it was read, unrepaired."""

    samples: int  #: Rows
    start: float | None  #: First finite time [s]; None without one
    duration: float | None  #: From the first to the last finite time [s]; None without one
    period: float | None  #: Usual interval [s]; None where time does not go forward
    rate: float | None  #: Its inverse [Hz]
    columns: tuple[ColumnSummary, ...]  #: The columns without the time
    findings: tuple[Finding, ...]  #: Errors in the data, see `leglab.data.inspect`
    metadata: Mapping[str, Any]  #: Of the file

    @property
    def gaps(self) -> int:
        """Number of gaps in the time axis, where samples are missing."""
        return sum(finding.kind == "gap" for finding in self.findings)

    def to_json(self) -> dict[str, Any]:
        """Returns the summary as a dictionary for JSON."""
        keys = ("name", "unit", "min", "max", "missing")
        return {
            "samples": self.samples,
            "start_s": self.start,
            "duration_s": self.duration,
            "period_s": self.period,
            "rate_hz": self.rate,
            "gaps": self.gaps,
            "columns": [dict(zip(keys, astuple(c), strict=True)) for c in self.columns],
            "findings": [{**asdict(f), "fatal": f.fatal} for f in self.findings],
            "metadata": dict(self.metadata),
        }


def summarise(table: Mapping[str, np.ndarray], metadata: Mapping[str, Any]) -> Summary:
    """Summarises arrays of shape (n,) by column name, as returned by `leglab.data.read_tables`."""
    time = table.get("time", np.empty(0))
    time = time[np.isfinite(time)]
    period = usual_step(time) or None
    columns = []
    for name in (name for name in table if name != "time"):
        finite = table[name][np.isfinite(table[name])]
        least, most = (float(finite.min()), float(finite.max())) if finite.size else (None, None)
        missing = table[name].size - finite.size
        columns.append(ColumnSummary(name, unit_of(name, metadata), least, most, missing))
    return Summary(
        samples=max((samples.size for samples in table.values()), default=0),
        start=float(time[0]) if time.size else None,
        duration=float(time[-1] - time[0]) if time.size else None,
        period=period,
        rate=1.0 / period if period else None,
        columns=tuple(columns),
        findings=inspect(table),
        metadata=metadata,
    )
