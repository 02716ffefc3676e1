"""Health monitor: estimates slow wear (fault, rate and remaining life) while a controller learns.

A learner adapts to slow wear, so that its prediction error does not show wear. This monitor uses
the errors of a fixed map of the healthy machine instead. It divides the learner's samples into
segments of a few strides, called looks. The fixed map is fitted to the samples of the first looks.
In every later look the sizes (magnitudes) of all faults of the bank are fitted to the errors of the
fixed map. A straight line is fitted to the best fault's sizes over time, from the onset of the wear
(`wear_line`); the remaining life is the time until the line reaches the end-of-life size.
"""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from leglab.base.errors import SettingsError
from leglab.causes.fault_names import ALL, FaultTrend
from leglab.control.feedforward.conditions import (
    CONDITIONS,
    conditions_of,
    joint_by_joint,
    with_conditions,
)
from leglab.control.feedforward.fault_bank import FaultBank, FaultCurve, Moments, SizeEstimate
from leglab.control.feedforward.judge import (
    Explanation,
    JudgeConfiguration,
    explained_share,
    interval,
    judge,
    report,
    say,
)
from leglab.control.feedforward.thresholds import (
    CHANGED,
    MOST_LOOKS,
    NINETY,
    RIDGE,
    TOGETHER,
    UNEXPLAINED,
)
from leglab.control.feedforward.wear_line import line_of


class HealthConfiguration(JudgeConfiguration):
    """How slow wear is followed.

    Attributes:
        look: Learned samples from one estimate of the sizes to the next, of a reference of period
            1.2 s: of another one in proportion.
        wait: Learned samples before the first one that counts, likewise.
        healthy: Looks to which the map of the healthy machine is fitted.
        explained: Least share of the error beyond the healthy machine's that a fault must explain,
            of the share that it explains on the nominal machine.
        evidence: Least log-likelihood ratio of a fault to no change.
        end_of_life: Size at which a part is worn out, by fault; the bank's largest where none is
            given.
    """

    look: int = Field(default=1500, ge=100)
    wait: int = Field(default=1900, ge=0)
    healthy: int = Field(default=2, ge=1)
    explained: float = Field(default=0.6, gt=0, lt=1)
    evidence: float = Field(default=20.0, ge=0)
    end_of_life: dict[str, float] = Field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Look:
    """Evaluation of one look, a segment of a few strides of learned samples."""

    fit: SizeEstimate  # of all curves of the bank
    error: np.ndarray  # mean square errors of the map of the healthy machine, (joints,)
    own: Mapping[str, tuple[float, np.ndarray]]  # by condition: result of `joint_by_joint`


class _History:
    """Sizes of all curves in all past looks, in one preallocated array.

    Many small arrays, allocated between large temporary ones, would fragment the memory.
    """

    def __init__(self, curves: int) -> None:
        self._rows, self.count = np.empty((MOST_LOOKS + 1, 1 + curves)), 0

    def add(self, time: float, size: np.ndarray) -> None:
        """Adds a look; above `MOST_LOOKS` looks, drops every second of the older looks."""
        self._rows[self.count, 0], self._rows[self.count, 1:] = time, size
        self.count += 1
        if self.count > MOST_LOOKS:
            rows = self._rows[: self.count]
            kept = np.concatenate([rows[:-TOGETHER:2], rows[-TOGETHER:]])
            self._rows[: len(kept)], self.count = kept, len(kept)

    def of(self, curve: int) -> tuple[np.ndarray, np.ndarray]:
        """Returns the times of all looks and the sizes of a curve, (looks,) each."""
        return self._rows[: self.count, 0].copy(), self._rows[: self.count, 1 + curve].copy()


class HealthMonitor:
    """Follows slow wear from the samples of a learner.

    Args:
        bank: Bank of the nominal machine.
        joints: Names of the joints.
        config: How wear is followed.
        sample_period: Time from one learned sample to the next [s].
        pace: Period of the reference over `STRIDE`; scales the numbers of samples.

    Attributes:
        trends: Slow changes reported since `reset`; the last entry is still updated.
        report: By name, each (joints,): `health_fault` (numbers as in `FaultMonitor.report`; 0 for
            a condition), `health_size` and `health_remaining`, the remaining life [s] (NaN if
            unknown), at the joints with the fault. The next look overwrites the arrays.

    Raises:
        LeglabError: The end-of-life size belongs to a fault that is not in the bank, or does not
            lie beyond the healthy size in the direction of wear.
    """

    def __init__(
        self,
        bank: FaultBank,
        joints: tuple[str, ...],
        config: HealthConfiguration,
        *,
        sample_period: float,
        pace: float = 1.0,
    ) -> None:
        import scipy.special  # noqa: F401  a slow import, which would interrupt the motion later

        self._faults, self._joints, self._config = bank.faults, joints, config
        self._bank = with_conditions(bank)
        self._conditions = conditions_of(self._bank)
        for fault, size in config.end_of_life.items():
            _check_end(self._bank, fault, size)
        self._period, self._pace = sample_period, pace
        self._samples = round(pace * config.look)  # learned samples per look
        kinds = ("health_fault", "health_size", "health_remaining")
        self.report = {name: np.zeros(len(joints)) for name in kinds}
        self.reset()

    def reset(self) -> None:
        """Forgets everything."""
        self.trends: list[FaultTrend] = []
        self._waits = round(self._pace * self._config.wait)
        self._carried: np.ndarray | None = None
        self._base: np.ndarray | None = None
        self._normal = np.zeros(len(self._joints))
        self._looks: deque[_Look] = deque(maxlen=TOGETHER)
        self._judged: Explanation | None = None
        self._history = _History(len(self._bank.curves))
        self.drop()
        self._tell(None)

    def drop(self) -> None:
        """Discards the samples of the present look, because the machine changed abruptly in it."""
        self._sums: Moments | None = None
        self._number = 0

    def renew(self) -> None:
        """Fits the healthy map anew after an abrupt change, without the wear so far."""
        self.drop()
        if self._base is not None:
            judged = self._judged if self.trends else None
            size = 0.0 if judged is None else float(judged.fit.size[judged.best])
            self._carried = None if judged is None else judged.curve.shift(size)
            self._base = None

    def take(self, time: float, samples: np.ndarray, parameters: np.ndarray) -> None:
        """Takes a block of learned samples; arguments as for `FaultMonitor.take`."""
        if self._waits > 0:
            self._waits -= len(samples)
            return
        if self._sums is None:
            self._sums = Moments(len(self._joints), parameters.shape[1])
        self._sums.add(samples)
        self._number += len(samples)
        wanted = self._samples * (1 if self._base is not None else self._config.healthy)
        if self._number < wanted:
            return
        sums = self._sums
        self.drop()
        if self._base is None:
            self._learn(sums, parameters)
        else:
            self._look(time, sums.about(self._base))

    def _learn(self, sums: Moments, parameters: np.ndarray) -> None:
        """Fits the map of the healthy machine."""
        eye = RIDGE * np.eye(parameters.shape[-1])
        wanted = sums.about(parameters).correlation[..., None]
        base = parameters + np.linalg.solve(sums.information + eye, wanted)[..., 0]
        self._normal = sums.about(base).power / np.maximum(sums.count, 1.0)
        self._base = base if self._carried is None else base - self._carried

    def _look(self, time: float, moments: Moments) -> None:
        """Evaluates a look; `moments` are sums over its samples, relative to the healthy map."""
        given = moments, self._normal, self._config.discrepancy
        own = {name: joint_by_joint(bank, *given) for name, bank in self._conditions.items()}
        look = _Look(
            fit=self._bank.fit(*given),
            error=moments.power / np.maximum(moments.count, 1.0),
            own=own,
        )
        self._looks.append(look)
        self._history.add(time - self._samples * self._period / 2, look.fit.size)
        if len(self._looks) == TOGETHER:
            self._judged = judge(self._bank, [look.fit for look in self._looks], self._config)
            self._decide(time, self._judged)

    def _decide(self, time: float, judged: Explanation) -> None:
        """Reports the fault, condition or unknown change, if any, that the last looks show."""
        config = self._config
        beyond = np.array([look.error for look in self._looks]) / np.maximum(self._normal, 1e-300)
        least = beyond.max(axis=1).min()  # maximum over joints, then minimum over looks
        if least <= CHANGED:
            return
        if judged.enough(config.explained, config.evidence):
            if judged.certain:
                self._say(self._trend(time, judged))
        elif (condition := self._condition(time, judged)) is not None:
            self._say(condition)
        elif least > UNEXPLAINED and not (self.trends and self.trends[-1].key == judged.key):
            # A reported fault stands while it fits best, even if it explains too little.
            unknown = judged.unknown(self._joints, beyond[-1] > UNEXPLAINED)
            since = self._history.of(0)[0][-TOGETHER]
            self._say(FaultTrend(since=since, time=time, seen=time, **unknown))

    def _condition(self, time: float, judged: Explanation) -> FaultTrend | None:
        """Tests for a condition with different values at the joints, such as hotter oil at one.

        Called only if no fault of the bank explains enough, because a condition with a free value
        per joint is flexible enough to fit the effects of wear as well.

        Separate values and origins of the joints are 2 joints - 2 parameters more than common ones.
        Each parameter raises the cost by log(samples) (Schwarz 1978, Annals of Statistics 6, 461).

        Returns:
            The first condition that explains the last looks well enough; None if none does.
        """
        config, joints = self._config, len(self._joints)
        samples = joints * self._samples * TOGETHER / config.correlation
        more = config.correlation * (2 * joints - 2) * math.log(samples)
        for name, bank in self._conditions.items():
            cost = sum(look.own[name][0] for look in self._looks)
            explained = float(explained_share(cost, judged.fit.without, judged.fit.noise))
            evidence = config.evidence_of(judged.fit.without - cost - more)
            rivals = np.array([cost + more, judged.fit.cost[judged.best]])
            chance = float(judged.odds(rivals, [0, 1])[0])
            if (
                explained >= config.explained * bank.curves[0].explains
                and evidence >= config.evidence
                and chance >= config.confidence
            ):
                values = self._looks[-1].own[name][1]
                # One value fitted to all joints together has a smaller variance.
                size = float(judged.fit.size[judged.best_of(self._bank.keys.index((name, ALL)))])
                return FaultTrend(
                    fault=name,
                    element=ALL,
                    condition=True,
                    since=self._history.of(0)[0][-TOGETHER],
                    time=time,
                    seen=time,
                    size=size,
                    low=min(size, float(np.min(values))),
                    high=max(size, float(np.max(values))),
                    meaning=bank.curves[0].meaning,
                    confidence=chance,
                    explained=explained,
                )
        return None

    def _trend(self, time: float, judged: Explanation) -> FaultTrend:
        """Returns the trend of the best fault, with the line through its sizes so far."""
        curve, scale = judged.curve, self._config.discrepancy
        worn_out = None if curve.fault in CONDITIONS else self._end_of_life(curve)
        times, sizes = self._history.of(judged.best)
        told = judged.told() | {
            "condition": curve.fault in CONDITIONS,
            "since": times[-TOGETHER],
            "time": time,
            "seen": time,
            "end_of_life": worn_out,
        }
        line = line_of(times, sizes, float(curve.sizes[0]))
        if line is None:
            return FaultTrend(**told)
        late = time - line.end
        ends = float(np.min(curve.sizes)), float(np.max(curve.sizes))
        size = float(np.clip(line.value + line.rate * late, *ends))
        value, rate = (line.quantile / NINETY * np.sqrt(np.diag(line.covariance))).tolist()
        low, high = interval(curve, size, value, scale)
        # Model error of the nominal machine scales all sizes and the rate by an unknown factor.
        spread = NINETY * math.hypot(rate, scale * line.rate)
        told |= {
            "since": line.onset,
            "size": size,
            "low": low,
            "high": high,
            "rate": 3600 * line.rate,
            "rate_low": 3600 * (line.rate - spread),
            "rate_high": 3600 * (line.rate + spread),
        }
        if worn_out is not None:
            best, first, last = line.reaches(worn_out, scale * abs(worn_out - curve.sizes[0]))
            if best is not None:  # the fault grows towards its end-of-life size
                told |= {
                    "remaining": max(best - late, 0.0),
                    "remaining_low": max(first - late, 0.0),
                    "remaining_high": None if last is None else max(last - late, 0.0),
                }
        return FaultTrend(**told)

    def _end_of_life(self, curve: FaultCurve) -> float:
        """Returns the configured end-of-life size if it is towards wear, else the curve's last."""
        healthy, largest = float(curve.sizes[0]), float(curve.sizes[-1])
        given = float(self._config.end_of_life.get(curve.fault, largest))
        return given if (given - healthy) * (largest - healthy) > 0 else largest

    def _say(self, trend: FaultTrend) -> None:
        say(self.trends, trend, stands=True)
        self._tell(self.trends[-1])

    def _tell(self, trend: FaultTrend | None) -> None:
        """Writes a trend into `report`; clears it for a condition or None."""
        shown = None if trend is None or trend.condition else trend
        report(
            self.report,
            shown,
            None if shown is None else shown.remaining,
            faults=self._faults,
            joints=self._joints,
            empty=math.nan,
        )


def _check_end(bank: FaultBank, fault: str, size: float) -> None:
    """Raises `SettingsError` unless an end-of-life size is beyond healthy in wear's direction."""
    wears = [c for c in bank.curves if c.fault not in CONDITIONS]
    curves = [c for c in wears if c.fault == fault]
    if not curves:
        text = f"health.end_of_life: {fault!r} is no fault that wears; choose "
        raise SettingsError(text, given=fault, allowed=dict.fromkeys(c.fault for c in wears))
    if not any((size - c.sizes[0]) * (c.sizes[-1] - c.sizes[0]) > 0 for c in curves):
        healthy = f"{curves[0].sizes[0]:g}"
        towards = " or ".join(dict.fromkeys(f"{c.sizes[-1]:g}" for c in curves))
        allowed = f"{healthy} is healthy, worn out is beyond it towards {towards}"
        text = f"health.end_of_life: {fault} {size!r} is not allowed; "
        raise SettingsError(text, given=size, allowed=allowed)
