"""Notices changes of a machine while a controller learns, and names them by a bank of faults.

It sees the samples that the learner takes and nothing else. A change is noticed by a cumulative sum
of the learner's own error (Page 1954, Biometrika 41, 100). From its onset on, samples are summed
up, and at growing intervals every fault of the bank is fitted to them, its size by least squares
along its curve. What fits best, by enough, is the name; its shift goes to the parameters at once,
and later samples may revise it. What nothing explains is an unknown change.

The arithmetic of samples and fits is C++ (`csrc/monitor`, which also suits a microcontroller); what
is said, and what stands, is decided here.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from leglab._native.monitor import Moments, Monitor
from leglab.base.errors import LeglabError
from leglab.base.settings import Configuration
from leglab.control.feedforward.fault_bank import (
    ALL,
    DISCREPANCY,
    UNKNOWN,
    FaultBank,
    FaultCurve,
    explained_share,
)
from leglab.control.feedforward.standing import MOST_STANDING, Standing, Standings

# Times after an onset at which the bank is asked [s]: often at first, as the evidence grows. The
# case is closed at the last one, or once a name has stood for `_STEADY` [s]: the machine may change
# again.
_EARLY = (0.09, 0.12, 0.15, 0.18, 0.22, 0.26, 0.3, 0.36, 0.43, 0.5, 0.6, 0.72, 0.86, 1.0)
_LOOKS = (*_EARLY, 1.2, 1.4, 1.7, 2.0, 2.4, 2.8, 3.2)

_STEADY = 2.0

# From when to when after an onset an explanation may become less good, as more is seen, and the
# evidence for it and for its name less [s].
_GROWN, _PROVEN = (0.1, 0.4), (0.1, 0.6)

# Samples right after an onset do not count: valves and oil pass over to their new state [s].
_PASSING = 0.06

# Blocks that are kept to look back at, from an alarm on.
_BLOCKS = 25

# Mean square error of a joint, over the normal one, from which on the change concerns it [1].
_HIT = 2.0

# Mean square error of the map before the change, over what it was, from which on a change that
# nothing explains is told [1], how long after its onset, and over what time [s].
_UNEXPLAINED, _PATIENCE, _RECENT = 10.0, 1.3, 0.65

# Faults within this factor of the most probable one are told with it, at most so many in all: what
# the samples do not tell apart is not told by one name.
_ALIKE, _TOLD = 4.0, 3

# So many faults are proposed at a look: each is a map that learns.
_CONTENDERS = 3

# What comes later corrects nothing: the learner has found its own way by then [s].
_LATE = 1.0


_Share = Annotated[float, Field(gt=0, lt=1)]
_Evidence = Annotated[float, Field(ge=0)]


class MonitorConfiguration(Configuration):
    """How changes are noticed and named.

    Attributes:
        block: Learned samples from one look at them to the next.
        warm_up: Learned samples before the first alarm; after a closed case `slow_window`.
        slow_window: Learned samples in the mean square error that is normal.
        error_ratio: Rise of the mean square error that the cumulative sum tests for.
        alarm: Cumulative log-likelihood ratio at which a change is declared, beyond what it
            reaches while nothing changes.
        correlation: Learned samples that count as one: neighbours err alike.
        independent: Errors that differ independently between the nominal machine and the one that
            runs, in the odds of two faults that both leave something.
        discrepancy: Share of the error before the correction that a right fault leaves, since no
            machine is the nominal one; a standard deviation.
        explained: Least share of the weighted squared error beyond noise that a fault must take
            away to be named, of the share that it takes away on the nominal machine: a tenth of a
            second after the onset, and from four tenths on.
        kept: Least share with which a name stays, likewise.
        evidence: Least log-likelihood ratio of a fault to no change with which its map is proposed.
        proof: The same with which it is named: a tenth of a second after the onset, and from six
            tenths on. What a machine has never done before may look like a fault at first; a
            map that explains it does no harm, a name would be false.
        confidence: Least probability among all faults of the bank of what is named: of one fault,
            or of some that the samples do not tell apart.
        open_share: Gain of the learner after a fault was named, as a share of its gain on a change
            times the share of the squared error that the fault leaves.
    """

    block: int = Field(default=5, ge=1, le=50)
    warm_up: int = Field(default=1900, ge=1)
    slow_window: int = Field(default=600, ge=10)
    error_ratio: float = Field(default=4.0, gt=1)
    alarm: float = Field(default=4.0, gt=0)
    correlation: float = Field(default=20.0, ge=1)
    independent: float = Field(default=12.0, gt=0)
    discrepancy: float = Field(default=DISCREPANCY, gt=0, lt=1)
    explained: tuple[_Share, _Share] = Field(default=(0.8, 0.6))
    kept: float = Field(default=0.5, gt=0, lt=1)
    evidence: _Evidence = 8.0
    proof: tuple[_Evidence, _Evidence] = Field(default=(60.0, 8.0))
    confidence: float = Field(default=0.5, gt=0, lt=1)
    open_share: float = Field(default=0.1, ge=0, le=1)


class Rival(NamedTuple):
    """A fault that may be the one in place of what is named.

    Attributes:
        fault: Its name.
        element: Joint, or "all".
        size: In the fault's own unit.
        confidence: Its probability among all of the bank [1].
    """

    fault: str
    element: str
    size: float
    confidence: float


@dataclass(frozen=True, kw_only=True)
class Name:
    """Name of a change, as the monitor gives it at one time.

    Attributes:
        time: When it says so [s].
        onset: When the change began [s].
        fault: Name of the fault, or "unknown change".
        element: Joint whose cylinder or spring has it, or "all"; joints by commas where unknown.
        size: In the fault's own unit; None where unknown.
        low: Lower end of the size's 90 % interval.
        high: Upper end.
        meaning: What the size says, with its unit.
        confidence: Probability of fault and element among all of the bank [1]; of an unknown
            change, the share of the squared error that the best fault of the bank leaves.
        explained: Share of the weighted squared error since the onset, beyond noise, that it takes
            away [1]; of an unknown change, what the best fault would.
        undoes: Onset of the change that this one takes back, all or in part [s]; None of a new one.
        rivals: Faults that are hardly less probable, the most probable first.
    """

    time: float
    onset: float
    fault: str
    element: str
    size: float | None = None
    low: float | None = None
    high: float | None = None
    meaning: str = ""
    confidence: float
    explained: float
    undoes: float | None = None
    rivals: tuple[Rival, ...] = ()


@dataclass(kw_only=True, eq=False)
class Event:
    """A change and what was said of it.

    Attributes:
        names: In the order in which they were said; a name follows where fault or element differ
            from the last one's, and the last one is kept up to date.
        withdrawn: When the last name was taken back [s]; None if it stands.
    """

    names: list[Name] = field(default_factory=list)
    withdrawn: float | None = None


class Proposal(NamedTuple):
    """A map that a change may have led to.

    Attributes:
        key: Fault and element.
        parameters: Of the map, (joints, parameters).
        gain: Gain to be opened, as a share of the one on a change, (joints,); NaN leaves it.
        odds: Of this map against one that learns without knowing of the fault: how probable the
            fault is among all, over the share of the squared error that it leaves.
    """

    key: tuple[str, str]
    parameters: np.ndarray
    gain: np.ndarray
    odds: float


@dataclass(eq=False, kw_only=True)
class _Case:
    """An open case: a change whose samples are being collected."""

    onset: float
    base: np.ndarray
    bank: FaultBank
    look: int = 0
    # Times of looks, and until then squared errors of the map before the change and samples, each
    # (joints,).
    errors: list[tuple[float, np.ndarray, np.ndarray]] = field(default_factory=list)
    size: float = 0.0
    key: tuple[str, str] | None = None
    event: Event | None = None


class FaultMonitor:
    """Detects and names changes from the samples of a learner.

    Args:
        bank: Of the nominal machine.
        joints: Their names.
        config: How changes are noticed and named.
        sample_period: From one learned sample to the next [s].

    Attributes:
        events: What was said since `reset`.
        report: By name, each (joints,): `fault` (1 + its number in the bank, -1 for an unknown
            change, 0 for none), `fault_size` and `fault_confidence`; of the joints that it
            concerns. The arrays change with the next block.

    Raises:
        LeglabError: The bank is of another number of joints.
    """

    def __init__(
        self,
        bank: FaultBank,
        joints: tuple[str, ...],
        config: MonitorConfiguration,
        *,
        sample_period: float,
    ) -> None:
        had = bank.curves[0].shifts.shape[1]
        if had != len(joints):
            raise LeglabError(
                f"the bank of faults is of {had} joints, the machine has {len(joints)}"
            )
        self._bank, self._joints, self._config = bank, joints, config
        self._standings = Standings(bank)
        self._core = Monitor(
            len(joints),
            bank.curves[0].shifts.shape[2],
            {
                **config.model_dump(),
                "sample_period": sample_period,
                "passing": _PASSING,
                "blocks": _BLOCKS,
                "most_samples": 2 * config.block,
                "most_curves": len(bank.curves) + MOST_STANDING,
                "most_keys": len(bank.keys) + MOST_STANDING,
            },
        )
        kinds = ("fault", "fault_size", "fault_confidence")
        self.report = {name: np.zeros(len(joints)) for name in kinds}
        self.reset()

    def reset(self) -> None:
        """Forgets everything."""
        self.events: list[Event] = []
        self._core.reset(self._config.warm_up)
        self._case: _Case | None = None
        self._standings.clear()
        for values in self.report.values():
            values[:] = 0.0

    @property
    def busy(self) -> bool:
        """Whether a change was noticed whose samples are being collected."""
        return self._case is not None

    @property
    def before(self) -> np.ndarray:
        """The map before the change whose samples are being collected, (joints, parameters)."""
        if self._case is None:
            raise ValueError("no change was noticed")
        return self._case.base

    def take(
        self, time: float, samples: np.ndarray, parameters: np.ndarray
    ) -> list[Proposal] | None:
        """Takes a block of learned samples.

        Args:
            time: Of the last one [s].
            samples: As `AdaptiveFeedforward.kept`, (n, joints, parameters + 3); at most twice
                `block`.
            parameters: Of the map that learns without knowing of a fault, (joints, parameters).

        Returns:
            Maps that the change may have led to, by what is known now; None where nothing new is.

        Raises:
            ValueError: Arrays have other shapes.
        """
        opens = self._core.take(time, samples, parameters)
        self._core.sum()
        if opens:
            base = self._core.base()
            bank = self._standings.bank(base, self._core.regressors_before())
            self._case = _Case(onset=self._core.onset, base=base, bank=bank)
        case = self._case
        if case is None:
            return None
        named = case.event and case.event.withdrawn is None and case.event.names[-1].time
        if not opens and (case.look >= len(_LOOKS) or (named and time > named + _STEADY)):
            self._close(case)
            self._case = None
            self._core.close(self._config.slow_window)
            if case.event is None or case.event.withdrawn is not None:
                self._tell(None)
            return None
        if time < case.onset + _LOOKS[case.look]:
            return None
        while case.look < len(_LOOKS) and time >= case.onset + _LOOKS[case.look]:
            case.look += 1
        return self._decide(case, time)

    def _close(self, case: _Case) -> None:
        """Remembers what was told last, for a machine that is changed again."""
        if case.event is None or case.event.withdrawn is not None:
            return
        name = case.event.names[-1]
        if name.undoes is not None:
            self._standings.undo(name.undoes, case.size)
            return
        change = Standing(
            onset=name.onset,
            fault=name.fault,
            element=name.element,
            meaning=name.meaning,
            size=1.0 if name.size is None else name.size,
            before=case.base,
        )
        self._standings.add(change)

    def _decide(self, case: _Case, time: float) -> list[Proposal]:
        """Asks the bank, says what stands out, and proposes what may be."""
        config, bank = self._config, case.bank
        self._core.begin_look(bank.core)
        self._core.look()
        without, noise, sizes, spreads, costs, chances = self._core.finding()
        moments = self._core.seen()
        case.errors.append((time, moments.power, moments.count))
        best = int(np.argmin(costs))
        age = time - case.onset
        key, curve = bank.keys[bank.group[best]], bank.curves[best]
        explained = explained_share(costs[best], without, noise)
        evidence = (without - costs[best]) / (2 * config.correlation)
        share = config.kept if key == case.key else np.interp(age, _GROWN, config.explained)
        alike = [k for k in np.argsort(-chances) if _ALIKE * chances[k] > chances.max()]
        if (
            explained >= share * curve.explains
            and len(alike) <= _TOLD
            and chances[alike].sum() >= config.confidence
            and evidence >= np.interp(age, _PROVEN, config.proof)
        ):
            case.key, case.size = key, float(sizes[best])
            chance = float(chances[bank.group[best]])
            rivals = []
            for other in alike[1:]:
                curves = np.flatnonzero(bank.group == other)
                size = float(sizes[curves[np.argmin(costs[curves])]])
                fault, element = bank.keys[other]
                rivals.append(Rival(fault, element, size, float(chances[other])))
            spread = float(spreads[best])
            self._name(case, time, curve, case.size, spread, chance, explained, tuple(rivals))
        elif case.key is not None and explained < config.kept * curve.explains:
            self._withdraw(case, time)
        elif case.key is None and time >= case.onset + _PATIENCE:
            joints = self._still_off(case, time)
            if joints.any():
                self._unknown(case, time, joints, explained)
        if age > _LATE:
            return []
        return self._proposals(case, moments, sizes, costs, chances, without, noise)

    def _proposals(
        self,
        case: _Case,
        moments: Moments,
        sizes: np.ndarray,
        costs: np.ndarray,
        chances: np.ndarray,
        without: float,
        noise: float,
    ) -> list[Proposal]:
        """The most likely faults, each as the map that it makes."""
        config, bank = self._config, case.bank
        hit = moments.power / np.maximum(moments.count, 1.0) > _HIT * self._core.normal()
        found: list[Proposal] = []
        for key in np.argsort(-chances)[:_CONTENDERS]:
            curves = np.flatnonzero(bank.group == key)
            curve = int(curves[np.argmin(costs[curves])])
            evidence = (without - costs[curve]) / (2 * config.correlation)
            left = 1.0 - explained_share(costs[curve], without, noise)
            odds = float(chances[key]) / max(left, config.discrepancy**2)
            if evidence < config.evidence or odds < 1.0:
                continue
            shift = bank.curves[curve].shift(float(sizes[curve]))
            rest = moments.about(shift).power / np.maximum(moments.power, 1e-300)
            gain = np.where(hit, config.open_share * np.minimum(rest, 1.0), np.nan)
            found.append(Proposal(bank.keys[key], case.base + shift, gain, odds))
        return found

    def _still_off(self, case: _Case, time: float) -> np.ndarray:
        """Joints of which the map before the change predicts badly now, (joints,).

        A motion never made before may err for a moment, a changed machine does so for good.
        """
        _, power, count = case.errors[-1]
        earlier = [look for look in case.errors if look[0] <= time - _RECENT]
        if earlier:
            power, count = power - earlier[-1][1], count - earlier[-1][2]
        return power / np.maximum(count, 1.0) > _UNEXPLAINED * self._core.normal()

    def _withdraw(self, case: _Case, time: float) -> None:
        case.key = None
        if case.event is not None:
            case.event.withdrawn = time
        self._tell(None)

    def _name(
        self,
        case: _Case,
        time: float,
        curve: FaultCurve,
        size: float,
        spread: float,
        chance: float,
        explained: float,
        rivals: tuple[Rival, ...],
    ) -> None:
        config = self._config
        # Samples scatter, and a machine is not the nominal one: its size is off by as much.
        sampled = math.sqrt(config.correlation) * spread
        differs = config.discrepancy * abs(size - curve.sizes[0])
        half = 1.645 * math.hypot(sampled, differs)
        ends = float(np.min(curve.sizes)), float(np.max(curve.sizes))
        sized: dict[str, Any] = {
            "size": size,
            "low": max(size - half, ends[0]),
            "high": min(size + half, ends[1]),
            "meaning": curve.meaning,
        }
        self._say(
            case,
            Name(
                time=time,
                onset=case.onset,
                fault=curve.fault,
                element=curve.element,
                confidence=chance,
                explained=explained,
                undoes=curve.undoes,
                rivals=rivals,
                **(sized if curve.fault != UNKNOWN else {}),
            ),
        )

    def _unknown(self, case: _Case, time: float, joints: np.ndarray, explained: float) -> None:
        if case.event and case.event.withdrawn is None:
            return  # it is said already
        names = ",".join(name for name, hit in zip(self._joints, joints, strict=True) if hit)
        element = ALL if joints.all() and len(joints) > 1 else names
        self._say(
            case,
            Name(
                time=time,
                onset=case.onset,
                fault=UNKNOWN,
                element=element,
                confidence=1.0 - explained,
                explained=explained,
            ),
        )

    def _say(self, case: _Case, name: Name) -> None:
        if case.event is None:
            case.event = Event()
            self.events.append(case.event)
        names = case.event.names
        again = names and (names[-1].fault, names[-1].element) == (name.fault, name.element)
        if again and case.event.withdrawn is None:
            first = names[-1]
            names[-1] = Name(**{**vars(name), "time": first.time})
        else:
            names.append(name)
        case.event.withdrawn = None
        self._tell(name)

    def _tell(self, name: Name | None) -> None:
        """Fills the report."""
        for values in self.report.values():
            values[:] = 0.0
        if name is None or (name.fault == UNKNOWN and name.undoes is not None):
            return
        faults, own = self._bank.faults, name.element.split(",")
        number = -1.0 if name.fault == UNKNOWN else 1.0 + faults.index(name.fault)
        hit = [name.element == ALL or joint in own for joint in self._joints]
        for key, value in zip(
            ("fault", "fault_size", "fault_confidence"),
            (number, name.size or 0.0, name.confidence),
            strict=True,
        ):
            self.report[key][hit] = value


def plain(events: Sequence[Event]) -> list[dict[str, Any]]:
    """Events as plain Python types."""
    return [
        {
            "names": [
                {**vars(name), "rivals": [rival._asdict() for rival in name.rivals]}
                for name in event.names
            ],
            "withdrawn": event.withdrawn,
        }
        for event in events
    ]
