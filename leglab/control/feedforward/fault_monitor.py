"""Fault monitor: detects changes of a machine while a controller learns, and names the fault.

Its only input is the learner's samples. A cumulative sum of the prediction error (Page 1954,
Biometrika 41, 100) detects a change and its onset. At growing intervals after the onset, the size
(magnitude) of every fault of the bank is fitted by least squares to the samples since the onset.
The best fault is named if its fit is clear enough; a change that no fault explains is "unknown".
Maps with the likeliest faults' shifts are proposed to the controller. Later fits may revise both.

Sums and fits are C++ (`csrc/monitor`, which also suits a microcontroller); this module decides
which names are reported and which changes persist.
"""

import math
from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from leglab._native.monitor import Moments, Monitor
from leglab.base.errors import ModelError
from leglab.causes.fault_names import UNKNOWN, FaultEvent, FaultName
from leglab.control.feedforward.fault_bank import FaultBank
from leglab.control.feedforward.judge import Explanation, JudgeConfiguration, judge, report, say
from leglab.control.feedforward.standing import Standings
from leglab.control.feedforward.thresholds import (
    BLOCKS,
    CHANGED,
    CONTENDERS,
    GROWN,
    LATE,
    LOOKS,
    PASSING,
    PATIENCE,
    PROVEN,
    RECENT,
    STEADY,
    UNEXPLAINED,
)

_Share = Annotated[float, Field(gt=0, lt=1)]
_Evidence = Annotated[float, Field(ge=0)]


class MonitorConfiguration(JudgeConfiguration):
    """How changes are noticed and named.

    Attributes:
        block: Learned samples from one look at them to the next.
        warm_up: Learned samples before the first alarm, of a reference of period 1.2 s: of another
            one in proportion; after a closed case `slow_window`.
        slow_window: Learned samples in the mean square error that is normal, likewise.
        error_ratio: Rise of the mean square error that the cumulative sum tests for.
        alarm: Cumulative log-likelihood ratio at which a change is declared, beyond what it
            reaches while nothing changes.
        explained: Least share of the weighted squared error beyond noise that a fault must take
            away to be named, of the share that it takes away on the nominal machine: a tenth of a
            second after the onset, and from four tenths on.
        kept: Least share with which a name stays, likewise.
        evidence: Least log-likelihood ratio of a fault to no change with which its map is proposed.
        proof: The same with which it is named: a tenth of a second after the onset, and from six
            tenths on. What a machine has never done before may look like a fault at first; a
            map that explains it does no harm, a name would be false.
        open_share: Gain of the learner after a fault was named, as a share of its gain on a change
            times the share of the squared error that the fault leaves.
    """

    block: int = Field(default=5, ge=1, le=50)
    warm_up: int = Field(default=1900, ge=1)
    slow_window: int = Field(default=600, ge=10)
    error_ratio: float = Field(default=4.0, gt=1)
    alarm: float = Field(default=4.0, gt=0)
    explained: tuple[_Share, _Share] = Field(default=(0.8, 0.6))
    kept: float = Field(default=0.5, gt=0, lt=1)
    evidence: _Evidence = 8.0
    proof: tuple[_Evidence, _Evidence] = Field(default=(60.0, 8.0))
    open_share: float = Field(default=0.1, ge=0, le=1)


class ProposedMap(NamedTuple):
    """Candidate map after a change.

    Attributes:
        key: Fault and element.
        parameters: Parameters of the map, (joints, parameters).
        gain: New gain of the learner divided by `change_gain`, (joints,); NaN keeps its gain.
        odds: Prior odds of this map against the map that learns without a fault: the probability
            of the fault among all faults of the bank. They do not depend on the map's prediction
            error, because the controller compares the errors of the maps afterwards.
        valves: Change of the valve state by the fault, (joints, 5); None if the fault changes
            anything but valves.
    """

    key: tuple[str, str]
    parameters: np.ndarray
    gain: np.ndarray
    odds: float
    valves: np.ndarray | None


@dataclass(eq=False, kw_only=True)
class _Case:
    """A detected change under examination: its samples are collected and evaluated."""

    onset: float
    base: np.ndarray
    bank: FaultBank
    look: int = 0
    # For each evaluation ("look"): its time; the sum since the onset of squared errors of the map
    # before the change, (joints,); the number of samples since the onset, (joints,).
    errors: list[tuple[float, np.ndarray, np.ndarray]] = field(default_factory=list)
    size: float = 0.0
    key: tuple[str, str] | None = None
    event: FaultEvent | None = None

    @property
    def name(self) -> FaultName | None:
        """Last reported name of the change; None before the first report and after a withdrawal."""
        if self.event is None or self.event.withdrawn is not None:
            return None
        return self.event.names[-1]


class FaultMonitor:
    """Detects and names changes from the samples of a learner.

    Args:
        bank: Bank of the nominal machine.
        joints: Names of the joints.
        config: How changes are detected and named.
        sample_period: Time from one learned sample to the next [s].
        pace: Period of the reference over `STRIDE`; time constants are scaled by it.

    Attributes:
        events: Changes reported since `reset`.
        report: By name, each (joints,): `fault` (1 + its index in the bank, -1 for an unknown
            change, 0 for none), `fault_size` and `fault_confidence`; zero at joints without the
            fault. The next block of samples overwrites the arrays.

    Raises:
        LeglabError: The bank is made for another number of joints.
    """

    def __init__(
        self,
        bank: FaultBank,
        joints: tuple[str, ...],
        config: MonitorConfiguration,
        *,
        sample_period: float,
        pace: float = 1.0,
    ) -> None:
        had = bank.curves[0].shifts.shape[1]
        if had != len(joints):
            text = f"the bank of faults is of {had} joints, the machine has "
            raise ModelError(text, given=had, allowed=str(len(joints)))
        self._bank, self._joints, self._config = bank, joints, config
        self._standings, self._pace = Standings(bank), pace
        self._looks = tuple(pace * look for look in LOOKS if pace * look > PASSING)
        self._warm_up, self._slow_window = (
            round(pace * samples) for samples in (config.warm_up, config.slow_window)
        )
        self._core = Monitor(
            len(joints),
            bank.curves[0].shifts.shape[2],
            {
                **config.model_dump(),
                "slow_window": self._slow_window,
                "sample_period": sample_period,
                "passing": PASSING,
                "blocks": math.ceil(pace * BLOCKS),
                "most_samples": 2 * config.block,
            },
        )
        kinds = ("fault", "fault_size", "fault_confidence")
        self.report = {name: np.zeros(len(joints)) for name in kinds}
        self.reset()

    def reset(self) -> None:
        """Forgets everything."""
        self.events: list[FaultEvent] = []
        self._core.reset(self._warm_up)
        self._case: _Case | None = None
        self._absorbed: np.ndarray = np.zeros(1)  # parameter shift that `absorb` has recorded
        self._standings.clear()
        self._tell(None)

    @property
    def busy(self) -> bool:
        """True while the samples of a detected change are being collected."""
        return self._case is not None

    @property
    def before(self) -> np.ndarray:
        """The map before the change whose samples are being collected, (joints, parameters)."""
        if self._case is None:
            raise ValueError("no change was noticed")
        return self._case.base

    def take(
        self, time: float, samples: np.ndarray, parameters: np.ndarray
    ) -> list[ProposedMap] | None:
        """Takes a block of learned samples.

        Args:
            time: Time of the last sample [s].
            samples: As `AdaptiveFeedforward.kept`, (n, joints, parameters + 3); at most twice
                `block`.
            parameters: Parameters of the map that learns without a fault, (joints, parameters).

        Returns:
            Candidate maps by a new fit of the bank; None if no fit is due after this block.

        Raises:
            ValueError: Arrays have other shapes.
        """
        opens = self._core.take(time, samples, parameters)
        self._core.sum()
        if opens:
            base = self._core.base()
            bank = self._standings.bank(base + self._absorbed, self._core.regressors_before())
            self._case = _Case(onset=self._core.onset, base=base, bank=bank)
        case = self._case
        if case is None:
            return None
        steady = self._pace * STEADY
        done = case.look >= len(self._looks) or (case.name and time > case.name.time + steady)
        if not opens and done:
            self._close(case)
            return None
        if time < case.onset + self._looks[case.look]:
            return None
        while case.look < len(self._looks) and time >= case.onset + self._looks[case.look]:
            case.look += 1
        return self._decide(case, time)

    def absorb(self, shift: np.ndarray) -> None:
        """Records a parameter shift whose effect a new valve state has taken over."""
        self._absorbed = self._absorbed + shift

    def _close(self, case: _Case) -> None:
        """Ends the examination of a change; later banks start from a machine with this fault."""
        self._case = None
        self._core.close(self._slow_window)
        name = case.name
        if name is None:
            self._tell(None)
        elif name.undoes is not None:
            self._standings.undo(name.undoes, case.size)
        else:
            self._standings.add(name, case.base + self._absorbed)

    def _decide(self, case: _Case, time: float) -> list[ProposedMap]:
        """Fits the bank, reports the best fault if clear enough, and returns candidate maps."""
        # Time since the onset [s], scaled to a reference of period `STRIDE`.
        config, age = self._config, (time - case.onset) / self._pace
        moments = self._core.look()
        fit = case.bank.fit(moments, self._core.normal(), config.discrepancy)
        judged = judge(case.bank, [fit], config)
        case.errors.append((time, moments.power, moments.count))
        share = config.kept if judged.key == case.key else np.interp(age, GROWN, config.explained)
        if judged.enough(share, np.interp(age, PROVEN, config.proof)) and judged.certain:
            case.key, case.size = judged.key, float(judged.fit.size[judged.best])
            back = judged.curve.undoes
            self._say(case, FaultName(time=time, onset=case.onset, undoes=back, **judged.told()))
        elif case.key is not None:
            if judged.explained[judged.best] < config.kept * judged.curve.explains:
                self._withdraw(case, time)
        elif age >= PATIENCE and case.name is None:
            joints = self._still_off(case, time)
            if joints.any():
                unknown = judged.unknown(self._joints, joints)
                self._say(case, FaultName(time=time, onset=case.onset, **unknown))
        return [] if age > LATE else self._proposals(case, moments, judged)

    def _proposals(self, case: _Case, moments: Moments, judged: Explanation) -> list[ProposedMap]:
        """Returns the candidate maps of the most probable faults."""
        config, bank = self._config, case.bank
        hit = moments.power / np.maximum(moments.count, 1.0) > CHANGED * self._core.normal()
        found: list[ProposedMap] = []
        for key in np.argsort(-judged.chance)[:CONTENDERS]:
            curve = judged.best_of(key)
            left = 1.0 - float(judged.explained[curve])
            odds = float(judged.chance[key])
            if judged.evidence[curve] < config.evidence or odds < max(left, config.discrepancy**2):
                continue
            size = float(judged.fit.size[curve])
            shift, valves = bank.curves[curve].shift(size), bank.curves[curve].valves_at(size)
            rest = moments.about(shift).power / np.maximum(moments.power, 1e-300)
            gain = np.where(hit, config.open_share * np.minimum(rest, 1.0), np.nan)
            found.append(ProposedMap(bank.keys[key], case.base + shift, gain, odds, valves))
        return found

    def _still_off(self, case: _Case, time: float) -> np.ndarray:
        """Returns a mask of the joints that the map before the change still predicts badly.

        Errors older than `RECENT` do not count, because a new motion also causes errors at first.
        """
        _, power, count = case.errors[-1]
        earlier = [look for look in case.errors if look[0] <= time - self._pace * RECENT]
        if earlier:
            power, count = power - earlier[-1][1], count - earlier[-1][2]
        return power / np.maximum(count, 1.0) > UNEXPLAINED * self._core.normal()

    def _withdraw(self, case: _Case, time: float) -> None:
        case.key = None
        if case.event is not None:
            case.event.withdrawn = time
        self._tell(None)

    def _say(self, case: _Case, name: FaultName) -> None:
        if case.event is None:
            case.event = FaultEvent(names=[name])
            self.events.append(case.event)
        else:
            say(case.event.names, name, stands=case.event.withdrawn is None)
        case.event.withdrawn = None
        self._tell(name)

    def _tell(self, name: FaultName | None) -> None:
        """Writes a name into `report`; None clears it."""
        if name is not None and name.fault == UNKNOWN and name.undoes is not None:
            name = None
        confidence = None if name is None else name.confidence
        report(self.report, name, confidence, faults=self._bank.faults, joints=self._joints)
