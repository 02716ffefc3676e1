"""Persistent faults: keeps their estimated size and follows repair or growth.

From a machine with faults the bank's own curves begin where the machine is, not at a healthy one.
The way back is known better than any simulation knows it: the learner has followed the change on
this very machine, and its parameters moved by what is to be undone.
"""

from dataclasses import dataclass, replace

import numpy as np

from leglab.causes.fault_names import UNKNOWN, FaultName
from leglab.control.feedforward.fault_bank import FaultBank, FaultCurve
from leglab.control.feedforward.thresholds import MOST_STANDING, UNDONE


@dataclass(kw_only=True, eq=False)
class Standing:
    """A change that was noticed, as long as it is not undone."""

    name: FaultName  #: As it was told last; of a fault that has grown, when it last did
    size: float  #: In the fault's own unit; 1 of an unknown change
    healthy: float  #: Size of a machine without it; 0 of an unknown change
    before: np.ndarray  #: Parameters of the map before it, (joints, parameters)
    #: By how much it moved the parameters, (joints, parameters); what is known of it from before
    #: `before`, until `settle`.
    learned: np.ndarray
    settled: bool = False  #: Whether `learned` is all of it: the next change has begun

    def settle(self, now: np.ndarray) -> None:
        """Takes what the learner has made of it until now, (joints, parameters)."""
        if not self.settled:
            self.learned = self.learned + (now - self.before)
            self.settled = True

    def back(self) -> FaultCurve | None:
        """The curve from this size to the healthy one, by what was learned; None without one."""
        if self.size == self.healthy:
            return None
        return FaultCurve(
            fault=self.name.fault,
            element=self.name.element,
            meaning=self.name.meaning,
            sizes=np.array([self.size, self.healthy]),
            shifts=np.stack([np.zeros_like(self.learned), -self.learned]),
            undoes=self.name.onset,
        )


class Standings:
    """The changes that stand, and the bank of what may come next.

    Args:
        bank: Of the healthy machine.
    """

    def __init__(self, bank: FaultBank) -> None:
        from scipy.optimize import nnls  # half a second that other controllers do without

        self._bank, self._nnls = bank, nnls
        self.clear()

    def clear(self) -> None:
        """Forgets all."""
        self._changes: list[Standing] = []
        # Parameters of the map without them.
        self._origin = np.zeros(1)

    def bank(self, now: np.ndarray, regressor: np.ndarray) -> FaultBank:
        """The bank for the change that begins now.

        Args:
            now: Parameters of the map before it, (joints, parameters).
            regressor: Of the samples before it, (n, joints, parameters).
        """
        for change in self._changes:
            change.settle(now)
        self._drop_undone(now, regressor)
        if not self._changes:
            return self._bank
        sizes = {change.name.key: change.size for change in self._changes}
        curves = [_onward(c, sizes.get((c.fault, c.element))) for c in self._bank.curves]
        ways_back = [change.back() for change in self._changes]
        return FaultBank(curves=tuple(c for c in (*curves, *ways_back) if c is not None))

    def _drop_undone(self, now: np.ndarray, regressor: np.ndarray) -> None:
        """Forgets changes that the learner has unlearned since: they went without being noticed.

        What the map predicts now less what it did without them is made of what it learned of each,
        in shares that are not negative.
        """
        if not self._changes:
            return

        def predicted(parameters: np.ndarray) -> np.ndarray:
            return np.einsum("njp,jp->nj", regressor, parameters).ravel()

        learned = [predicted(change.learned) for change in self._changes]
        shares, _ = self._nnls(np.stack(learned, axis=1), predicted(now - self._origin))
        kept = zip(self._changes, shares, strict=True)
        self._changes = [change for change, share in kept if share > 1.0 - UNDONE]

    def add(self, name: FaultName, before: np.ndarray) -> None:
        """Remembers a change that was told, and the map before it, (joints, parameters)."""
        healthy = [c.sizes[0] for c in self._bank.curves if (c.fault, c.element) == name.key]
        change = Standing(
            name=name,
            size=1.0 if name.size is None else name.size,
            healthy=float(healthy[0]) if healthy else 0.0,
            before=before,
            learned=np.zeros_like(before),
        )
        if not self._changes:
            self._origin = before
        earlier = [one for one in self._changes if one.name.key == name.key]
        if earlier and name.fault != UNKNOWN:
            # More of the same: the way back is that of both.
            change.learned = change.learned + earlier[0].learned
            self._changes.remove(earlier[0])
        self._changes.append(change)
        for forgotten in self._changes[:-MOST_STANDING]:
            self._origin = self._origin + forgotten.learned
        self._changes = self._changes[-MOST_STANDING:]

    def undo(self, onset: float, size: float) -> None:
        """Takes back a change as far as its size says."""
        (change,) = [one for one in self._changes if one.name.onset == onset]
        left = (size - change.healthy) / (change.size - change.healthy)
        if left <= 1.0 - UNDONE:
            self._changes.remove(change)
            return
        change.learned = left * change.learned
        change.size = size


def _onward(curve: FaultCurve, size: float | None) -> FaultCurve | None:
    """The rest of a curve for a machine that has a size of it already; None where none is left."""
    if size is None:
        return curve
    side = np.sign(curve.sizes[-1] - curve.sizes[0])
    beyond = side * (curve.sizes - size) > 0.0
    if side * (size - curve.sizes[0]) <= 0.0 or not beyond.any():
        return None  # of the other side of the healthy size, or at the end
    start = curve.shift(size)
    shifts = np.concatenate([np.zeros((1, *start.shape)), curve.shifts[beyond] - start])
    valves = curve.valves_at(size)
    if valves is not None and curve.valves is not None:
        valves = np.concatenate([[0.0 * valves], curve.valves[beyond] - valves])
    sizes = np.concatenate([[size], curve.sizes[beyond]])
    return replace(curve, sizes=sizes, shifts=shifts, valves=valves)
