"""Detection of wrong units and signs of recorded signals, by replays (short simulations).

Windows are replayed with the logged signal, and with the signal times each factor of
`intake.units`. Faults are not mistaken for wrong units, because no factor near 1 is tried, and a
factor has to explain nearly all of the motion while the logged signal explains little of it.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from leglab.base.errors import RecordingError
from leglab.base.recording import Recording
from leglab.diagnosis.intake.admission import Admitted, check_roles, refuse_shared
from leglab.diagnosis.intake.remarks import Remark, merged
from leglab.diagnosis.intake.series import UniformSeries, common_period
from leglab.diagnosis.intake.units import DEGREES, OPPOSITE, command_units, in_map, position_units
from leglab.diagnosis.plant.model import Change, Machine
from leglab.diagnosis.replay.replay import Replay, at_replay_step
from leglab.diagnosis.replay.windows import channels, window_length
from leglab.diagnosis.thresholds import DEFAULT, FAR, FORCE_BLOCKS, SAME, SMALL, Thresholds

# Number of replayed windows in total, then minimum and maximum per recording. More are slow, since
# each factor needs a replay of all windows; the mean over fewer windows is not significant.
_WINDOWS, _FEWEST, _MOST = 16, 4, 8
# Gains of a weak and of a strong drive: a wrong unit must explain the motion better than these.
_GAINS = (0.3, 3.0)
# Upper limit of squared errors relative to the squared motion; diverged replays reach it.
_BLOWN = 1e8


@dataclass(frozen=True)
class Doubt:
    """Doubt about the unit or direction of columns of one recording."""

    recording: str
    columns: tuple[str, ...]  #: Columns of the recording in doubt, which share a unit
    factor: float  #: Factor on the columns with which the model fits
    unit: str  #: Unit that the factor implies, or `OPPOSITE`
    times_better: float  #: RMS replay error without the factor over the RMS error with it
    alike: tuple[str, ...] = ()  #: Columns with which the model fits as well at opposite sign

    @property
    def words(self) -> str:
        """The doubt in words, with the entry in the column map that would correct the unit."""
        times = self.times_better
        better = f"{times:.2g} times" if times < 100.0 else "more than 100 times"
        better = f"the model fits {better} better"
        names = ", ".join(map(repr, self.columns))
        if self.unit == OPPOSITE:
            other = "".join(f" (or of {column!r})" for column in self.alike)
            asked = "check which way the encoder counts and the drive turns"
            said = f"with the opposite sign of {names}{other} {better}: {asked}"
        else:
            said = f"with {names} in {self.unit} {better}: check the unit"
        return f"{said}; {in_map(names, self.factor)}"


def unquestioned(
    machine: Machine, admitted: Admitted, thresholds: Thresholds = DEFAULT
) -> Admitted:
    """Leaves out the recordings whose units or directions are in doubt.

    Raises:
        RecordingError: At least half of the recordings share a doubt, or too few remain.
    """
    found = doubts(machine, admitted.recordings, thresholds)
    asked = ((doubt.recording, (doubt.columns, doubt.unit), doubt.words) for doubt in found)
    refuse_shared(asked, len(admitted.recordings))
    dropped = {doubt.recording: doubt.words for doubt in found}
    usable = {name: r for name, r in admitted.recordings.items() if name not in dropped}
    check_roles(usable, dropped, admitted.held_out)
    remarks = [Remark(f"left out, {why}", name) for name, why in dropped.items()]
    return Admitted(
        recordings=usable,
        held_out=tuple(name for name in admitted.held_out if name in usable),
        notes=merged(remarks, admitted.recordings) + admitted.notes,
    )


def doubts(
    machine: Machine, recordings: Mapping[str, Recording], thresholds: Thresholds = DEFAULT
) -> list[Doubt]:
    """Returns the clearest doubt about units and directions of each recording.

    The recordings must have all columns of the machine. Recordings that are too short or contain no
    motion raise no doubt.
    """
    try:
        trials = _Trials(machine, recordings, thresholds)
        as_it_is = trials.errors({})
    except RecordingError:
        return []
    best: dict[str, Doubt] = {}
    candidates = list(trials.candidates(as_it_is))
    before = [as_it_is, *(trials.effects() if candidates else ())]
    for columns, unit, factor in candidates:
        try:
            errors = trials.errors(dict.fromkeys(columns, factor))
        except RecordingError:  # nothing to replay in this unit
            continue
        for recording, times in trials.clear(columns, before, errors):
            known = best.get(recording)
            said = known.times_better if known else 0.0
            same = abs(times - said) < SAME * said
            if known and known.unit == unit == OPPOSITE and same:
                best[recording] = replace(known, alike=(*known.alike, *columns))
            elif times > said:
                best[recording] = Doubt(recording, columns, factor, unit, times)
    return list(best.values())


@dataclass(frozen=True, eq=False)
class _Errors:
    """Mean squares over the bins of replayed windows, each (windows, joints)."""

    recording: np.ndarray  #: Index of each window's recording, (windows,)
    left: np.ndarray  #: Mean square of measured minus predicted positions
    bent: np.ndarray  #: Mean square of measured motion minus a straight line in time
    moved: np.ndarray  #: Mean square of the measured motion relative to its start

    def shares(self, squares: np.ndarray, rows: tuple[np.ndarray, ...]) -> np.ndarray:
        """Divides squares by the joint's sum of `bent` and adds them over joints, (windows,)."""
        size = np.maximum(self.bent[rows].sum(axis=0), 1e-300)
        return np.minimum(squares[rows] / size, _BLOWN).sum(axis=1)


def _times(factor: float, samples: np.ndarray, period: float) -> np.ndarray:
    """Multiplies commands by a factor; it has the signature of a command path."""
    return factor * samples


class _Trials:
    """Replays of each recording's segment with most motion, with trial factors on its signals."""

    def __init__(
        self, machine: Machine, recordings: Mapping[str, Recording], limits: Thresholds
    ) -> None:
        self.recordings = recordings
        #: Joints that each column measures or moves.
        self.joints = {f"{joint}_position": (joint,) for joint in machine.joints}
        self.joints |= {f"{a}_command": machine.driven[a] for a in machine.actuators}
        # Two samples per bin suffice to find a unit, in a fifth of the time that ten would take.
        period = max(common_period(recordings, limits), 0.5 * limits.bin)
        self.machine = at_replay_step(machine, period)
        shared = set.intersection(*(set(r.columns) for r in recordings.values()))
        # For accelerations by commands, one pose per block (fifth) of a window is enough.
        every = max(1, round(limits.window / FORCE_BLOCKS / period))
        limits = replace(limits, pose_every=every)
        windows = int(np.clip(_WINDOWS // len(recordings), _FEWEST, _MOST))
        length = (windows + 2) * window_length(period, limits)[0]
        self.series = [
            _liveliest(
                UniformSeries.from_recording(r, name, tuple(shared), limits, period=period),
                [f"{joint}_position" for joint in machine.joints],
                length,
            )
            for name, r in recordings.items()
        ]
        grids = {s.name: Recording(time=s.time, columns=s.columns) for s in self.series}
        self.channels = channels(machine, grids, limits)
        self.limits = limits
        self._as_logged = self._replay({})

    def _replay(self, factors: Mapping[str, float]) -> Replay:
        scaled = [
            replace(s, columns={c: factors.get(c, 1.0) * x for c, x in s.columns.items()})
            for s in self.series
        ]
        return Replay(self.machine, scaled, self.channels, self.limits, threads=1)

    def errors(self, factors: Mapping[str, float]) -> _Errors:
        """Computes the errors of a replay in which some columns are multiplied by `factors`."""
        change, replay = Change(self.machine), self._as_logged
        for actuator in self.machine.actuators:
            if (factor := factors.get(f"{actuator}_command", 1.0)) != 1.0:
                change.command(actuator, partial(_times, factor))
        positions = {c: f for c, f in factors.items() if not c.endswith("_command")}
        if positions:  # Positions determine window starts and contacts.
            replay = self._replay(positions)
        joints = len(self.machine.joints)  # channels of positions come first
        errors = replay.error(change).values[:, :joints]
        # The mean error over windows comes from a constant force, not from a wrong unit.
        for number in range(len(self.series)):
            own = replay.recording == number
            errors[own] -= errors[own].mean(axis=0) if own.any() else 0.0
        measured = replay.measured()[:, :joints]
        moved = measured[:, :, 1:].reshape((*errors.shape, -1)).mean(axis=3) - measured[:, :, :1]
        place = np.linspace(-1.0, 1.0, replay.bins)
        line = (moved @ place / (place @ place))[:, :, None] * place
        bent = ((moved - moved.mean(axis=2, keepdims=True) - line) ** 2).mean(axis=2)
        left, moved = (errors**2).mean(axis=2), (moved**2).mean(axis=2)
        return _Errors(replay.recording, left, bent, moved)

    def effects(self) -> Iterator[_Errors]:
        """Yields the errors with weak and strong drives, which are faults but not wrong units."""
        commands = [column for column in self.joints if column.endswith("_command")]
        for group in dict.fromkeys([*((column,) for column in commands), tuple(commands)]):
            for gain in _GAINS:
                yield self.errors(dict.fromkeys(group, gain))

    def candidates(self, as_it_is: _Errors) -> Iterator[tuple[tuple[str, ...], str, float]]:
        """Yields columns, units and factors to try for joints whose motion is not explained.

        In most logs all hinge angles, or all commands, have one unit, so groups are tried as well.
        If angles and commands of position servos are both in degrees, errors hardly show it, so
        degrees are tried whenever a hinge turns farther than most hinges can.
        """
        # A joint's motion is unexplained if its RMS error exceeds half that of a line in time.
        unexplained = as_it_is.left.sum(axis=0) > 0.25 * as_it_is.bent.sum(axis=0)
        poor = {j for j, bad in zip(self.machine.joints, unexplained, strict=True) if bad}
        groups: dict[tuple[str, str, float], list[str]] = {}
        for column, joints in self.joints.items():
            _, _, kind = column.rpartition("_")
            for unit, factor in {OPPOSITE: -1.0, **self._units(column)}.items():
                groups.setdefault((kind, unit, factor), []).append(column)
                if poor.intersection(joints):
                    yield (column,), unit, factor
        angles, goals = (groups.get((kind, *DEGREES), []) for kind in ("position", "command"))
        turned = max(
            (float(np.abs(s.columns[c]).max()) for s in self.series for c in angles), default=0.0
        )
        if goals and turned > FAR:
            yield (*angles, *goals), *DEGREES
        for (_, unit, factor), columns in groups.items():
            if poor and len(columns) > 1 and factor != -1.0:
                yield tuple(columns), unit, factor

    def _units(self, column: str) -> dict[str, float]:
        """Returns the factors to try on a column, by unit."""
        hinge = all(self.machine.unit(joint) == "rad" for joint in self.joints[column])
        if column.endswith("_position"):
            found = (position_units(r[column], hinge=hinge) for r in self.recordings.values())
            return {unit: factor for units in found for unit, factor in units.items()}
        entry = self.machine.base.model.actuator(column.removesuffix("_command"))
        return command_units(angle=hinge and float(entry.biasprm[1]) != 0.0)

    def clear(
        self, columns: tuple[str, ...], before: list[_Errors], after: _Errors
    ) -> Iterator[tuple[str, float]]:
        """Yields recordings whose errors a factor clearly reduces, and the ratio of the errors."""
        if any(errors.recording.shape != after.recording.shape for errors in before):
            return
        own = {self.machine.joints.index(j) for column in columns for j in self.joints[column]}
        for number, name in enumerate(self.recordings):
            rows = np.ix_(after.recording == number, sorted(own))
            as_it_is, *others = (errors.shares(errors.left, rows) for errors in before)
            left = min((as_it_is, *others), key=lambda x: float(x.sum()))
            least, moved = (after.shares(x, rows) for x in (after.left, after.moved))
            most = SMALL * min(left.sum(), moved.sum())
            if not left.size or not least.sum() < most:
                continue
            # The mean logarithmic gain must be significant relative to its scatter over windows.
            gain = np.log(np.maximum(left, 1e-300) / np.maximum(least, 1e-300))
            if gain.mean() > self.limits.beyond_chance * gain.std() / np.sqrt(gain.size):
                yield name, float(np.sqrt(as_it_is.sum() / least.sum()))


def _liveliest(series: UniformSeries, columns: list[str], length: int) -> UniformSeries:
    """Returns the segment of a series, `length` samples long, in which the columns move most."""
    count = series.time.size
    if count <= length:
        return series
    firsts = np.arange(0, count - length + 1, max(1, length // 4))
    lively = np.zeros(firsts.size)
    for column in columns:
        steps = np.abs(np.diff(series.columns[column], prepend=series.columns[column][0]))
        path = np.concatenate([[0.0], np.cumsum(steps * series.valid)])
        lively += (path[firsts + length] - path[firsts]) / (path[-1] or 1.0)
    first = int(firsts[np.argmax(lively)])
    part = slice(first, first + length)
    own = {name: samples[part] for name, samples in series.columns.items()}
    return replace(series, time=series.time[part], columns=own, valid=series.valid[part])
