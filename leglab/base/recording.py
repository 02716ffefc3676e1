"""Recordings: measured or simulated time series.

Columns are named after the MJCF element they belong to: `<joint>_position` [rad or m],
`<joint>_velocity`, `<actuator>_command` in [-1, 1], `<joint>_pressure_a` and `<joint>_pressure_b`
[Pa], `supply_pressure` [Pa], `oil_temperature` [°C]. A simulated run adds `<joint>_reference`,
`<joint>_reference_velocity`, `<joint>_reference_acceleration` and quantities without a sensor:
`<joint>_truth` [rad or m], `<joint>_oil_temperature` [°C], `<joint>_seal_clearance` [1, new is 1].
The command of a native MuJoCo actuator is its `ctrl` input, in that actuator's unit;
`<joint>_effort` is its torque or force on the joint [N m or N].
"""

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from leglab.base.errors import RecordingError
from leglab.base.notebook import data_frame, html_table, panels
from leglab.base.units import error_unit, own_units, unit_of

# Metadata key: native actuator of each joint, with centre and half range of the control input.
DRIVES = "drives"
# Metadata key: {"timestep": s, "integrator": MuJoCo's name} of the simulation that was recorded.
SIMULATION = "simulation"
# Semi-implicit integrators of MuJoCo: the position is updated with the new velocity.
_SEMI_IMPLICIT = ("euler", "implicit", "implicitfast", "discrete")
# Maximum number of columns named in the one-line representation, and in the notebook table.
_MOST_NAMES, _MOST_ROWS = 4, 40
# Maximum relative deviation of an interval from the median for uniform time stamps: well above the
# rounding of a time column in milliseconds, well below a lost sample.
_UNIFORM_TOLERANCE = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """Validated time series that share one time axis.

    NaN in a column marks a missing sample; the time axis has none.

    Attributes:
        time: Sample times [s], finite and strictly increasing. Shape (n,), n >= 1, read-only.
        columns: Samples by column name, SI units. Each of shape (n,), float64, read-only.
        metadata: Anything JSON can hold: scenario, seed, versions, ...
    """

    time: np.ndarray
    columns: Mapping[str, np.ndarray]
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        time = _read_only(self.time, "time")
        if time.size == 0:
            raise RecordingError("a recording needs at least one sample, 'time' is empty")
        _check_time(time)
        columns = {}
        for name, samples in self.columns.items():
            if not isinstance(name, str) or not name or name == "time":
                text = f"{name!r} cannot name a column: use "
                raise RecordingError(text, given=name, allowed="text other than 'time'")
            columns[name] = _read_only(samples, name)
            if columns[name].size != time.size:
                raise RecordingError(
                    f"column {name!r} has {columns[name].size} samples, 'time' has {time.size}",
                    given=name,
                )
        for key, value in self.metadata.items():
            try:
                json.dumps({key: value}, allow_nan=False)
            except (TypeError, ValueError) as error:
                text = f"metadata {key!r} cannot be stored as JSON: {error}"
                raise RecordingError(text, given=key) from error
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "columns", MappingProxyType(columns))
        object.__setattr__(self, "metadata", MappingProxyType(dict(self.metadata)))

    def __len__(self) -> int:
        return self.time.size

    def __getitem__(self, name: str) -> np.ndarray:
        """Returns a column, or the time axis for "time". Shape (n,)."""
        if name == "time":
            return self.time
        if name not in self.columns:
            raise RecordingError.unknown("column", name, self.columns)
        return self.columns[name]

    def __iter__(self) -> Iterator[tuple[float, ...]]:
        """Yields each sample as a named tuple of time and columns, as `pandas.DataFrame` accepts.

        `to_pandas` is faster and uses the time as index.
        """
        names = ("time", *self.columns)
        # `namedtuple` would reject column names that are not valid Python identifiers.
        sample = type("Sample", (tuple,), {"_fields": names, "__slots__": ()})
        yield from map(sample, zip(*(self[name].tolist() for name in names), strict=True))

    def __contains__(self, name: object) -> bool:
        return name in self.columns

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Recording):
            return NotImplemented
        return (
            np.array_equal(self.time, other.time)
            and self.columns.keys() == other.columns.keys()
            and all(
                np.array_equal(samples, other.columns[name], equal_nan=True)
                for name, samples in self.columns.items()
            )
            and dict(self.metadata) == dict(other.metadata)
        )

    __hash__ = None  # type: ignore[assignment]  # Arrays have no hash.

    def __reduce__(self) -> tuple:
        # Mapping proxies cannot be pickled, and runs travel between processes.
        own = {"columns": dict(self.columns), "metadata": dict(self.metadata)}
        return partial(Recording, time=self.time, **own), ()

    def __repr__(self) -> str:
        return f"Recording({self._extent()}; {_listed(self.columns)})"

    def _repr_html_(self) -> str:
        rows = []
        for name in list(self.columns)[:_MOST_ROWS]:
            samples = self[name][np.isfinite(self[name])]
            ends = (f"{samples.min():.6g}", f"{samples.max():.6g}") if samples.size else ("", "")
            missing = len(self) - samples.size
            rows.append((name, unit_of(name, self.metadata), *ends, missing or ""))
        if len(self.columns) > _MOST_ROWS:
            rows.append((f"and {len(self.columns) - _MOST_ROWS} more", "", "", "", ""))
        head = ("column", "unit", "smallest", "largest", "missing")
        return html_table(f"Recording: {self._extent()}", head, rows)

    def plot(self, *columns: str) -> list[Any]:
        """Draws columns over time with matplotlib.

        Args:
            columns: Column names; by default positions, references and commands. Columns of the
                same unit share a plot.

        Returns:
            The vertically stacked axes of a new `matplotlib.pyplot` figure.

        Raises:
            RecordingError: A column does not exist, or the recording has no columns.
        """
        if not columns:
            endings = ("_position", "_reference", "_command")
            columns = tuple(c for c in self.columns if c.endswith(endings)) or tuple(self.columns)
        if not columns:
            raise RecordingError("nothing to plot: the recording has no column")
        groups: dict[str, list[str]] = {}
        for name in columns:
            self[name]  # raises for an unknown column before a figure opens
            groups.setdefault(unit_of(name, self.metadata), []).append(name)
        axes = panels(len(groups))
        for axis, (unit, names) in zip(axes, groups.items(), strict=True):
            for name in names:
                axis.plot(self.time, self[name], label=name, linewidth=1.0)
            axis.set_ylabel(unit)
            axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small")
        axes[-1].set_xlabel("time [s]")
        return axes

    def to_pandas(self) -> Any:
        """Returns a `pandas.DataFrame` of the columns in SI units, indexed by time [s].

        Raises:
            LeglabError: pandas is missing.
        """
        columns = {name: samples.copy() for name, samples in self.columns.items()}
        frame = data_frame(columns, index=self.time.copy())
        frame.index.name = "time"
        return frame

    @property
    def duration(self) -> float:
        """Duration from the first to the last sample [s]."""
        return float(self.time[-1] - self.time[0])

    @property
    def sampling_period(self) -> float:
        """Sampling period [s].

        Raises:
            RecordingError: There is only one sample, or the intervals differ (names the row).
        """
        if self.time.size < 2:
            raise RecordingError("a recording of one sample has no sampling period")
        intervals = np.diff(self.time)
        period = float(np.median(intervals))
        worst = int(np.argmax(np.abs(intervals - period)))
        if abs(intervals[worst] - period) > _UNIFORM_TOLERANCE * period:
            raise RecordingError(
                f"samples are not uniform: {intervals[worst]:g} s between rows {worst} and "
                f"{worst + 1}, usual are {period:g} s",
                given=float(intervals[worst]),
            )
        return self.duration / (self.time.size - 1)

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints with a `<joint>_position` column, in column order."""
        return self._owners("_position")

    @property
    def tracked(self) -> tuple[str, ...]:
        """Joints with a position and a reference; passive joints have no reference."""
        return tuple(joint for joint in self.joints if f"{joint}_reference" in self)

    @property
    def actuators(self) -> tuple[str, ...]:
        """Actuators with an `<actuator>_command` column, in column order."""
        return self._owners("_command")

    @property
    def actuators_are_valves(self) -> bool:
        """True if no joint has a native MuJoCo actuator according to the metadata."""
        return all(self._drive(joint) is None for joint in self.joints)

    def actuator_of(self, joint: str) -> str | None:
        """Returns the name of the actuator that drives a joint; None if none was recorded.

        The metadata name native actuators; other actuators have the name of their joint, or
        `<joint>_valve`.
        """
        drive = self._drive(joint)
        names = (drive[0],) if drive else (joint, f"{joint}_valve")
        return next((name for name in names if f"{name}_command" in self), None)

    def command_of(self, joint: str) -> np.ndarray | None:
        """Returns the commands of a joint, scaled to [-1, 1], (n,); None without an actuator.

        Valve commands are recorded in this scale; inputs of native actuators are converted to it.
        """
        actuator, drive = self.actuator_of(joint), self._drive(joint)
        if actuator is None:
            return None
        sent = self[f"{actuator}_command"]
        return (sent - drive[1]) / drive[2] if drive else sent

    @property
    def command_lead(self) -> float | None:
        """Time by which commands act early [s]: half a step of a semi-implicit integrator.

        Such an integrator moves the position by h v + h² a in the first step after a change of
        the acceleration a, a real machine by h v + h² a / 2. MuJoCo's RK4 and a real machine have
        no lead. The time step h is in the metadata of a simulated run; None if the metadata name
        no simulation.
        """
        told: Any = self.metadata.get(SIMULATION)
        try:
            integrator, timestep = told["integrator"], float(told["timestep"])
        except (TypeError, KeyError, ValueError):
            return None
        if integrator == "rk4":
            return 0.0
        if integrator not in _SEMI_IMPLICIT or not 0.0 < timestep <= self.time[-1] - self.time[0]:
            return None
        return 0.5 * min(timestep, float(np.median(np.diff(self.time))))

    def _drive(self, joint: str) -> tuple[str, float, float] | None:
        """Returns name, control centre and half range of a joint's native actuator, or None."""
        drives = self.metadata.get(DRIVES)
        told: Any = drives.get(joint) if isinstance(drives, Mapping) else None
        try:
            return str(told["actuator"]), float(told["centre"]), float(told["half"])
        except (TypeError, KeyError, ValueError):
            return None

    def stack(self, elements: Iterable[str], quantity: str) -> np.ndarray:
        """Returns one quantity of several elements as the columns of an array.

        Args:
            elements: Joints or actuators.
            quantity: Suffix of the column names, for instance "position" or "pressure_a".

        Returns:
            Samples, in the column's unit. Shape (n, len(elements)).

        Raises:
            RecordingError: A column does not exist.
        """
        return np.column_stack([self[f"{element}_{quantity}"] for element in elements])

    def select(self, names: Iterable[str]) -> "Recording":
        """Returns a recording with only these columns, in this order.

        Raises:
            RecordingError: A column does not exist.
        """
        return replace(self, columns={name: self[name] for name in names})

    def between(self, start: float | None, end: float | None) -> "Recording":
        """Returns the samples with start <= time < end [s]; None for no limit.

        Raises:
            RecordingError: There is no such sample.
        """
        if start is None and end is None:
            return self
        start = -np.inf if start is None else start
        end = np.inf if end is None else end
        first, last = np.searchsorted(self.time, (start, end))
        if first >= last:
            raise RecordingError(
                f"no sample in [{start:g}, {end:g}) s: the recording covers ",
                given=(start, end),
                allowed=f"[{self.time[0]:g}, {self.time[-1]:g}] s",
            )
        columns = {name: samples[first:last] for name, samples in self.columns.items()}
        return replace(self, time=self.time[first:last], columns=columns)

    def error_unit(self, joints: Iterable[str] | None = None) -> str:
        """Returns the unit in which tracking errors are reported: "mrad", "mm" or "mrad or mm".

        Args:
            joints: Names of joints; None for all with a position column. A joint whose unit is
                not recorded counts as a hinge.
        """
        units = own_units(self.metadata)
        names = self.joints if joints is None else joints
        return error_unit(units.get(f"{joint}_position") == "m" for joint in names)

    def with_columns(self, columns: Mapping[str, np.ndarray]) -> "Recording":
        """Returns a recording with more columns; existing ones of the same name are replaced."""
        return replace(self, columns={**self.columns, **columns})

    def with_metadata(self, **metadata: Any) -> "Recording":
        """Returns a recording with more metadata; existing keys are replaced."""
        return replace(self, metadata={**self.metadata, **metadata})

    def _extent(self) -> str:
        """Returns number of samples, duration and sampling rate as text."""
        text = f"{len(self)} sample{'s' * (len(self) > 1)}"
        if len(self) > 1:
            rate = 1.0 / float(np.median(np.diff(self.time)))
            text += f" over {self.duration:g} s at {rate:.4g} Hz"
        return text

    def _owners(self, ending: str) -> tuple[str, ...]:
        return tuple(name.removesuffix(ending) for name in self.columns if name.endswith(ending))


def _listed(names: Iterable[str]) -> str:
    names = list(names)
    more = len(names) - _MOST_NAMES
    count = f"{len(names)} column{'s' * (len(names) != 1)}"
    shown = ", ".join(names[:_MOST_NAMES]) + (f" and {more} more" if more > 0 else "")
    return f"{count}: {shown}" if names else count


def _read_only(samples: Any, name: str) -> np.ndarray:
    """Returns the samples as a read-only float64 array (n,) that shares no writable memory."""
    array = np.asarray(samples)
    if array.ndim != 1:
        text = f"column {name!r} has shape {array.shape}, allowed is "
        raise RecordingError(text, given=array.shape, allowed="(n,)")
    if array.dtype == np.float64 and array.base is None and not array.flags.writeable:
        return array
    try:
        array = np.array(array, dtype=np.float64)
    except (TypeError, ValueError) as error:
        row, value = _first_not_a_number(array)
        text = f"column {name!r}, row {row}: {value!r} is not "
        raise RecordingError(text, given=value, allowed="a number") from error
    array.setflags(write=False)
    return array


def _first_not_a_number(array: np.ndarray) -> tuple[int, Any]:
    for row, value in enumerate(array.tolist()):
        try:
            float(value)
        except (TypeError, ValueError):
            return row, value
    return 0, array.tolist()[0]


def _check_time(time: np.ndarray) -> None:
    finite = np.isfinite(time)
    if not finite.all():
        row = int(np.argmin(finite))
        text = f"column 'time', row {row}: {time[row]} is not "
        raise RecordingError(text, given=float(time[row]), allowed="a finite time")
    backwards = np.diff(time) <= 0
    if backwards.any():
        row = int(np.argmax(backwards)) + 1
        raise RecordingError(
            f"column 'time', row {row}: {float(time[row])!r} s does not come after "
            f"{float(time[row - 1])!r} s; time must increase strictly",
            given=float(time[row]),
        )
