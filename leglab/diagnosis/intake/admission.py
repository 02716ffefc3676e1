"""Choice of the recordings and columns that a diagnosis can use, with remarks for the user."""

from collections.abc import Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from leglab.base.errors import RecordingError
from leglab.base.recording import Recording
from leglab.diagnosis.intake.outliers import alternates, unsupported
from leglab.diagnosis.intake.remarks import Remark, merged
from leglab.diagnosis.intake.rotation import unwrapped
from leglab.diagnosis.intake.series import Clock, common_period
from leglab.diagnosis.intake.states import state_changes
from leglab.diagnosis.intake.units import ANGLES, fits, in_map, other_unit
from leglab.diagnosis.plant.columns import usable_columns
from leglab.diagnosis.plant.model import CHAMBERS, Machine
from leglab.diagnosis.thresholds import DEFAULT, NEIGHBOURS, SAME, Thresholds


@dataclass(frozen=True, kw_only=True, eq=False)
class Admitted:
    """Recordings that a diagnosis can use."""

    #: Recordings by name, with only the needed columns, and with unwrapped positions.
    recordings: Mapping[str, Recording]
    held_out: tuple[str, ...]  #: Names of the recordings by which the diagnosis is judged
    notes: tuple[str, ...]  #: Remarks on data that were left out, repaired or doubted


def admit(
    machine: Machine,
    recordings: Mapping[str, Recording],
    held_out: Iterable[str] = (),
    thresholds: Thresholds = DEFAULT,
) -> Admitted:
    """Chooses the recordings and columns that can be used; admitting twice changes nothing.

    Columns that the model does not need are ignored. A recording with an unusable position or
    command is left out if others remain. Recordings that lack pressures are left out if the others
    contain at least half of the recorded time, and one recording to fit and one to judge by;
    otherwise these pressures are not used.

    Raises:
        RecordingError: No recording can be used, or none is left to fit or to judge by. The message
            names the recording, the column, its values and the allowed values.
    """
    held = tuple(name for name in held_out if name in recordings)
    entries = {name: _Entry(machine, r, thresholds) for name, r in recordings.items()}
    dropped = {name: entry.fault for name, entry in entries.items() if entry.fault}
    usable = {name: entry for name, entry in entries.items() if not entry.fault}
    if not usable:
        name, others = next(iter(entries)), len(entries) - 1
        more = f" (and {others} more recordings cannot be used)" if others else ""
        raise RecordingError(f"{name}: {dropped[name]}{more}", given=name)
    doubted = ((n, column, why) for n, e in entries.items() for column, why in e.doubted.items())
    refuse_shared(doubted, len(entries))
    fastest = min(entry.clock.period for entry in usable.values())
    for name, period in [(name, entry.clock.period) for name, entry in usable.items()]:
        # If one recording has two samples per bin, all need at least one sample in two bins.
        if fastest <= 0.5 * thresholds.bin and period > 2.0 * thresholds.bin:
            dropped[name] = f"sampled every {period:.4g} s only, the others every {fastest:.4g} s"
            del usable[name]
    check_roles(usable, dropped, held)
    columns = _pressures(usable, held)
    for name, entry in list(usable.items()):
        if missing := sorted(columns - entry.pressures):
            why = entry.lost.get(missing[0], f"no column {missing[0]!r}")
            dropped[name] = f"{why}, and the other recordings have all pressures"
            del usable[name]
    remarks = [Remark(f"left out, {why}", name) for name, why in dropped.items()]
    needed, admitted = [*machine.columns, *sorted(columns)], {}
    for name, entry in usable.items():
        admitted[name] = entry.recording.select(needed)
        entry.lost |= dict.fromkeys(sorted(entry.pressures - columns), "other recordings lack them")
        said = [(f"pressures are not used, {why}", repr(c)) for c, why in entry.lost.items()]
        said += [*entry.said, *entry.doubts(admitted[name])]
        remarks += [Remark(text, name, place) for text, place in said]
    return Admitted(
        recordings=admitted,
        held_out=tuple(name for name in held if name in admitted),
        notes=merged(remarks, recordings) + _rates(usable, thresholds),
    )


def refuse_shared(doubts: Iterable[tuple[str, Hashable, str]], count: int) -> None:
    """Raises an error if at least half of `count` recordings share a doubt, e.g. about a unit.

    A doubt consists of the recording's name, a key that equal doubts share, and a question to ask.
    """
    shared: dict[Hashable, list[tuple[str, str]]] = {}
    for name, alike, question in doubts:
        shared.setdefault(alike, []).append((name, question))
    most = max(shared.values(), key=len, default=[])
    if most and 2 * len(most) >= count:
        more = f" (and {len(most) - 1} more recordings)" if len(most) > 1 else ""
        raise RecordingError(f"{most[0][0]}{more}: {most[0][1]}", given=most[0][0])


def check_roles(usable: Iterable[str], dropped: Mapping[str, str], held: tuple[str, ...]) -> None:
    """Raises an error if no held-out or no fitted recording is usable."""
    if held and not set(held) & set(usable):
        text = f"{held[0]}: {dropped[held[0]]}; it was to be held out; allowed: "
        raise RecordingError(text, given=held[0], allowed="another recording held out")
    if set(usable) <= set(held):
        if not dropped:
            text = "every recording is held out; allowed: "
            raise RecordingError(text, given=held, allowed="at least one to fit")
        name, why = next(iter(dropped.items()))
        raise RecordingError(f"{name}: {why}; no recording is left to fit", given=name)


def _pressures(usable: Mapping[str, "_Entry"], held: tuple[str, ...]) -> frozenset[str]:
    """Returns the largest set of pressure columns that enough recordings contain; see `admit`."""
    total = sum(e.recording.duration for e in usable.values())

    def serve(columns: frozenset[str]) -> bool:
        complete = {name for name, e in usable.items() if columns <= e.pressures}
        judged = complete & set(held) if held else len(complete) > 1 or len(usable) == 1
        enough = sum(usable[name].recording.duration for name in complete) >= 0.5 * total
        return bool(enough and judged and complete - set(held))

    common = frozenset.intersection(*(e.pressures for e in usable.values()))
    return max(filter(serve, (e.pressures for e in usable.values())), key=len, default=common)


class _Entry:
    """A recording checked for a diagnosis; `recording` has its usable columns after repair."""

    def __init__(self, machine: Machine, recording: Recording, limits: Thresholds):
        self.columns = {one.name: one for one in usable_columns(machine)}
        known = [name for name, one in self.columns.items() if one.kind in CHAMBERS]
        reasons = recording.metadata.get("unreadable", {})
        self.machine, self.limits = machine, limits
        own = recording.select(c for c in (*machine.columns, *known) if c in recording)
        self.logged = self.recording = own
        time = recording.metadata.get("time")
        #: Remarks on reading and repairs: text and place, as in `Remark`.
        self.said = [(f"time: {time}", "")] if isinstance(time, str) else []
        self.doubted: dict[str, str] = {}  # question about the unit, by column
        mixed = self._leave_out()
        faults = {c: self._pressure_fault(c) if c in own else reasons.get(c) for c in known}
        #: Reasons why pressures cannot be used, by column.
        self.lost = {column: why for column, why in faults.items() if why}
        self.pressures = frozenset(c for c in known if c in own and c not in self.lost)
        # Reason why the recording cannot be used at all.
        self.fault = self._missing(recording, reasons) or mixed
        for column in (f"{joint}_position" for joint in machine.joints):
            self.fault = self.fault or self._unwrap(column) or self._position_fault(column)
        if not self.fault:
            self._pause(state_changes(recording, (*machine.columns, *known), self.limits.window))
            self.clock = Clock.of(own.time)

    def _repair(self, column: str, samples: np.ndarray, text: str, place: str) -> None:
        """Replaces the samples of a column, and adds a remark."""
        self.recording = self.recording.with_columns({column: samples})
        self.said.append((text, place))

    def _missing(self, recording: Recording, reasons: Mapping[str, str]) -> str | None:
        """Returns the reason why a position or command is missing, None if all exist."""
        needed = self.machine.columns
        absent = [column for column in needed if column not in recording]
        if why := next((reasons[column] for column in absent if column in reasons), None):
            return why
        if absent:
            return (
                f"no column {', '.join(map(repr, absent))}; the recording has "
                f"{', '.join(recording.columns)}. Measured under other names? leglab inspect "
                "RECORDING --model MODEL --out map.toml proposes a column map, for --columns"
            )
        for column in needed:
            if np.isfinite(recording[column]).sum() < 2:
                why = f"column {column!r} holds no numbers"
                return f"{why}; allowed: numbers, NaN where one is missing"
        if len(recording) < 3:
            return f"{len(recording)} samples are too few to replay"
        return None

    def _leave_out(self) -> str | None:
        """Removes samples that no motion explains; returns a fault if a position mixes two signals.

        Commands are not checked, because they may change abruptly.
        """
        for column, samples in self.recording.columns.items():
            if column.endswith("_command"):
                continue
            if column.endswith("_position") and alternates(samples):
                why = f"every other row of column {column!r} is another signal's; two publishers?"
                return f"{why} allowed: one source a column"
            if (gone := unsupported(samples)).any():
                kept, rows = np.where(gone, np.nan, samples), np.flatnonzero(gone)
                known = np.flatnonzero(np.isfinite(kept))
                off = np.abs(samples[rows] - np.interp(rows, known, kept[known]))
                worst = rows[np.argmax(off)]
                at = f"{samples[worst]:.4g} at {self.recording.time[worst]:.5g} s"
                text = "samples that jump away from the motion are left out"
                self._repair(column, kept, text, f"{column!r} {rows.size}, worst {at}")
        return None

    def _pause(self, changes: Mapping[str, np.ndarray]) -> None:
        """Removes samples near changes of a mode or contact, so that no window contains any."""
        column, time = self.machine.columns[0], self.recording.time
        # Gaps of this length are not interpolated.
        reach = max(NEIGHBOURS * float(np.median(np.diff(time))), self.limits.bin)
        for state, rows in changes.items():
            samples = self.recording[column].copy()
            for at in time[rows].tolist():
                samples[slice(*np.searchsorted(time, (at - reach, at + reach)))] = np.nan
            if np.isfinite(samples).sum() >= 2:
                text = "windows across changes of a state are left out"
                self._repair(column, samples, text, f"{state!r} {rows.size} times")

    def _unwrap(self, column: str) -> str | None:
        """Removes encoder jumps from positions; returns a question if the unit is in doubt."""
        unit, allowed = self.columns[column].unit, self.columns[column].limits
        found = unwrapped(self.recording.time, self.recording[column], hinge=unit == "rad")
        if found is None:
            return None
        samples, turn, jumps = found
        for other, factor in ANGLES.items():
            if unit == "rad" and abs(turn * factor / (2.0 * np.pi) - 1.0) < SAME:
                why = f"column {column!r} jumps by {turn:.4g}, a turn has 6.283 rad"
                return self._doubt(column, why, f"in {other}", factor)
        if np.isfinite(allowed).all():  # Shifts by whole turns into the joint's range.
            samples += turn * np.rint((np.mean(allowed) - np.nanmedian(samples)) / turn)
        text = f"the encoder begins anew after {turn:.4g} {unit}; unwrapped"
        self._repair(column, samples, text, f"{column!r} {jumps} times")
        return None

    def _position_fault(self, column: str) -> str | None:
        """Returns the reason why positions cannot be in the joint's unit, None if they can."""
        values, one, beyond = self.recording[column], self.columns[column], self.limits.beyond_range
        if fits(values, one, beyond):
            return None
        why = f"column {column!r} covers [{np.nanmin(values):.4g}, {np.nanmax(values):.4g}], joint "
        why += f"{one.element!r} allows [{one.limits[0]:.4g}, {one.limits[1]:.4g}] {one.unit}"
        found = other_unit(values, one, beyond)
        return self._doubt(column, why, *found) if found else why

    def _doubt(self, column: str, why: str, unit: str, factor: float) -> str:
        """Records a doubt about a column's unit, and returns it as a question."""
        self.doubted[column] = f"{why}; is it {unit}? {in_map(repr(column), factor)}"
        return self.doubted[column]

    def _pressure_fault(self, column: str) -> str | None:
        """Returns the reason why a pressure cannot be used, None if it can."""
        one, columns = self.columns[column], self.recording.columns
        values = columns[column]
        finite = values[np.isfinite(values)]
        if finite.size < 0.5 * values.size:
            return f"column {column!r} holds {finite.size} numbers in {values.size} rows"
        sizes, highest = np.abs(finite), np.abs(finite).max()
        if highest >= self.limits.vapour_pressure:  # one chamber may be open to the tank
            both = (columns.get(f"{one.element}_{c}", finite) for c in CHAMBERS)
            sizes = np.abs(np.concatenate([*both]))
        if found := other_unit(sizes, one):
            why = f"column {column!r} stays below {highest:.4g}, the supply of its cylinder is "
            why += f"{one.limits[1]:.4g} Pa"
            return self._doubt(column, why, f"in {found[0]}", found[1])
        position = columns.get(f"{one.element}_position", np.zeros(1))
        if np.ptp(finite) == 0.0 and np.nanmax(position) > np.nanmin(position):
            return f"column {column!r} is {finite[0]:.6g} in every row; is the sensor connected?"
        return None

    def doubts(self, recording: Recording) -> Iterator[tuple[str, str]]:
        """Yields text and place of remarks on the stamps and the columns of `recording`."""
        rounding, jitter, lost = self.clock.rounding, self.clock.jitter, self.clock.lost
        if rounding:
            yield f"stamps are rounded to {rounding:.3g} s; taken for a uniform clock's", ""
        if jitter > SAME:
            yield "stamps are uneven, resampled by them", f"{100.0 * jitter:.2g} % of a period"
        if lost:
            share = f"{100.0 * lost / (lost + len(recording)):.2g} %"
            pause = f"the longest pause {np.diff(recording.time).max():.3g} s"
            yield "rows are missing", f"{lost} ({share}), {pause}"
        for column, values in recording.columns.items():
            if missing := int((~np.isfinite(self.logged[column])).sum()):
                yield "samples without a number", f"{column!r} {missing}"
            if column.endswith("_command"):
                continue
            low, high = np.nanmin(values), np.nanmax(values)
            if low == high:
                text = "the same in every row, at rest or a sensor that is not connected"
                yield text, f"{column!r} {low:.6g}"
            # A signal that also rests as long between its extremes is not saturated.
            inside = (values[1:] != low) & (values[1:] != high)
            resting = _longest_run((np.diff(values) == 0.0) & inside)
            for limit, word in ((low, "smallest"), (high, "largest")):
                run = _longest_run(values == limit)
                if max(self.limits.saturated_samples, 2 * resting) <= run < 0.9 * values.size:
                    place = f"{column!r} {word} {limit:.6g} for {run} samples"
                    yield "an extreme value holds, is the sensor saturated?", place
        for actuator in self.machine.actuators:
            entry, column = self.machine.base.model.actuator(actuator), f"{actuator}_command"
            low, high = entry.ctrlrange.tolist()
            outside = int(((recording[column] < low) | (recording[column] > high)).sum())
            if entry.ctrllimited[0] and outside:
                place = f"{column!r} beyond [{low:g}, {high:g}] in {outside} samples"
                yield "a command leaves its range, the model clips it", place


def _longest_run(mask: np.ndarray) -> int:
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def _rates(usable: Mapping[str, _Entry], limits: Thresholds) -> tuple[str, ...]:
    """Returns notes on recordings whose sampling period differs from the common period."""
    period = common_period({name: e.recording for name, e in usable.items()}, limits)
    faster, drifting, notes = [], [], []
    for name, entry in usable.items():
        clock, off = entry.clock, entry.clock.period / period - 1.0
        if clock.clear and off < -SAME:
            faster.append(f"{name} from {1.0 / clock.period:.4g} Hz")
        elif clock.clear and abs(off) * len(entry.recording) > 1.0:
            # Clocks that differ by more than one sample over the recording are noted.
            drifting.append(f"{name} {100.0 * off:+.2g} %")
    if faster:
        text = f"averaged to {1.0 / period:.4g} Hz, the rate of the slowest recording: "
        lost = f"; their motion above {0.5 / period:.4g} Hz is lost"
        notes.append(text + ", ".join(faster) + lost)
    if drifting:
        text = f"clocks differ from a period of {period:.6g} s, resampled by their stamps: "
        notes.append(text + ", ".join(drifting))
    return tuple(notes)
