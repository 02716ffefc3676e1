"""The gate of a diagnosis: which recordings and columns can be used, and what is said of them."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from leglab.base.errors import LeglabError
from leglab.base.recording import Recording
from leglab.diagnosis.intake.remarks import Remark, merged
from leglab.diagnosis.intake.rotation import unwrapped
from leglab.diagnosis.intake.series import Clock, UniformSeries, common_period
from leglab.diagnosis.plant.model import CHAMBERS, CYLINDER, Machine
from leglab.diagnosis.thresholds import DEFAULT, Thresholds

_DEGREES = 180.0 / np.pi
_UNIT = "is it in bar?"


@dataclass(frozen=True, kw_only=True, eq=False)
class Admitted:
    """Recordings that a diagnosis can use.

    Attributes:
        recordings: By name, with the columns that the diagnosis needs and positions unwrapped.
        held_out: Names of those on which it is judged.
        notes: What was left out, repaired or doubted, each said once.
    """

    recordings: Mapping[str, Recording]
    held_out: tuple[str, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Entry:
    """One recording at the gate.

    Attributes:
        recording: Columns that the model may use, positions unwrapped.
        fault: Why it cannot be used at all; None where it can.
        pressures: Pressure columns that can be used.
        lost: Why the others cannot, by column.
        remarks: On what was done to it.
    """

    recording: Recording
    fault: str | None
    pressures: frozenset[str]
    lost: Mapping[str, str]
    remarks: tuple[Remark, ...]


def admit(
    machine: Machine,
    recordings: Mapping[str, Recording],
    held_out: Iterable[str] = (),
    thresholds: Thresholds = DEFAULT,
) -> Admitted:
    """Chooses the recordings and columns that can be used; admitting twice changes nothing.

    Columns that the model does not need are ignored, whatever they hold. A recording whose position
    or command cannot be used is left out if others remain. Pressures that some recordings lack are
    used from the others alone where those hold at least half of the recorded time, one of them to
    fit and one of them to judge; else the diagnosis goes without these pressures.

    Args:
        machine: The model.
        recordings: By name.
        held_out: Names of those on which the verdict is judged.
        thresholds: Of all steps.

    Raises:
        LeglabError: No recording can be used, or none of those that are to be held out, or to be
            fitted; names recording, column, what was found and what is allowed.
    """
    held = tuple(name for name in held_out if name in recordings)
    entries = {name: _entry(machine, name, r, thresholds) for name, r in recordings.items()}
    usable = {name: e for name, e in entries.items() if e.fault is None}
    if not usable:
        name, entry = next(iter(entries.items()))
        others = len(entries) - 1
        more = f" (and {others} more recordings cannot be used)" if others else ""
        raise LeglabError(f"{name}: {entry.fault}{more}")
    dropped = {name: str(e.fault) for name, e in entries.items() if e.fault is not None}
    _check_units(usable)
    usable, slow = _fast_enough(usable, thresholds)
    dropped |= slow
    _check_roles(usable, dropped, held)
    columns = _pressures(usable, held)
    without = {n: e for n, e in usable.items() if not columns <= e.pressures}
    usable = {n: e for n, e in usable.items() if n not in without}
    for name, entry in without.items():
        lost = next(c for c in sorted(columns) if c not in entry.pressures)
        why = entry.lost.get(lost, f"no column {lost!r}")
        dropped[name] = f"{why}, and the other recordings have all pressures"
    remarks = [Remark(text=f"left out, {why}", recording=name) for name, why in dropped.items()]
    for name, entry in usable.items():
        remarks += [*_unused(name, entry, columns), *entry.remarks]
    admitted = {
        name: e.recording.select([*machine.columns, *sorted(columns)]) for name, e in usable.items()
    }
    for name, recording in admitted.items():
        remarks += _doubts(machine, name, recording, thresholds)
    lines = merged(remarks, recordings) + clock_notes(admitted, thresholds)
    return Admitted(
        recordings=admitted,
        held_out=tuple(name for name in held if name in admitted),
        notes=lines,
    )


def _check_units(usable: Mapping[str, _Entry]) -> None:
    """Refuses pressures that no recording has in our unit: a factor would save them all."""
    for name, entry in usable.items():
        for column, why in entry.lost.items():
            if _UNIT in why and not any(column in e.pressures for e in usable.values()):
                raise LeglabError(f"{name}: {why}")


def _check_roles(usable: Mapping[str, _Entry], dropped: Mapping[str, str], held: tuple) -> None:
    """Refuses what leaves nothing to judge by, or nothing to fit."""
    if held and not set(held) & set(usable):
        raise LeglabError(
            f"{held[0]}: {dropped[held[0]]}; it was to be held out; allowed: another recording "
            "held out"
        )
    if set(usable) <= set(held):
        if not dropped:
            raise LeglabError("every recording is held out; allowed: at least one to fit")
        name, why = next(iter(dropped.items()))
        raise LeglabError(f"{name}: {why}; no recording is left to fit")


def _unused(name: str, entry: _Entry, columns: frozenset[str]) -> Iterator[Remark]:
    """Remarks on pressures that are there and not used."""
    for column, why in entry.lost.items():
        text = f"pressures are not used, {why}"
        yield Remark(text=text, recording=name, place=repr(column))
    for column in sorted(entry.pressures - columns):
        text = "pressures are not used, other recordings lack them"
        yield Remark(text=text, recording=name, place=repr(column))


def _fast_enough(
    usable: dict[str, _Entry], limits: Thresholds
) -> tuple[dict[str, _Entry], dict[str, str]]:
    """Recordings that do not slow down the others beyond use, and why the rest do.

    Where others have two samples in a bin, all have one in two bins at least.
    """
    periods = {n: Clock.of(e.recording.time, n).period for n, e in usable.items()}
    fastest = min(periods.values())
    slow = {
        name: f"sampled every {period:.4g} s only, the others every {fastest:.4g} s"
        for name, period in periods.items()
        if fastest <= 0.5 * limits.bin and period > 2.0 * limits.bin
    }
    return {n: e for n, e in usable.items() if n not in slow}, slow


def _pressures(usable: Mapping[str, _Entry], held: tuple[str, ...]) -> frozenset[str]:
    """Pressure columns to use: the more, the better, yet not at the price of most recordings."""
    total = sum(e.recording.duration for e in usable.values())
    found = frozenset.intersection(*(e.pressures for e in usable.values()))
    for columns in {e.pressures for e in usable.values()}:
        complete = {n: e for n, e in usable.items() if columns <= e.pressures}
        enough = sum(e.recording.duration for e in complete.values()) >= 0.5 * total
        to_fit = set(complete) - set(held)
        judges = set(held) & set(complete) if held else len(complete) > 1 or len(usable) == 1
        if enough and to_fit and judges and len(columns) > len(found):
            found = columns
    return found


def pressure_columns(machine: Machine) -> dict[str, str]:
    """Columns of chamber pressures that a recording may have, with their cylinders."""
    return {
        f"{machine.driven[cylinder][0]}_{chamber}": cylinder
        for cylinder in machine.instances(CYLINDER)
        for chamber in CHAMBERS
    }


def _entry(machine: Machine, name: str, recording: Recording, limits: Thresholds) -> _Entry:
    """Looks at one recording."""
    known = pressure_columns(machine)
    kept = [c for c in (*machine.columns, *known) if c in recording]
    own = recording.select(kept)
    fault = _missing(machine, recording)
    remarks: list[Remark] = []
    if fault is None:
        turned, remarks, fault = _turned(machine, name, own)
        own = own.with_columns(turned)
    for joint in machine.joints:
        fault = fault or _position_fault(machine, own, joint, limits)
    lost = {
        column: why
        for column, cylinder in known.items()
        if (why := _pressure_fault(machine, recording, column, cylinder, limits.vapour_pressure))
    }
    return _Entry(
        recording=own,
        fault=fault,
        pressures=frozenset(c for c in known if c in own and c not in lost),
        lost={c: w for c, w in lost.items() if c in recording or c in unreadable(recording)},
        remarks=tuple(remarks),
    )


def unreadable(recording: Recording) -> Mapping[str, str]:
    """Why columns of the file are not in the recording, by column."""
    found = recording.metadata.get("unreadable", {})
    return found if isinstance(found, dict) else {}


def _missing(machine: Machine, recording: Recording) -> str | None:
    """Why positions and commands are not there, None if all are."""
    absent = [column for column in machine.columns if column not in recording]
    known = unreadable(recording)
    for column in absent:
        if column in known:
            return known[column]
    if absent:
        return (
            f"no column {', '.join(map(repr, absent))}: the model needs "
            f"{', '.join(machine.columns)}; the recording has {', '.join(recording.columns)}. "
            "Measured under other names? Give a column map"
        )
    for column in machine.columns:
        count = int(np.isfinite(recording[column]).sum())
        if count < 2:
            return f"column {column!r} holds no numbers; allowed: numbers, NaN where one is missing"
    if len(recording) < 3:
        return f"{len(recording)} samples are too few to replay"
    return None


def _turned(
    machine: Machine, name: str, recording: Recording
) -> tuple[dict[str, np.ndarray], list[Remark], str | None]:
    """Positions without the jumps of their encoders, remarks on them, and a fault."""
    found, remarks = {}, []
    for joint in machine.joints:
        column, unit = f"{joint}_position", machine.unit(joint)
        hinge = unit == "rad"
        result = unwrapped(recording.time, recording[column], hinge=hinge)
        if result is None:
            continue
        if hinge and abs(result.turn / 360.0 - 1.0) < DEFAULT.same:
            why = f"column {column!r} jumps by {result.turn:.4g}, a turn has 6.283 rad"
            return {}, [], f"{why}; is it in degrees? allowed: rad"
        samples = result.samples
        allowed = _range(machine, joint)
        if allowed is not None:
            # The turn in which the joint can be.
            middle = 0.5 * (allowed[0] + allowed[1])
            samples = samples + result.turn * np.rint(
                (middle - np.nanmedian(samples)) / result.turn
            )
        found[column] = samples
        remarks.append(
            Remark(
                text=f"the encoder begins anew after {result.turn:.4g} {unit}; unwrapped",
                recording=name,
                place=f"{column!r} {result.jumps} times",
            )
        )
    return found, remarks, None


def _position_fault(
    machine: Machine, recording: Recording, joint: str, limits: Thresholds
) -> str | None:
    """Why positions cannot be in the joint's unit, None if they can."""
    column, unit = f"{joint}_position", machine.unit(joint)
    values = recording[column]
    low, high = np.nanmin(values), np.nanmax(values)
    hinge = unit == "rad"
    said = f"column {column!r} covers [{low:.4g}, {high:.4g}]"
    allowed = _range(machine, joint)
    if allowed is None:
        # A wheel may turn as far as it likes: only its speeds tell.
        if hinge and max(-low, high) > limits.far and in_degrees(machine, recording, joint):
            return (
                f"{said}, and the model's forces explain its speeds 57 times as slow; is it in "
                "degrees? allowed: rad"
            )
        return None
    lower, upper = allowed
    room = limits.beyond_range * (upper - lower)
    if low >= lower - room and high <= upper + room:
        return None
    inside = hinge and low / _DEGREES > lower - room and high / _DEGREES < upper + room
    hint = "; is it in degrees?" if inside else ""
    return f"{said}, joint {joint!r} allows [{lower:.4g}, {upper:.4g}] {unit}{hint}"


def _range(machine: Machine, joint: str) -> tuple[float, float] | None:
    """Where a joint can be, None where it has no limit. A piston has a stroke, whatever is said."""
    entry = machine.base.model.joint(joint)
    on_cylinder = any(joint in machine.driven[c] for c in machine.instances(CYLINDER))
    lower, upper = (float(x) for x in entry.range)
    if lower < upper and (machine.base.model.jnt_limited[entry.id] or on_cylinder):
        return lower, upper
    far = DEFAULT.far
    return (-far, far) if on_cylinder and machine.unit(joint) == "rad" else None


def in_degrees(machine: Machine, recording: Recording, joint: str) -> bool:
    """Whether the speeds of an unlimited hinge are clearly those of degrees.

    Changes of speed over ten places of a grid of bins are compared with the integral of the
    accelerations that the model has at the measured positions, speeds and commands. It is clear
    where, with all unlimited hinges taken for degrees, they leave less than half as much over as
    taken for radians, and less than half of the changes.
    """
    model, places = machine.base.model, 10
    period = max(DEFAULT.bin, Clock.of(recording.time).period)
    series = UniformSeries.from_recording(recording, "", machine.columns, period=period)
    count = series.time.size
    if count < 3 * places:
        return False
    data = mujoco.MjData(model)
    known = series.valid[places:] & series.valid[:-places]
    commands = np.stack([series.columns[f"{name}_command"] for name in machine.actuators], axis=1)
    left = []
    for factor in (1.0, 1.0 / _DEGREES):
        q, v = np.zeros((count, model.nq)), np.zeros((count, model.nv))
        for name in machine.joints:
            entry = model.joint(name)
            wheel = machine.unit(name) == "rad" and _range(machine, name) is None
            position = (factor if wheel else 1.0) * series.columns[f"{name}_position"]
            q[:, entry.qposadr[0]] = position
            v[:, entry.dofadr[0]] = np.gradient(position, period)
        dof, gained = int(model.joint(joint).dofadr[0]), np.empty(count)
        for k in range(count):
            data.qpos[:], data.qvel[:], data.ctrl[:] = q[k], v[k], commands[k]
            mujoco.mj_forward(model, data)
            gained[k] = period * data.qacc[dof]
        rest = v[:, dof] - np.cumsum(gained)
        changes, rests = ((x[places:] - x[:-places])[known] for x in (v[:, dof], rest))
        size = float(np.sum(changes**2))
        left.append(float(np.sqrt(np.sum(rests**2) / size)) if size > 0.0 else np.inf)
    return left[1] < 0.5 * min(left[0], 1.0)


def _pressure_fault(
    machine: Machine, recording: Recording, column: str, cylinder: str, least: float
) -> str | None:
    """Why a pressure cannot be used, None if it can."""
    if column not in recording:
        return unreadable(recording).get(column, f"no column {column!r}")
    values = recording[column]
    finite = values[np.isfinite(values)]
    if finite.size < 0.5 * values.size:
        return f"column {column!r} holds {finite.size} numbers in {values.size} rows"
    highest = float(np.abs(finite).max())
    if highest < least:
        supply = machine.parameter(cylinder, "supply_pressure")
        return (
            f"column {column!r} stays below {highest:.4g}, the supply of {cylinder!r} is "
            f"{supply:.4g} Pa; {_UNIT} allowed: Pa"
        )
    position = f"{machine.driven[cylinder][0]}_position"
    moves = position in recording and np.nanmax(recording[position]) > np.nanmin(
        recording[position]
    )
    if moves and np.ptp(finite) == 0.0:
        return f"column {column!r} is {finite[0]:.6g} in every row; is the sensor connected?"
    return None


def _doubts(
    machine: Machine, name: str, recording: Recording, limits: Thresholds
) -> Iterator[Remark]:
    """Remarks on columns that are used."""

    def remark(text: str, place: str) -> Remark:
        return Remark(text=text, recording=name, place=place)

    measured = {c: v for c, v in recording.columns.items() if not c.endswith("_command")}
    for column, values in recording.columns.items():
        known = values[np.isfinite(values)]
        if known.size < values.size:
            yield remark("samples without a number", f"{column!r} {values.size - known.size}")
        if column in measured and known.size > 1 and np.ptp(known) == 0.0:
            text = "the same in every row, at rest or a sensor that is not connected"
            yield remark(text, f"{column!r} {known[0]:.6g}")
    for actuator in machine.actuators:
        entry = machine.base.model.actuator(actuator)
        if not entry.ctrllimited[0]:
            continue
        low, high = entry.ctrlrange.tolist()
        values = recording[f"{actuator}_command"]
        outside = int(((values < low) | (values > high)).sum())
        if outside:
            place = f"'{actuator}_command' beyond [{low:g}, {high:g}] in {outside} samples"
            yield remark("a command leaves its range, the model clips it", place)
    for column, values in measured.items():
        low, high = np.nanmin(values), np.nanmax(values)
        # What rests elsewhere as long is no saturated sensor.
        inside = (values[1:] != low) & (values[1:] != high)
        resting = _longest_run((np.diff(values) == 0.0) & inside)
        for limit, word in ((low, "smallest"), (high, "largest")):
            run = _longest_run(values == limit)
            if max(limits.saturated_samples, 2 * resting) <= run < 0.9 * values.size:
                place = f"{column!r} {word} {limit:.6g} for {run} samples"
                yield remark("an extreme value holds, is the sensor saturated?", place)


def _longest_run(mask: np.ndarray) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return int((edges[1::2] - edges[::2]).max()) if edges.size else 0


def clock_notes(recordings: Mapping[str, Recording], limits: Thresholds) -> tuple[str, ...]:
    """What is done to the clocks of recordings that are not all on one uniform grid."""
    period = common_period(recordings, limits)
    clocks = {name: Clock.of(r.time, name) for name, r in recordings.items()}
    lines = []
    clear = {n: c.period for n, c in clocks.items() if c.clear}
    fast = [n for n, own in clear.items() if own < (1.0 - limits.same) * period]
    if fast:
        rates = ", ".join(f"{n} from {1.0 / clear[n]:.4g} Hz" for n in fast)
        lines.append(
            f"averaged to {1.0 / period:.4g} Hz, the rate of the slowest recording: {rates}; their "
            f"motion above {0.5 / period:.4g} Hz is lost"
        )
    # Worth a note is what comes to a sample over the recording.
    drifting = [
        f"{name} {100.0 * (own / period - 1.0):+.2g} %"
        for name, own in clear.items()
        if name not in fast and abs(own / period - 1.0) * len(recordings[name]) > 1.0
    ]
    if drifting:
        lines.append(
            f"clocks differ from a period of {period:.6g} s, resampled by their stamps: "
            + ", ".join(drifting)
        )
    remarks = []
    for name, clock in clocks.items():
        if clock.rounding:
            text = f"stamps are rounded to {clock.rounding:.3g} s; taken for a uniform clock's"
            remarks.append(Remark(text=text, recording=name))
        if clock.jitter > limits.same:
            share = f"{100.0 * clock.jitter:.2g} % of a period"
            text = "stamps are uneven, resampled by them"
            remarks.append(Remark(text=text, recording=name, place=share))
        if clock.lost:
            share = f"{100.0 * clock.lost / (clock.lost + len(recordings[name])):.2g} %"
            longest = float(np.diff(recordings[name].time).max())
            place = f"{clock.lost} ({share}), the longest pause {longest:.3g} s"
            remarks.append(Remark(text="rows are missing", recording=name, place=place))
    return (*lines, *merged(remarks, recordings))
