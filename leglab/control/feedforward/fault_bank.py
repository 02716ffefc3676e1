"""Bank of faults: how each shifts the parameters of the learned map, along a curve of its sizes.

Sums over samples (`Moments`) and fits are C++ (`csrc/monitor`); the tests say the same in NumPy.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from leglab._native.monitor import Bank, Moments
from leglab.base.errors import ModelError, SettingsError


@dataclass(frozen=True, kw_only=True, eq=False)
class FaultCurve:
    """Parameter shifts of one fault of one element, straight between its sizes.

    Raises:
        LeglabError: Shapes do not fit, sizes are not monotone or the first shift is not zero.
    """

    fault: str  #: Its name, that of the scenario it was made with
    element: str  #: Name of a joint whose cylinder and spring have it, or "all"
    meaning: str  #: What the size says, with its unit
    sizes: np.ndarray  #: Strictly monotone, the healthy one first, (sizes,)
    #: Parameters with the fault less those without, (sizes, joints, parameters); zero at the
    #: healthy size.
    shifts: np.ndarray
    #: State of the valves beyond that of healthy ones, (sizes, joints, 5), as of
    #: `AdaptiveFeedforward.valves`; None of a fault that is none of valves alone.
    valves: np.ndarray | None = None
    #: Share of the weighted squared error beyond noise that the shifts took away where they were
    #: made: what a map of this structure can say of the fault.
    explains: float = 1.0
    #: When the change began that the curve leads back from [s]; None of one that leads away from
    #: the healthy size. Such a curve has the present size first.
    undoes: float | None = None

    def __post_init__(self) -> None:
        where = f"fault {self.fault!r} of {self.element!r}"
        steps = np.diff(self.sizes)
        if len(self.sizes) < 2 or not (np.all(steps > 0) or np.all(steps < 0)):
            told = f"{where}: sizes {np.asarray(self.sizes)!r} are not "
            raise ModelError(told, given=self.sizes, allowed="monotone")
        if self.shifts.ndim != 3 or len(self.shifts) != len(self.sizes):
            told = f"{where}: shifts have shape {self.shifts.shape}, allowed is "
            wanted = f"({len(self.sizes)}, joints, parameters)"
            raise ModelError(told, given=self.shifts.shape, allowed=wanted)
        if not np.isfinite(self.shifts).all() or np.any(self.shifts[0] != 0):
            raise ModelError(f"{where}: shifts must be finite, and zero at the healthy size")

    def shift(self, size: float) -> np.ndarray:
        """Shift at a size, (joints, parameters); beyond the ends that of the end."""
        return self._at(size, self.shifts)

    def valves_at(self, size: float) -> np.ndarray | None:
        """State of the valves at a size, (joints, 5), likewise."""
        return None if self.valves is None else self._at(size, self.valves)

    def _at(self, size: float, nodes: np.ndarray) -> np.ndarray:
        order = np.argsort(self.sizes)
        place = float(np.interp(size, self.sizes[order], order.astype(float)))
        low = min(int(place), len(self.sizes) - 2)
        between: np.ndarray = nodes[low] + (place - low) * (nodes[low + 1] - nodes[low])
        return between


class SizeEstimate(NamedTuple):
    """The best size of each curve of a bank by weighted least squares.

    Attributes:
        size: In the unit of the curve, (curves,).
        spread: Change of size that raises the cost by one, (curves,).
        cost: Weighted sum of squared errors with the shift at that size, (curves,).
        without: The same without any shift.
        noise: What it would be of a machine that had not changed.
    """

    size: np.ndarray
    spread: np.ndarray
    cost: np.ndarray
    without: float
    noise: float


@dataclass(frozen=True, kw_only=True, eq=False)
class FaultBank:
    """Curves of many faults for one machine, motion and map.

    Raises:
        LeglabError: There are none, or they differ in shape.
    """

    curves: tuple[FaultCurve, ...]  #: Of one number of joints and parameters

    def __post_init__(self) -> None:
        shapes = {curve.shifts.shape[1:] for curve in self.curves}
        if len(shapes) != 1:
            told = f"curves of a fault bank have shapes {sorted(shapes)}: need "
            raise ModelError(told, given=sorted(shapes), allowed="one")

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of the faults, in the order of their first curves."""
        return tuple(dict.fromkeys(curve.fault for curve in self.curves))

    @cached_property
    def keys(self) -> tuple[tuple[str, str], ...]:
        """Fault and element of the curves, each once, in the order of their first curves."""
        return tuple(dict.fromkeys((curve.fault, curve.element) for curve in self.curves))

    @cached_property
    def group(self) -> np.ndarray:
        """Place of every curve's fault and element in `keys`, (curves,)."""
        return np.array([self.keys.index((c.fault, c.element)) for c in self.curves])

    def without(self, faults: Sequence[str]) -> "FaultBank":
        """The bank without all curves of some faults.

        Raises:
            LeglabError: A fault is not in the bank, or none is left.
        """
        for fault in faults:
            if fault not in self.faults:
                told = f"fault {fault!r} is not in the bank, which has "
                raise SettingsError(told, given=fault, allowed=self.faults)
        kept = tuple(curve for curve in self.curves if curve.fault not in faults)
        if not kept:
            raise SettingsError("no fault would be left in the bank")
        return FaultBank(curves=kept)

    @cached_property
    def core(self) -> Bank:
        """The curves for the compiled core."""
        return Bank(
            [np.ascontiguousarray(curve.sizes, dtype=float) for curve in self.curves],
            [np.ascontiguousarray(curve.shifts, dtype=float) for curve in self.curves],
        )

    def fit(
        self, moments: Moments, normal: np.ndarray, discrepancy: float, joint: int = -1
    ) -> SizeEstimate:
        """Finds the size of every curve that fits samples best.

        Args:
            moments: Of the samples, about the map before the fault.
            normal: Mean square errors of that map before it, (joints,).
            discrepancy: Share of the error that a right fault leaves; a deviation.
            joint: Whose samples count alone; those of all where it is -1.
        """
        return SizeEstimate(*self.core.fit(moments, normal, discrepancy, joint))
