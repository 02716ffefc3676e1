"""Decision which fault of a bank explains the samples of a learner, and the fault's report.

It serves abrupt changes (`fault_monitor`) and slow wear (`health`). Sizes, costs and odds of all
faults are computed in C++ (`csrc/monitor`), explained shares, evidence and intervals in Python.
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
        """Returns the log-likelihood ratio of lowering the weighted squared error by `gain`."""
        return gain / (2 * self.correlation)


def explained_share(cost: Any, without: float, noise: float) -> np.ndarray:
    """Returns the share of the squared error beyond noise that a fault removes, within [0, 1].

    Args:
        cost: Weighted sum of squared errors with the fault's shift; a number or an array.
        without: Weighted sum of squared errors without any shift.
        noise: Expected weighted sum for a machine without a fault.
    """
    beyond = without - noise
    gain = np.asarray(without - cost)
    return np.clip(gain / beyond, 0.0, 1.0) if beyond > 0 else np.zeros_like(gain)


@dataclass(frozen=True, kw_only=True, eq=False)
class Explanation:
    """Fit of the faults of a bank to a change, with shares explained and probabilities."""

    bank: FaultBank  #: The bank
    fit: SizeEstimate  #: Latest fit of the bank's curves, with costs summed over all fits
    config: JudgeConfiguration  #: How surely a fault must explain the samples

    @cached_property
    def explained(self) -> np.ndarray:
        """Share of the squared error beyond noise that each curve removes, (curves,)."""
        return explained_share(self.fit.cost, self.fit.without, self.fit.noise)

    @cached_property
    def evidence(self) -> np.ndarray:
        """Log-likelihood ratio of each curve to no change, (curves,)."""
        return np.asarray(self.config.evidence_of(self.fit.without - self.fit.cost))

    @cached_property
    def chance(self) -> np.ndarray:
        """Probability of each pair of fault and element among all of `bank.keys`, (keys,)."""
        return self.odds(self.fit.cost, self.bank.group.tolist())

    def odds(self, cost: np.ndarray, keys: list[int]) -> np.ndarray:
        """Computes the probabilities of faults, (keys,), from costs; curve i has the fault keys[i].

        Odds are computed once from noise and once from the model error of the nominal machine. The
        less decisive of the two are used (`csrc/monitor/fault_fit.h`).
        """
        config, noise = self.config, self.fit.noise
        return chances(cost, keys, config.correlation, config.independent, noise)

    @cached_property
    def best(self) -> int:
        """Index of the curve that fits best."""
        return int(np.argmin(self.fit.cost))

    @property
    def curve(self) -> FaultCurve:
        """The curve that fits best."""
        return self.bank.curves[self.best]

    @property
    def key(self) -> tuple[str, str]:
        """Fault and element of the curve that fits best."""
        return self.curve.fault, self.curve.element

    @cached_property
    def alike(self) -> list[int]:
        """Indices in `bank.keys` of faults within a factor `ALIKE` of the best, best first."""
        order = np.argsort(-self.chance).tolist()
        return [k for k in order if ALIKE * self.chance[k] > self.chance.max()]

    def best_of(self, key: int) -> int:
        """Returns the index of the best-fitting curve of a fault and element."""
        curves = np.flatnonzero(self.bank.group == key)
        return int(curves[np.argmin(self.fit.cost[curves])])

    @property
    def certain(self) -> bool:
        """True if at most `TOLD` faults fit equally well and their total probability suffices."""
        enough = self.chance[self.alike].sum() >= self.config.confidence
        return len(self.alike) <= TOLD and bool(enough)

    def enough(self, explained: float, evidence: float) -> bool:
        """Tests whether the best fault explains the samples well enough to be named.

        Args:
            explained: Least share of the error that the fault must explain, as a fraction of the
                share that a map can represent.
            evidence: Least log-likelihood ratio of the fault to no change.
        """
        return bool(
            self.explained[self.best] >= explained * self.curve.explains
            and self.evidence[self.best] >= evidence
        )

    def told(self) -> dict[str, Any]:
        """Returns all fields of a `NamedFault` for the best fault, except its times."""
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
        """Returns the fields of `told` for an unknown change; `hit`: mask of the joints with it."""
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
    """Combines several fits of one change: sums of the costs, and the sizes of the last fit."""
    together = looks[-1]._replace(
        cost=np.sum([look.cost for look in looks], axis=0),
        without=sum(look.without for look in looks),
        noise=sum(look.noise for look in looks),
    )
    return Explanation(bank=bank, fit=together, config=config)


def interval(
    curve: FaultCurve, size: float, sampled: float, discrepancy: float
) -> tuple[float, float]:
    """Computes the 90 % interval of a size, clipped to the range of the curve.

    The variance is the sum of a variance due to sampling and of one due to model error.

    Args:
        curve: Curve of the fault.
        size: Estimated size.
        sampled: Standard deviation of the size due to sampling.
        discrepancy: Standard deviation due to model error, over the size's difference from healthy.
    """
    half = NINETY * math.hypot(sampled, discrepancy * abs(size - curve.sizes[0]))
    low, high = np.clip([size - half, size + half], np.min(curve.sizes), np.max(curve.sizes))
    return float(low), float(high)


_Named = TypeVar("_Named", bound=NamedFault)


def say(names: list[_Named], name: _Named, *, stands: bool) -> None:
    """Appends a name, or replaces the last name if it `stands` with this key; keeps its time."""
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
    """Fills the three arrays of a report, (joints,) each, at the joints that a name concerns.

    The arrays contain the number of the fault (1 + its index in `faults`, -1 for an unknown change,
    0 without a fault), its size, and a third value: `last`, or `empty` if `last` is None.
    """
    number, size, third = rows.values()
    number[:], size[:], third[:] = 0.0, 0.0, empty
    if name is not None:
        hit = name.elements(joints)
        number[hit] = -1.0 if name.fault == UNKNOWN else 1.0 + faults.index(name.fault)
        size[hit], third[hit] = name.size or 0.0, empty if last is None else last
