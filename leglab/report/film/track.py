"""One run of a film: its recording, its changes, and signals computed from them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from leglab import data
from leglab.base.errors import FileError, RecordingError
from leglab.base.recording import Recording
from leglab.causes.fault_names import FaultEvent, FaultTrend
from leglab.report.film.look import TIMES
from leglab.report.page.outcome import t90
from leglab.report.page.wording import readable, readable_unit
from leglab.runs import metrics, record
from leglab.runs.folder import model_of

# A run that ends more than this time before its planned end counts as stopped early [s].
_TOLERANCE = 0.05

# Suffixes of a joint's columns about slow wear: number of the fault, magnitude, remaining life [s].
_FOLLOWED = ("fault", "size", "remaining")


@dataclass(frozen=True, kw_only=True)
class ShownChange:
    """A text shown from start to end [s], about a change: "internal leakage x 10"."""

    start: float
    end: float
    text: str


@dataclass(frozen=True, kw_only=True)
class Track:
    """One run of a film."""

    folder: Path
    settings: Mapping[str, Any]  #: Settings of the run, from `run.json`
    model: str  #: Name of the model, or path of its copy in the run's folder
    machine: tuple[str, float | None]  #: Digest or name of the model, and time step [s]
    recording: Recording
    joints: tuple[str, ...]  #: Driven joints with a reference
    actuators: tuple[str, ...]  #: Actuator of each joint
    changes: tuple[ShownChange, ...]  #: Changes of the machine, in the order of their start
    elements: Mapping[str, Mapping[str, float]]  #: Parameters of each actuator at the start
    window: float  #: Window of the moving RMS error [s]
    failure: str  #: Reason why the run stopped early; empty if it did not, or if unknown
    #: Time from which the film reports that 90 % of the damage are undone [s], and its text; None
    #: if the run never undoes 90 %.
    undone: tuple[float, str] | None = None
    #: Faults named by the controller, each from its naming until it is withdrawn or undone [s].
    named: tuple[ShownChange, ...] = ()

    @property
    def start(self) -> float:
        """First time recorded [s]."""
        return float(self.recording.time[0])

    @property
    def end(self) -> float:
        """Last time recorded [s]."""
        return float(self.recording.time[-1])

    @property
    def planned_end(self) -> float:
        """Planned end of the run [s]."""
        return float(self.settings.get("duration") or self.end)

    @property
    def stopped(self) -> bool:
        """True if the run ended before its planned end."""
        return bool(self.failure) or self.end < self.planned_end - _TOLERANCE

    def row(self, time: float) -> int:
        """Returns the index of the last sample up to a time [s], clipped to the recording."""
        rows = self.recording.time
        return int(np.clip(np.searchsorted(rows, time + 1e-9, side="right") - 1, 0, len(rows) - 1))

    def column(self, *names: str) -> np.ndarray | None:
        """Returns the first recorded column of `names`, (n,); the last value fills its gaps."""
        for name in names:
            if name in self.recording:
                return _filled(self.recording[name])
        return None

    def command(self, joint: str) -> np.ndarray | None:
        """Returns a joint's commands in [-1, 1], (n,), filled like `column`; None if missing."""
        found = self.recording.command_of(joint)
        return None if found is None else _filled(found)

    def moving_error(self) -> np.ndarray:
        """Returns the RMS error of all joints over the window ending at each sample [rad], (n,)."""
        errors = []
        for joint in self.joints:
            true = f"{joint}_truth" if f"{joint}_truth" in self.recording else f"{joint}_position"
            reference = self.recording[f"{joint}_reference"]
            errors.append(_filled(self.recording[true]) - _filled(reference))
        return metrics.sliding_rms(self.recording.time, np.stack(errors, axis=1), self.window)

    def seal_leakage(self) -> np.ndarray | None:
        """Returns the seal leakage relative to the new machine at equal viscosity, (n, joints).

        C over C_new = internal_leakage / (its value at the start) x clearance^3,
        docs/concepts/physics.md. None if neither leakage nor clearance was recorded.
        """
        factors, known = [], False
        for joint, actuator in zip(self.joints, self.actuators, strict=True):
            factor = np.ones(len(self.recording))
            leakage = self.column(f"{actuator}_internal_leakage")
            new = self.elements.get(actuator, {}).get("internal_leakage", 0.0)
            if leakage is not None and new > 0:
                factor, known = factor * leakage / new, True
            clearance = self.column(f"{joint}_seal_clearance")
            if clearance is not None:
                factor, known = factor * clearance**3, True
            factors.append(factor)
        return np.stack(factors, axis=1) if known else None

    def oil_temperature(self) -> np.ndarray | None:
        """Returns the mean oil temperature of the cylinders [degC], (n,); None if not recorded."""
        found = (self.column(f"{j}_oil_temperature", "oil_temperature") for j in self.joints)
        there = [values for values in found if values is not None]
        return np.mean(there, axis=0) if there else None


def load_track(folder: Path) -> Track:
    """Reads the folder of a run.

    Raises:
        LeglabError: The folder holds no run, or a file is damaged; the message names both.
    """
    for name in (record.CONFIGURATION, record.RECORDING):
        if not (folder / name).exists():
            why = f"is not the folder of a run: it has no {name}"
            raise FileError(f"{str(folder)!r} {why}", given=folder)
    path = folder / record.CONFIGURATION
    run = record.read(record.RunConfiguration, path)
    if not {"model", "scenario", "controller"} <= set(run.settings):
        why = "it has no settings with model, scenario, controller"
        raise FileError(f"{path}: {why}", given=path)
    recording = data.read(folder / record.RECORDING)
    joints = recording.tracked
    if not joints:
        why = "no joint of the recording has a reference"
        raise RecordingError(f"{str(folder)!r}: {why}", given=folder)
    file = folder / record.METRICS
    told = record.read(record.RunMetrics, file) if file.exists() else None
    return Track(
        folder=folder,
        settings=run.settings,
        model=model_of(folder, run),
        machine=(run.model_digest or run.settings["model"], run.settings.get("timestep")),
        recording=recording,
        joints=joints,
        actuators=tuple(recording.actuator_of(joint) or joint for joint in joints),
        changes=_changes(run.changes, recording),
        elements=run.elements,
        window=min(run.window, max(0.25 * recording.duration, 1e-3)),
        failure=(told and told.failure) or "",
        undone=None if told is None else _undone(told.adaptation, run.changes),
        named=() if told is None else (*_named(told.events), *_slowly(told.health, recording)),
    )


def _named(events: Sequence[FaultEvent]) -> Iterator[ShownChange]:
    """Yields texts "named: knee seal wear 11.4, 100 %", until a fault is undone or withdrawn."""
    back = {name.undoes: name.time for event in events for name in event.names[-1:]}
    for event in events:
        name = event.names[-1]
        end = min(back.get(name.onset, np.inf), event.withdrawn or np.inf)
        yield ShownChange(start=name.time, end=end, text=f"named: {event.short()}")


def _slowly(trends: Sequence[FaultTrend], recording: Recording) -> Iterator[ShownChange]:
    """Yields texts on slow wear, from its first report on, with magnitude and life at each time.

    Conditions, and wear without columns in the recording, are shown with their final values.
    """
    for trend in trends:
        elements = recording.tracked if trend.element == "all" else trend.element.split(",")
        names = [[f"{element}_health_{what}" for what in _FOLLOWED] for element in elements]
        there = [columns for columns in names if all(name in recording for name in columns)]
        said = [np.array([recording[name] for name in columns]) for columns in there]
        # A joint without a fault after this trend's first report belongs to another trend.
        said = [values for values in said if values[0, recording.time >= trend.time].any()]
        if trend.condition or not said:
            text = f"slowly until {trend.seen:.0f} s: {trend.short()}"
            yield ShownChange(start=trend.time, end=np.inf, text=text)
            continue
        yield from _looks(trend, recording.time, said[0])


def _looks(trend: FaultTrend, time: np.ndarray, said: np.ndarray) -> Iterator[ShownChange]:
    """Yields a trend's text at each change of `said`, the columns of `_FOLLOWED`, (3, n)."""
    before, after = said[:, :-1], said[:, 1:]
    new = np.any((before != after) & ~(np.isnan(before) & np.isnan(after)), axis=0)
    starts = np.union1d(np.flatnonzero(new) + 1, np.searchsorted(time, trend.time))
    starts = starts[(time[np.minimum(starts, len(time) - 1)] >= trend.time) & (starts < len(time))]
    for first, last in zip(starts, [*starts[1:], len(time)], strict=True):
        fault, size, remaining = (None if np.isnan(x) else float(x) for x in said[:, first])
        if not fault:
            continue
        then = trend.model_copy(update={"size": size, "remaining": remaining})
        end = np.inf if last == len(time) else float(time[last])
        yield ShownChange(start=float(time[first]), end=end, text=f"slowly: {then.short()}")


def _undone(
    found: record.AdaptationMetrics, changes: Sequence[record.ChangeRecord]
) -> tuple[float, str] | None:
    """Returns the end of the stride in which 90 % are undone [s], and a text; None if never."""
    if found.t90_s is None or found.stride_s is None or not changes:
        return None
    over = min(change.start for change in changes) + found.t90_s + found.stride_s
    if found.t90_s == 0.0:
        return over, t90(found)
    # `t90_s` is the start of a stride; the trace shows a stride at its end, one stride later.
    return over, f"strides from {found.t90_s:.2f} s after the change on: 90 % undone"


def details(tracks: list[Track]) -> list[str]:
    """Returns one text per run with the settings in which runs differ besides the controller."""
    shown: list[list[str]] = [[] for _ in tracks]
    names = [str(track.settings["controller"]) for track in tracks]
    scenarios = {track.settings["scenario"] for track in tracks}
    # Severities of different scenarios have different units and cannot be compared.
    keys = ("scenario", "model", *(() if len(scenarios) > 1 else ("severity",)), "seed")
    for key in keys:
        values = [track.settings.get(key) for track in tracks]
        if len({str(value) for value in values}) > 1:
            prefix = f"{key} " if key in ("severity", "seed") else ""
            for texts, value in zip(shown, values, strict=True):
                text = f"{value:g}" if isinstance(value, float) else Path(str(value)).stem
                texts.append(prefix + readable(text))
    found = [" · ".join(texts) for texts in shown]
    if len(set(zip(names, found, strict=True))) < len(tracks):
        found = [" · ".join([*t, r.folder.name]) for t, r in zip(shown, tracks, strict=True)]
    return found


def _filled(values: np.ndarray) -> np.ndarray:
    good = np.isfinite(values)
    if good.all() or not good.any():
        return values
    last = np.maximum.accumulate(np.where(good, np.arange(len(values)), 0))
    filled = values[last]
    filled[: np.argmax(good)] = values[np.argmax(good)]
    return filled


def _changes(
    changes: Sequence[record.ChangeRecord], recording: Recording
) -> tuple[ShownChange, ...]:
    from leglab.machine.changes import parameter_units

    units = {name: readable_unit(unit) for name, unit in parameter_units().items()}
    told: dict[tuple[float, str], ShownChange] = {}
    for change in changes:
        name, start = change.parameter, change.start
        amount = f"{change.value:.4g} {units.get(name, '')}".strip()
        if change.kind == "scale":
            amount = f"{TIMES}{change.value:.4g}"
        where = "" if change.element == "*" else f" ({change.place})"
        text = f"{readable(name)} {amount}{where}"
        if start <= recording.time[-1]:
            end = start + change.ramp_duration
            told.setdefault((start, text), ShownChange(start=start, end=end, text=text))
    return tuple(sorted(told.values(), key=lambda change: change.start))
