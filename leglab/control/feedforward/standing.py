"""Record of persistent faults with their estimated sizes (magnitudes), and of repair or growth.

For a machine with faults the curves of the bank start at the present sizes, not at healthy ones.
The curve of a repair is not simulated. It is the negative of the parameter shift that the learner
made when the fault appeared on this machine, because the repair undoes this shift.
"""

from dataclasses import dataclass, replace

import numpy as np

from leglab.causes.fault_names import UNKNOWN, FaultName
from leglab.control.feedforward.fault_bank import FaultBank, FaultCurve
from leglab.control.feedforward.thresholds import MOST_STANDING, UNDONE


@dataclass(kw_only=True, eq=False)
class Standing:
    """A detected change that has not been undone."""

    name: FaultName  #: Last report of the fault, which may be a report of its growth
    size: float  #: Size in the unit of the fault; 1 for an unknown change
    healthy: float  #: Size of a machine without the fault; 0 for an unknown change
    before: np.ndarray  #: Parameters of the map before the change, (joints, parameters)
    #: Parameter shift learned because of the fault, (joints, parameters). Before `settle` it has
    #: only the shift learned for an earlier, smaller size of the fault.
    learned: np.ndarray
    settled: bool = False  #: Whether `settle` was called, which happens when the next change begins

    def settle(self, now: np.ndarray) -> None:
        """Completes `learned` with the learner's present parameters, (joints, parameters)."""
        if not self.settled:
            self.learned = self.learned + (now - self.before)
            self.settled = True

    def back(self) -> FaultCurve | None:
        """Returns the curve of a repair, which undoes `learned`; None if `size` is healthy."""
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
    """Persistent changes of the machine, and the fault bank for its next change.

    Args:
        bank: Bank of the healthy machine.
    """

    def __init__(self, bank: FaultBank) -> None:
        from scipy.optimize import nnls  # a slow import, for this controller alone

        self._bank, self._nnls = bank, nnls
        self.clear()

    def clear(self) -> None:
        """Forgets all changes."""
        self._changes: list[Standing] = []
        # Parameters of the map that the machine would have without the changes of `_changes`.
        self._origin = np.zeros(1)

    def bank(self, now: np.ndarray, regressor: np.ndarray) -> FaultBank:
        """Returns the bank for a change that begins now.

        Args:
            now: Parameters of the map just before the new change, (joints, parameters).
            regressor: Regressors of samples before the new change, (n, joints, parameters).
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
        """Forgets changes that disappeared unnoticed, whose shifts the learner has unlearned.

        The effect of all changes on predictions is fitted by the effects of the learned shifts, by
        non-negative least squares. A change whose coefficient is low has disappeared.
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
        """Adds a named change; `before`: parameters before the change, (joints, parameters)."""
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
            # The fault has grown, so a repair undoes both shifts.
            change.learned = change.learned + earlier[0].learned
            self._changes.remove(earlier[0])
        self._changes.append(change)
        for forgotten in self._changes[:-MOST_STANDING]:
            self._origin = self._origin + forgotten.learned
        self._changes = self._changes[-MOST_STANDING:]

    def undo(self, onset: float, size: float) -> None:
        """Reduces the change with this onset to `size`; removes it if it is almost undone."""
        (change,) = [one for one in self._changes if one.name.onset == onset]
        left = (size - change.healthy) / (change.size - change.healthy)
        if left <= 1.0 - UNDONE:
            self._changes.remove(change)
            return
        change.learned = left * change.learned
        change.size = size


def _onward(curve: FaultCurve, size: float | None) -> FaultCurve | None:
    """Returns the rest of a curve beyond the fault's present size; None if nothing is left."""
    if size is None:
        return curve
    side = np.sign(curve.sizes[-1] - curve.sizes[0])
    beyond = side * (curve.sizes - size) > 0.0
    if side * (size - curve.sizes[0]) <= 0.0 or not beyond.any():
        return None  # the size is on the other side of healthy, or the curve's last size
    start = curve.shift(size)
    shifts = np.concatenate([np.zeros((1, *start.shape)), curve.shifts[beyond] - start])
    valves = curve.valves_at(size)
    if valves is not None and curve.valves is not None:
        valves = np.concatenate([[0.0 * valves], curve.valves[beyond] - valves])
    sizes = np.concatenate([[size], curve.sizes[beyond]])
    return replace(curve, sizes=sizes, shifts=shifts, valves=valves)
