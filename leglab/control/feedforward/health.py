"""Follows slow wear while a controller learns: what it is, how fast it grows, how long it may last.

A learner follows a machine that wears slowly, so its own error shows nothing. This monitor holds
the samples against the map of the healthy machine instead: it fits that map to the first minutes,
and from then on every fault of the bank to what the map mispredicts in each look of a few strides.
The sizes of the best fault over time are a straight line from its onset on; where the line reaches
the size that is the end of life is the remaining life, with the interval of Fieller (1954, Journal
of the Royal Statistical Society B 16, 175). It sees the samples of the learner and nothing else.
"""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field

from leglab.base.errors import LeglabError
from leglab.base.settings import Configuration
from leglab.control.feedforward.fault_bank import (
    ALL,
    DISCREPANCY,
    UNKNOWN,
    FaultBank,
    FaultCurve,
    Moments,
)

# What a sound machine passes through: a name, and the faults of the bank whose sizes, in one unit,
# are its values. A drift of it is no wear, wherever it begins.
CONDITIONS: Mapping[str, tuple[str, ...]] = {"oil_temperature": ("cold_oil", "hot_oil")}

# Weight of a squared parameter about the learner's against the squared errors of the first samples.
_RIDGE = 1e-2

# Looks that are judged together.
_TOGETHER = 3

# Looks whose sizes are kept: days are a coarser line.
_MOST_LOOKS = 1024

# Mean square error of the healthy map, over what it was, from which on a joint has changed [1]; and
# from which on a drift that nothing explains is told.
_CHANGED, _UNEXPLAINED = 2.0, 10.0

# Looks on a line, at least; from so many on the later half of them is the line, since wear that
# grows faster and faster is shown too good by all.
_FEWEST, _MANY = 4, 16

# Both ends of an interval together leave out so much.
_OUTSIDE = 0.1


class HealthConfiguration(Configuration):
    """How slow wear is followed.

    Attributes:
        look: Learned samples from one estimate of the sizes to the next.
        wait: Learned samples before the first one that counts.
        healthy: Looks to which the map of the healthy machine is fitted.
        correlation: Learned samples that count as one: neighbours err alike.
        discrepancy: Share of the error that a right fault leaves, since no machine is the nominal
            one; also of its size. A standard deviation.
        explained: Least share of the error beyond the healthy machine's that a fault must explain.
        evidence: Least log-likelihood ratio of a fault to no change.
        confidence: Least probability among all of the bank.
        end_of_life: Size at which a part is worn out, by fault; the bank's largest where none is
            given.
    """

    look: int = Field(default=1500, ge=100)
    wait: int = Field(default=1900, ge=0)
    healthy: int = Field(default=2, ge=1)
    correlation: float = Field(default=20.0, ge=1)
    discrepancy: float = Field(default=DISCREPANCY, gt=0, lt=1)
    explained: float = Field(default=0.6, gt=0, lt=1)
    evidence: float = Field(default=20.0, ge=0)
    confidence: float = Field(default=0.9, gt=0, lt=1)
    end_of_life: dict[str, float] = Field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Trend:
    """A slow change of the machine.

    Attributes:
        fault: Its name in the bank, "oil_temperature", or "unknown change".
        element: Joint whose cylinder or spring has it, or "all".
        condition: Whether a sound machine passes through it, as through temperatures of the oil.
        since: When it began [s].
        time: When it was said first [s].
        seen: When it was looked at last [s].
        size: Then, in the fault's own unit; None where unknown.
        low: Lower end of the size's 90 % interval; of a condition that joints differ in, the
            lowest.
        high: Upper end; the highest.
        meaning: What the size says, with its unit.
        confidence: Probability among all of the bank [1].
        explained: Share of the error beyond the healthy machine's that it explains [1].
        rate: Growth of the size in an hour; None where too few looks show it.
        rate_low: Lower end of its 90 % interval.
        rate_high: Upper end.
        end_of_life: Size at which the part is worn out; None for a condition.
        remaining: Until the line of the sizes is there, from `seen` on [s]; None where it is not
            on its way there.
        remaining_low: Lower end of its 90 % interval [s].
        remaining_high: Upper end; None where growth may as well have ended.
    """

    fault: str
    element: str
    condition: bool = False
    since: float
    time: float
    seen: float
    size: float | None = None
    low: float | None = None
    high: float | None = None
    meaning: str = ""
    confidence: float
    explained: float
    rate: float | None = None
    rate_low: float | None = None
    rate_high: float | None = None
    end_of_life: float | None = None
    remaining: float | None = None
    remaining_low: float | None = None
    remaining_high: float | None = None


@dataclass(frozen=True, kw_only=True)
class Line:
    """A straight line through sizes over time, from its onset on.

    Attributes:
        onset: When the sizes leave the healthy one [s].
        end: Time of the last size [s].
        value: On the line at the end.
        rate: Slope [1/s].
        covariance: Of value and rate, (2, 2).
        freedom: Degrees of freedom of the residuals that it is from.
    """

    onset: float
    end: float
    value: float
    rate: float
    covariance: np.ndarray
    freedom: int

    @property
    def quantile(self) -> float:
        """Of Student's distribution, for the ends of an interval."""
        from scipy.special import stdtrit

        return float(stdtrit(self.freedom, 1 - _OUTSIDE / 2))

    def reaches(self, level: float, scale: float) -> tuple[float | None, float, float | None]:
        """When the line is at a level: best estimate and both ends of its 90 % interval.

        The ends are the times at which the level is at the edge of what the line may be there
        (Fieller 1954): the roots of (v + r t - level)^2 = q^2 var(v + r t) + var(level).

        Args:
            level: Size.
            scale: Standard deviation of the level, in which the unknown scale of all sizes is put.

        Returns:
            Times after the end [s], the first None where it goes elsewhere, the last None where
            no slope is as likely.
        """
        gap, q2 = level - self.value, self.quantile**2
        best = gap / self.rate if gap * self.rate > 0 else (0.0 if gap == 0 else None)
        (vv, vr), (_, rr) = self.covariance.tolist()
        spread = q2 * vv + (1.645 * scale) ** 2
        a, b, c = self.rate**2 - q2 * rr, -(gap * self.rate + q2 * vr), gap**2 - spread
        root = b * b - a * c
        if a <= 0 or root < 0:  # the slope may be nil
            first = 0.0 if c <= 0 else -c / (2 * b) if a == 0 and b < 0 else _least(a, b, c)
            return best, first, None
        ends = sorted(((-b - math.sqrt(root)) / a, (-b + math.sqrt(root)) / a))
        return best, max(ends[0], 0.0), max(ends[1], 0.0)


def _least(a: float, b: float, c: float) -> float:
    """The smallest positive root of a t^2 + 2 b t + c with a < 0; 0 where there is none."""
    root = math.sqrt(max(b * b - a * c, 0.0))
    ends = [end for end in ((-b - root) / a, (-b + root) / a) if end > 0] if a else []
    return min(ends, default=0.0)


def line_of(time: np.ndarray, size: np.ndarray, healthy: float) -> Line | None:
    """Fits the line of sizes that leave the healthy one at an onset.

    The onset is that of the broken line with the least squares. From it on the line is fitted
    anew; neighbouring residuals that are alike count less (AR(1), by their own correlation).

    Args:
        time: Of each size, increasing [s], (n,).
        size: (n,).
        healthy: Size of the healthy machine.

    Returns:
        None where fewer than four sizes lie behind the onset.
    """
    count = len(time)
    if count < _FEWEST:
        return None
    rise = size - healthy
    behind = np.maximum(time[None, :] - time[: count - _FEWEST + 1, None], 0.0)
    square = np.einsum("ij,ij->i", behind, behind)
    slope = behind @ rise / square
    cost = np.sum((rise - slope[:, None] * behind) ** 2, axis=1)
    first = int(np.argmin(cost))
    onset, number = float(time[first]), count - first
    if number >= _MANY:
        first += number // 2
        number = count - first
    t, y = time[first:] - time[-1], size[first:]
    design = np.column_stack([np.ones(number), t])
    inverse = np.linalg.inv(design.T @ design)
    value, rate = inverse @ (design.T @ y)
    left = y - value - rate * t
    freedom = number - 2
    power = float(left @ left)
    alike = float(np.clip(left[1:] @ left[:-1] / max(power, 1e-300), 0.0, 0.9))
    variance = power / freedom * (1 + alike) / (1 - alike)
    return Line(
        onset=onset,
        end=float(time[-1]),
        value=float(value),
        rate=float(rate),
        covariance=variance * inverse,
        freedom=freedom,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Look:
    """Fits of all curves to the samples of a look, and what the healthy machine would leave."""

    time: float
    size: np.ndarray
    cost: np.ndarray
    without: float
    floor: float
    error: np.ndarray
    own: Mapping[
        str, tuple[float, np.ndarray]
    ]  # cost and values of conditions that joints differ in


class _History:
    """Sizes of all curves in the looks so far, in memory that is taken once.

    Small arrays that are kept among large ones that are not would hold much more than their own.
    """

    def __init__(self, curves: int) -> None:
        self._time, self._size = np.empty(_MOST_LOOKS + 1), np.empty((_MOST_LOOKS + 1, curves))
        self.count = 0

    def add(self, look: _Look) -> None:
        """Adds a look; where there are too many, every second of the earlier ones goes."""
        self._time[self.count], self._size[self.count] = look.time, look.size
        self.count += 1
        if self.count > _MOST_LOOKS:
            early = np.arange(0, self.count - _TOGETHER, 2)
            kept = np.append(early, np.arange(self.count - _TOGETHER, self.count))
            self._time[: kept.size], self._size[: kept.size] = self._time[kept], self._size[kept]
            self.count = kept.size

    def of(self, curve: int) -> tuple[np.ndarray, np.ndarray]:
        """Times and sizes of a curve, (looks,) each."""
        return self._time[: self.count].copy(), self._size[: self.count, curve].copy()


class HealthMonitor:
    """Follows slow wear from the samples of a learner.

    Args:
        bank: Of the nominal machine.
        joints: Their names.
        config: How wear is followed.
        sample_period: From one learned sample to the next [s].

    Attributes:
        trends: Slow changes that were seen since `reset`; the last one goes on.
        report: By name, each (joints,): `health_fault` (as the `fault` of a `FaultMonitor`; 0 for a
            condition), `health_size` and `health_remaining` [s] (NaN where unknown), of the joints
            that it concerns. The arrays change with the next look.

    Raises:
        LeglabError: An end of life is of a fault that the bank has not, or no larger change than
            none.
    """

    def __init__(
        self,
        bank: FaultBank,
        joints: tuple[str, ...],
        config: HealthConfiguration,
        *,
        sample_period: float,
    ) -> None:
        import scipy.special  # noqa: F401  not in the middle of a motion

        self._faults, self._joints, self._config = bank.faults, joints, config
        self._bank = with_conditions(bank)
        self._conditions = conditions_of(self._bank)
        for fault, size in config.end_of_life.items():
            _check_end(self._bank, fault, size)
        self._period = sample_period
        kinds = ("health_fault", "health_size", "health_remaining")
        self.report = {name: np.zeros(len(joints)) for name in kinds}
        self.reset()

    def reset(self) -> None:
        """Forgets everything."""
        self.trends: list[Trend] = []
        self._open = False
        self._waits = self._config.wait
        self._carried: np.ndarray | None = None
        self._restart()
        self._tell(None)

    def _restart(self) -> None:
        """Begins to learn the map of the machine as it is."""
        self._base: np.ndarray | None = None
        self._normal = np.zeros(len(self._joints))
        self._looks: deque[_Look] = deque(maxlen=_TOGETHER)
        self._history = _History(len(self._bank.curves))
        self.drop()

    def drop(self) -> None:
        """Forgets the samples of the present look, in which the machine has changed at once."""
        self._sums: Moments | None = None
        self._number = 0

    def renew(self) -> None:
        """Takes the machine as it is now, after a change at once, for where wear goes on from."""
        shift = self._shift()
        self.drop()
        self._base, self._carried = None, shift

    def _shift(self) -> np.ndarray | None:
        """The shift of the wear so far."""
        if self._base is None:
            return self._carried
        leader = self._leader() if self._open else None
        if leader is None:
            return None
        curve, size = self._bank.curves[leader], self._looks[-1].size[leader]
        return curve.shift(float(size))

    def take(self, time: float, samples: np.ndarray, parameters: np.ndarray) -> None:
        """Takes a block of learned samples; arguments as of `FaultMonitor.take`."""
        if self._waits > 0:
            self._waits -= len(samples)
            return
        if self._sums is None:
            self._sums = Moments(len(self._joints), parameters.shape[1])
        self._sums.add(samples)
        self._number += len(samples)
        wanted = self._config.look * (1 if self._base is not None else self._config.healthy)
        if self._number < wanted:
            return
        sums = self._sums
        self.drop()
        if self._base is None:
            self._learn(sums, parameters)
        else:
            self._look(time, sums)

    def _learn(self, sums: Moments, parameters: np.ndarray) -> None:
        """Fits the map of the healthy machine."""
        eye = _RIDGE * np.eye(parameters.shape[-1])
        wanted = sums.about(parameters).correlation[..., None]
        base = parameters + np.linalg.solve(sums.information + eye, wanted)[..., 0]
        self._normal = sums.about(base).power / np.maximum(sums.count, 1.0)
        self._base = base if self._carried is None else base - self._carried

    def _look(self, time: float, sums: Moments) -> None:
        config = self._config
        assert self._base is not None
        moments = sums.about(self._base)
        count = np.maximum(moments.count, 1.0)
        variance = self._normal + config.discrepancy**2 * moments.power / count
        weight = 1.0 / np.maximum(variance, 1e-300)
        fit = self._bank.fit(moments, weight)
        self._looks.append(
            _Look(
                time=time - self._config.look * self._period / 2,
                size=fit.size,
                cost=fit.cost,
                without=fit.without,
                floor=float(weight @ (self._normal * count)),
                error=moments.power / count,
                own={
                    name: _joint_by_joint(own, moments, weight)
                    for name, own in self._conditions.items()
                },
            )
        )
        self._history.add(self._looks[-1])
        self._judge(time)

    def _leader(self) -> int | None:
        """The curve that explains the last looks best; None before there are enough."""
        if len(self._looks) < _TOGETHER:
            return None
        return int(np.argmin(np.sum([look.cost for look in self._looks], axis=0)))

    def _judge(self, time: float) -> None:
        config, recent = self._config, self._looks
        leader = self._leader()
        if leader is None:
            return
        cost = np.sum([look.cost for look in recent], axis=0)
        without = sum(look.without for look in recent)
        excess = max(without - sum(look.floor for look in recent), 1e-300)
        explained = float(min((without - cost[leader]) / excess, 1.0))
        evidence = (without - cost[leader]) / (2 * config.correlation)
        chance = float(self._bank.chances(cost, config.correlation)[int(self._bank.group[leader])])
        curve = self._bank.curves[leader]
        changed = all(np.any(look.error > _CHANGED * self._normal) for look in recent)
        known = (
            changed
            and evidence >= config.evidence
            and explained >= config.explained
            and chance >= config.confidence
        )
        if known:
            self._say(self._trend(time, leader, chance, explained))
        elif self._judge_conditions(time, without, float(cost[leader])):
            return
        elif all(np.any(look.error > _UNEXPLAINED * self._normal) for look in recent):
            still = self._open and (curve.fault, curve.element) == self._last()
            if not still:  # a name that explains a little less than it did is not taken back
                self._say(self._unknown(time, explained))

    def _judge_conditions(self, time: float, without: float, rival: float) -> bool:
        """Says a condition that joints may differ in, as the oil of a cylinder that works harder.

        Asked where no fault of the bank explains enough: free in every joint it would pass for
        wear.

        It has a value and an origin a joint, so by Schwarz (1978, Annals of Statistics 6, 461) its
        cost is higher by the logarithm of the number of samples for each of them.

        Args:
            time: [s].
            without: Cost of the healthy map over the last looks.
            rival: That of the best curve of the bank.

        Returns:
            Whether one explains the last looks best, and enough.
        """
        config, recent = self._config, self._looks
        joints = len(self._joints)
        samples = joints * config.look * _TOGETHER / config.correlation
        more = config.correlation * (2 * joints - 2) * math.log(samples)
        excess = max(without - sum(look.floor for look in recent), 1e-300)
        for name in self._conditions:
            cost = sum(look.own[name][0] for look in recent)
            evidence = (without - cost - more) / (2 * config.correlation)
            explained = min((without - cost) / excess, 1.0)
            ahead = min((rival - cost - more) / (2 * config.correlation), 700.0)
            chance = 1.0 / (1.0 + math.exp(-ahead)) if ahead > 0 else 0.0
            changed = all(np.any(look.error > _CHANGED * self._normal) for look in recent)
            enough = evidence >= config.evidence and explained >= config.explained
            if not (changed and enough and chance >= config.confidence):
                continue
            values = recent[-1].own[name][1]
            # The value of all joints together is the steadier one.
            whole = [i for i, curve in enumerate(self._bank.curves) if curve.fault == name]
            best = min(whole, key=lambda i: float(sum(look.cost[i] for look in recent)))
            size = float(recent[-1].size[best])
            self._say(
                Trend(
                    fault=name,
                    element=ALL,
                    condition=True,
                    since=recent[0].time,
                    time=time,
                    seen=time,
                    size=size,
                    low=min(size, float(np.min(values))),
                    high=max(size, float(np.max(values))),
                    meaning=self._conditions[name].curves[0].meaning,
                    confidence=chance,
                    explained=explained,
                )
            )
            return True
        return False

    def _last(self) -> tuple[str, str]:
        return self.trends[-1].fault, self.trends[-1].element

    def _unknown(self, time: float, explained: float) -> Trend:
        hit = self._looks[-1].error > _UNEXPLAINED * self._normal
        names = ",".join(name for name, own in zip(self._joints, hit, strict=True) if own)
        return Trend(
            fault=UNKNOWN,
            element=ALL if hit.all() and len(hit) > 1 else names,
            since=self._looks[0].time,
            time=time,
            seen=time,
            confidence=1.0 - max(explained, 0.0),
            explained=max(explained, 0.0),
        )

    def _trend(self, time: float, leader: int, chance: float, explained: float) -> Trend:
        curve, config = self._bank.curves[leader], self._config
        condition = curve.fault in CONDITIONS
        times, sizes = self._history.of(leader)
        healthy, scale = float(curve.sizes[0]), config.discrepancy
        worn_out = None
        if not condition:
            worn_out = float(config.end_of_life.get(curve.fault, curve.sizes[-1]))
            if (worn_out - healthy) * (curve.sizes[-1] - healthy) <= 0:
                worn_out = float(curve.sizes[-1])  # what was given is of the other side
        trend = Trend(
            fault=curve.fault,
            element=curve.element,
            condition=condition,
            since=float(times[-_TOGETHER]),
            time=time,
            seen=time,
            size=float(sizes[-1]),
            meaning=curve.meaning,
            confidence=chance,
            explained=explained,
            end_of_life=worn_out,
        )
        line = line_of(times, sizes, healthy)
        if line is None:
            half = 1.645 * scale * abs(float(sizes[-1]) - healthy)
            return replace(trend, low=float(sizes[-1]) - half, high=float(sizes[-1]) + half)
        ends = float(np.min(curve.sizes)), float(np.max(curve.sizes))
        late = time - line.end
        size = float(np.clip(line.value + line.rate * late, *ends))
        # All sizes are off by the same share, for this machine is not the nominal one.
        differs = 1.645 * scale
        half = math.hypot(
            line.quantile * math.sqrt(float(line.covariance[0, 0])), differs * (size - healthy)
        )
        deviation = line.quantile * math.sqrt(float(line.covariance[1, 1]))
        spread = math.hypot(deviation, differs * line.rate)
        trend = replace(
            trend,
            since=line.onset,
            size=size,
            low=max(size - half, ends[0]),
            high=min(size + half, ends[1]),
            rate=3600 * line.rate,
            rate_low=3600 * (line.rate - spread),
            rate_high=3600 * (line.rate + spread),
        )
        if worn_out is None:
            return trend
        best, first, last = line.reaches(worn_out, scale * abs(worn_out - healthy))
        if best is None:  # it does not grow towards its end
            return trend
        return replace(
            trend,
            remaining=max(best - late, 0.0),
            remaining_low=max(first - late, 0.0),
            remaining_high=None if last is None else max(last - late, 0.0),
        )

    def _say(self, trend: Trend) -> None:
        if self._open and (trend.fault, trend.element) == self._last():
            self.trends[-1] = replace(trend, time=self.trends[-1].time)
        else:
            self.trends.append(trend)
            self._open = True
        self._tell(self.trends[-1])

    def _tell(self, trend: Trend | None) -> None:
        """Fills the report."""
        for values in self.report.values():
            values[:] = 0.0
        self.report["health_remaining"][:] = math.nan
        if trend is None or trend.condition:
            return
        own = trend.element.split(",")
        hit = [trend.element == ALL or joint in own for joint in self._joints]
        number = -1.0 if trend.fault == UNKNOWN else 1.0 + self._faults.index(trend.fault)
        left = math.nan if trend.remaining is None else trend.remaining
        for key, value in zip(self.report, (number, trend.size or 0.0, left), strict=True):
            self.report[key][hit] = value


def conditions_of(bank: FaultBank) -> dict[str, FaultBank]:
    """The curves of each condition in a bank."""
    found = {name: tuple(c for c in bank.curves if c.fault == name) for name in CONDITIONS}
    return {name: FaultBank(curves=curves) for name, curves in found.items() if curves}


def _joint_by_joint(
    bank: FaultBank, moments: Moments, weight: np.ndarray
) -> tuple[float, np.ndarray]:
    """Cost and values, (joints,), of a condition with a value of its own for each joint's map."""
    cost, values = 0.0, np.zeros(len(weight))
    for joint in range(len(weight)):
        alone = np.zeros(len(weight))
        alone[joint] = weight[joint]
        fit = bank.fit(moments, alone)
        best = int(np.argmin(fit.cost))
        cost += float(fit.cost[best])
        values[joint] = fit.size[best]
    return cost, values


def _check_end(bank: FaultBank, fault: str, size: float) -> None:
    """Refuses an end of life that no wear comes to."""
    wears = [c for c in bank.curves if c.fault not in CONDITIONS]
    curves = [c for c in wears if c.fault == fault]
    if not curves:
        names = ", ".join(dict.fromkeys(c.fault for c in wears))
        raise LeglabError(f"health.end_of_life: {fault!r} is no fault that wears; choose {names}")
    if not any((size - c.sizes[0]) * (c.sizes[-1] - c.sizes[0]) > 0 for c in curves):
        healthy = f"{curves[0].sizes[0]:g}"
        towards = " or ".join(dict.fromkeys(f"{c.sizes[-1]:g}" for c in curves))
        raise LeglabError(
            f"health.end_of_life: {fault} {size!r} is not allowed; {healthy} is healthy, worn out "
            f"is beyond it towards {towards}"
        )


def with_conditions(bank: FaultBank) -> FaultBank:
    """The bank with `CONDITIONS` in place of the faults that they consist of.

    A machine may be at any value of a condition when it is first seen: there is a curve upwards
    and one downwards from each.
    """
    curves = [c for c in bank.curves if not any(c.fault in own for own in CONDITIONS.values())]
    for name, faults in CONDITIONS.items():
        parts = [c for c in bank.curves if c.fault in faults and c.element == ALL]
        nodes: dict[float, np.ndarray] = {}
        for part in parts:
            nodes |= {float(x): y for x, y in zip(part.sizes, part.shifts, strict=True)}
        sizes = sorted(nodes)
        for i, origin in enumerate(sizes):
            for way in (sizes[i:], sizes[i::-1]):
                if len(way) < 2:
                    continue
                shifts = np.array([nodes[size] - nodes[origin] for size in way])
                curves.append(
                    FaultCurve(
                        fault=name,
                        element=ALL,
                        meaning=parts[0].meaning,
                        sizes=np.array(way),
                        shifts=shifts,
                    )
                )
    return FaultBank(curves=tuple(curves))
