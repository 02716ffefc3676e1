"""Results that the page of a sweep queries from the dataset: counts, quantities, worst runs."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from leglab.machine.changes import parameter_units
from leglab.report.page.wording import number, readable, readable_unit
from leglab.runs.sweeps.query import Answer
from leglab.runs.sweeps.store import SweepRecord

# Maximum length of the list of worst runs.
MOST_FILMS = 12
# Value of `t90_s`, in medians, for runs that never undo 90 % of the damage [s].
NEVER = 1e9


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A quantity that heat maps and histograms show."""

    name: str  #: Column of the dataset
    title: str  #: Title on the page, with the unit
    factor: float  #: Factor from the dataset's unit to the title's unit
    bad: int  #: +1 if larger values are worse, -1 if smaller values are worse

    @property
    def median(self) -> str:
        """SQL of the median; for `T90` it yields `NEVER` if half of the runs never undo 90 %."""
        if self is not T90:
            return f"median({self.name})"
        value = f"CASE WHEN recovered IS NOT NULL THEN coalesce({self.name}, {NEVER}) END"
        # With an even number of runs the median is the mean of two values; one may be NEVER.
        middle = f"median({value})"
        return f"CASE WHEN {middle} >= {NEVER / 2} THEN {NEVER} ELSE {middle} END"


T90 = Quantity(name="t90_s", title="90 % undone after, s", factor=1.0, bad=1)
RECOVERED = Quantity(name="recovered", title="undone at the end, %", factor=100.0, bad=-1)
END = Quantity(name="end_rad", title="error at the end, mrad", factor=1e3, bad=1)
WHOLE = Quantity(name="rms_rad", title="error of the whole run, mrad", factor=1e3, bad=1)


class Facts:
    """Query results that several parts of the page need.

    Attributes:
        folder: Folder of the sweep.
        record: Content of the folder's `sweep.json`.
        columns: Names of the columns of the dataset.
        done: Number of finished runs, failed ones included.
        failed: Number of failed runs.
        judged: Number of runs whose damage and recovery are known.
        error: Error by which runs are ranked: at the end or, if no run has it, of the whole run.
        quantities: Quantities of heat maps and histograms.
    """

    def __init__(
        self, folder: Path, record: SweepRecord, answered: Callable[[str], Answer]
    ) -> None:
        self.folder, self.record, self._answered = folder, record, answered
        self.columns = set(answered("SELECT * FROM runs LIMIT 0").names)
        ((self.done, self.failed, self.judged, ends, self.sizes, self.seeds),) = self.rows(
            "SELECT count(*), count(*) FILTER (status = 'failed'), count(recovered),"
            " count(end_rad), count(DISTINCT severity), count(DISTINCT seed) FROM runs"
        )
        self.error = END if ends else WHOLE
        self.quantities = (T90, RECOVERED, self.error) if self.judged else (self.error,)

    def rows(self, sql: str) -> tuple[tuple[Any, ...], ...]:
        """Returns the rows of a query in SQL."""
        return self._answered(sql).rows

    @cached_property
    def worst_runs(self) -> tuple[tuple[Any, ...], ...]:
        """Worst runs: run, scenario, controller, element, severity, seed, error, t90, recovered."""
        value, order = ("recovered", "") if self.judged else (self.error.name, " DESC")
        return self.rows(
            f"SELECT run, scenario, controller, element, severity, seed, {self.error.name}, t90_s,"
            f" recovered FROM runs WHERE {value} IS NOT NULL ORDER BY {value}{order}, run"
            f" LIMIT {MOST_FILMS}"
        )


def axis_words(axis: str) -> str:
    """Returns the name of a setting in words: "internal leakage", "memory of the controller"."""
    if axis == "severity":
        return "size"
    table, _, name = axis.rpartition(".")
    owner = {
        "controller_config": " of the controller",
        "reference_config": " of the reference",
        "sensors": " of the sensors",
    }
    first, _, rest = table.partition(".")
    if first == "parameters":
        unit = readable_unit(parameter_units().get(name, ""))
        return readable(name) + (f" of {rest}" if rest else "") + (f" [{unit}]" if unit else "")
    return readable(name) + owner.get(table, "")


def value_words(value: Any) -> str:
    """Formats the value of a setting."""
    if isinstance(value, float):
        return number(value)
    return "none" if value is None else str(value)
