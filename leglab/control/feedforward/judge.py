"""Judges which fault of a bank explains the samples of a learner, and how it is told.

One judge for changes at once (`fault_monitor`) and for slow wear (`health`). Sizes and costs of all
faults and their odds are C++ (`csrc/monitor`); shares, evidence, intervals and words are here.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from pydantic import Field

from leglab._native.monitor import chances
from leglab.base.settings import Configuration
from leglab.causes.fault_names import ALL, UNKNOWN, FaultRival, NamedFault
from leglab.control.feedforward.fault_bank import FaultBank, FaultCurve, SizeEstimate
from leglab.control.feedforward.thresholds import ALIKE, DISCREPANCY, NINETY, TOLD


class JudgeConfiguration(Configuration):
    """How surely a fault must explain the samples.

    Attributes:
        correlation: Learned samples that count as one: neighbours err alike.
        independent: Errors that differ independently between the nominal machine and the one that
            runs, in the odds of two faults that both leave something.
        discrepancy: Share of the error before the correction that a right fault leaves, since no
            machine is the nominal one; also of its size. A standard deviation.
        confidence: Least probability among all faults of the bank of what is named: of one fault,
            or of some that the samples do not tell apart.
    """

    correlation: float = Field(default=20.0, ge=1)
    independent: float = Field(default=12.0, gt=0)
    discrepancy: float = Field(default=DISCREPANCY, gt=0, lt=1)
    confidence: float = Field(default=0.5, gt=0, lt=1)

    def evidence_of(self, gain: Any) -> Any:
        """Log-likelihood ratio of what lowers the weighted squared error by a gain."""
        return gain / (2 * self.correlation)


def explained_share(cost: Any, without: float, noise: float) -> np.ndarray:
    """Share of the squared error beyond noise that a fault takes away, within [0, 1].

    Args:
        cost: Weighted sum of squared errors with the fault's shift, of one or an array of many.
        without: The same without any.
        noise: What it would be of a machine without a fault.
    """
    beyond = without - noise
    gain = np.asarray(without - cost)
    return np.clip(gain / beyond, 0.0, 1.0) if beyond > 0 else np.zeros_like(gain)


@dataclass(frozen=True, kw_only=True, eq=False)
class Explanation:
    """How well the faults of a bank explain a change."""

    bank: FaultBank  #: The bank
    fit: SizeEstimate  #: Of its curves; costs are those of all looks together
    config: JudgeConfiguration  #: How surely a fault must explain the samples

    @cached_property
    def explained(self) -> np.ndarray:
        """Share of the squared error beyond noise that each curve takes away, (curves,)."""
        return explained_share(self.fit.cost, self.fit.without, self.fit.noise)

    @cached_property
    def evidence(self) -> np.ndarray:
        """Log-likelihood ratio of each curve to no change, (curves,)."""
        return np.asarray(self.config.evidence_of(self.fit.without - self.fit.cost))

    @cached_property
    def chance(self) -> np.ndarray:
        """Probability of every fault and element among all of the bank, (keys,)."""
        return self.odds(self.fit.cost, self.bank.group.tolist())

    def odds(self, cost: np.ndarray, keys: list[int]) -> np.ndarray:
        """Probability of rivals by the costs of each, (keys,).

        The odds of two are those of noise or of a machine that is not the nominal one, whichever
        are weaker (`csrc/monitor/fault_fit.h`).
        """
        config, noise = self.config, self.fit.noise
        return chances(cost, keys, config.correlation, config.independent, noise)

    @cached_property
    def best(self) -> int:
        """Number of the curve that fits best."""
        return int(np.argmin(self.fit.cost))

    @property
    def curve(self) -> FaultCurve:
        """The curve that fits best."""
        return self.bank.curves[self.best]

    @property
    def key(self) -> tuple[str, str]:
        """Its fault and element."""
        return self.curve.fault, self.curve.element

    @cached_property
    def alike(self) -> list[int]:
        """Keys that are hardly less probable than the best one, the most probable first."""
        order = np.argsort(-self.chance).tolist()
        return [k for k in order if ALIKE * self.chance[k] > self.chance.max()]

    def best_of(self, key: int) -> int:
        """Number of the curve of a fault and element that fits best."""
        curves = np.flatnonzero(self.bank.group == key)
        return int(curves[np.argmin(self.fit.cost[curves])])

    @property
    def certain(self) -> bool:
        """Whether the best fault and those alike are few, and probable enough together."""
        enough = self.chance[self.alike].sum() >= self.config.confidence
        return len(self.alike) <= TOLD and bool(enough)

    def enough(self, explained: float, evidence: float) -> bool:
        """Whether the best fault explains so much that nothing else is to be looked for.

        Args:
            explained: Least share of the error that it must explain, of the share that a map can
                say of it.
            evidence: Least log-likelihood ratio to no change.
        """
        return bool(
            self.explained[self.best] >= explained * self.curve.explains
            and self.evidence[self.best] >= evidence
        )

    def told(self) -> dict[str, Any]:
        """Fields of a `NamedFault` of the best fault, but for times."""
        curve, size = self.curve, float(self.fit.size[self.best])
        rivals = [
            FaultRival(
                fault=self.bank.keys[key][0],
                element=self.bank.keys[key][1],
                size=float(self.fit.size[self.best_of(key)]),
                confidence=float(self.chance[key]),
            )
            for key in self.alike[1:]
        ]
        sampled = math.sqrt(self.config.correlation) * float(self.fit.spread[self.best])
        low, high = interval(curve, size, sampled, self.config.discrepancy)
        sized = {"size": size, "low": low, "high": high, "meaning": curve.meaning}
        return {
            "fault": curve.fault,
            "element": curve.element,
            "confidence": float(self.chance[self.bank.group[self.best]]),
            "explained": float(self.explained[self.best]),
            "rivals": rivals,
            **(sized if curve.fault != UNKNOWN else {}),
        }

    def unknown(self, joints: tuple[str, ...], hit: np.ndarray) -> dict[str, Any]:
        """The same where no fault explains what some joints show, `hit` (joints,)."""
        names = ",".join(name for name, own in zip(joints, hit, strict=True) if own)
        explained = float(self.explained[self.best])
        return {
            "fault": UNKNOWN,
            "element": ALL if hit.all() and len(hit) > 1 else names,
            "confidence": 1.0 - explained,
            "explained": explained,
        }


def judge(
    bank: FaultBank, looks: Sequence[SizeEstimate], config: JudgeConfiguration
) -> Explanation:
    """Judges looks at one change together; sizes are those of the last one."""
    together = looks[-1]._replace(
        cost=np.sum([look.cost for look in looks], axis=0),
        without=sum(look.without for look in looks),
        noise=sum(look.noise for look in looks),
    )
    return Explanation(bank=bank, fit=together, config=config)


def interval(
    curve: FaultCurve, size: float, sampled: float, discrepancy: float
) -> tuple[float, float]:
    """Ends of a size's 90 % interval, within the curve's.

    Samples scatter, and a machine is not the nominal one: its size is off by as much.

    Args:
        curve: Of the fault.
        size: Estimate.
        sampled: Standard deviation by the samples.
        discrepancy: Standard deviation of the machine, as a share of the change of the size.
    """
    half = NINETY * math.hypot(sampled, discrepancy * abs(size - curve.sizes[0]))
    low, high = np.clip([size - half, size + half], np.min(curve.sizes), np.max(curve.sizes))
    return float(low), float(high)


_Named = TypeVar("_Named", bound=NamedFault)


def say(names: list[_Named], name: _Named, *, stands: bool) -> None:
    """Adds a name to what was said; the same as the last one, if that stands, takes its place."""
    if names and stands and names[-1].key == name.key:
        names[-1] = name.model_copy(update={"time": names[-1].time})
    else:
        names.append(name)


def report(
    rows: Mapping[str, np.ndarray],
    name: NamedFault | None,
    last: float | None = None,
    *,
    faults: tuple[str, ...],
    joints: tuple[str, ...],
    empty: float = 0.0,
) -> None:
    """Fills three rows, (joints,) each, of what is said of the joints that a name concerns.

    They are the number of the fault (1 + its place in `faults`, -1 for an unknown change, 0 for
    none), its size, and a third value, `last`, or `empty` without any.
    """
    number, size, third = rows.values()
    number[:], size[:], third[:] = 0.0, 0.0, empty
    if name is not None:
        hit = name.elements(joints)
        number[hit] = -1.0 if name.fault == UNKNOWN else 1.0 + faults.index(name.fault)
        size[hit], third[hit] = name.size or 0.0, empty if last is None else last
