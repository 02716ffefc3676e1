"""Bank of faults: for each fault, the shift of the learned map's parameters by its size.

The size of a fault is its magnitude, for example a ratio of leakages. Sums over samples (`Moments`)
and fits are C++ (`csrc/monitor`); the tests compare them with NumPy.
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
    """Parameter shifts of one fault of one element, piecewise linear in the fault's size.

    Raises:
        LeglabError: Shapes do not fit, sizes are not monotone or the first shift is not zero.
    """

    fault: str  #: Name of the fault and of the scenario with which it was simulated
    element: str  #: Name of the joint whose cylinder and spring have the fault, or "all"
    meaning: str  #: Meaning of the size, with its unit
    sizes: np.ndarray  #: Sizes of the fault, strictly monotone, the healthy size first, (sizes,)
    #: Parameters with the fault less the parameters without, (sizes, joints, parameters); zero at
    #: the healthy size.
    shifts: np.ndarray
    #: Valve states relative to healthy valves, (sizes, joints, 5), with the columns of
    #: `AdaptiveFeedforward.valves`; None unless the fault affects valves alone.
    valves: np.ndarray | None = None
    #: Share of the fault's effect that the map's structure can represent: share of the weighted
    #: squared error beyond noise that the shifts removed in the simulation of their fit.
    explains: float = 1.0
    #: For a repair, whose sizes start at the present size of a change: onset [s] of that change.
    #: None for a fault that appears or grows.
    undoes: float | None = None

    def __post_init__(self) -> None:
        where = f"fault {self.fault!r} of {self.element!r}"
        steps = np.diff(self.sizes)
        if len(self.sizes) < 2 or not (np.all(steps > 0) or np.all(steps < 0)):
            text = f"{where}: sizes {np.asarray(self.sizes)!r} are not "
            raise ModelError(text, given=self.sizes, allowed="monotone")
        if self.shifts.ndim != 3 or len(self.shifts) != len(self.sizes):
            text = f"{where}: shifts have shape {self.shifts.shape}, allowed is "
            wanted = f"({len(self.sizes)}, joints, parameters)"
            raise ModelError(text, given=self.shifts.shape, allowed=wanted)
        if not np.isfinite(self.shifts).all() or np.any(self.shifts[0] != 0):
            raise ModelError(f"{where}: shifts must be finite, and zero at the healthy size")

    def shift(self, size: float) -> np.ndarray:
        """Interpolates the shift at a size, (joints, parameters); constant beyond `sizes`."""
        return self._at(size, self.shifts)

    def valves_at(self, size: float) -> np.ndarray | None:
        """Interpolates the valve state at a size, (joints, 5); None if the curve has none."""
        return None if self.valves is None else self._at(size, self.valves)

    def _at(self, size: float, nodes: np.ndarray) -> np.ndarray:
        order = np.argsort(self.sizes)
        place = float(np.interp(size, self.sizes[order], order.astype(float)))
        low = min(int(place), len(self.sizes) - 2)
        between: np.ndarray = nodes[low] + (place - low) * (nodes[low + 1] - nodes[low])
        return between


class SizeEstimate(NamedTuple):
    """Sizes fitted to each curve of a bank by weighted least squares.

    Attributes:
        size: Best size, in the unit of the curve, (curves,).
        spread: Difference from the best size that raises the cost by one, (curves,).
        cost: Weighted sum of squared errors with the shift at the best size, (curves,).
        without: Weighted sum of squared errors without any shift.
        noise: Expected weighted sum of squared errors of a machine that has not changed.
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
        LeglabError: There are no curves, or their numbers of joints or parameters differ.
    """

    curves: tuple[FaultCurve, ...]  #: Curves with equal numbers of joints and parameters

    def __post_init__(self) -> None:
        shapes = {curve.shifts.shape[1:] for curve in self.curves}
        if len(shapes) != 1:
            text = f"curves of a fault bank have shapes {sorted(shapes)}: need "
            raise ModelError(text, given=sorted(shapes), allowed="one")

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of the faults without repeats, in the order of the curves."""
        return tuple(dict.fromkeys(curve.fault for curve in self.curves))

    @cached_property
    def keys(self) -> tuple[tuple[str, str], ...]:
        """Pairs of fault and element without repeats, in the order of the curves."""
        return tuple(dict.fromkeys((curve.fault, curve.element) for curve in self.curves))

    @cached_property
    def group(self) -> np.ndarray:
        """Index in `keys` of the fault and element of each curve, (curves,)."""
        return np.array([self.keys.index((c.fault, c.element)) for c in self.curves])

    def without(self, faults: Sequence[str]) -> "FaultBank":
        """Returns the bank without the curves of some faults.

        Raises:
            LeglabError: A fault is not in the bank, or none is left.
        """
        for fault in faults:
            if fault not in self.faults:
                text = f"fault {fault!r} is not in the bank, which has "
                raise SettingsError(text, given=fault, allowed=self.faults)
        kept = tuple(curve for curve in self.curves if curve.fault not in faults)
        if not kept:
            raise SettingsError("no fault would be left in the bank")
        return FaultBank(curves=kept)

    @cached_property
    def core(self) -> Bank:
        """The curves as an object of the C++ core."""
        return Bank(
            [np.ascontiguousarray(curve.sizes, dtype=float) for curve in self.curves],
            [np.ascontiguousarray(curve.shifts, dtype=float) for curve in self.curves],
        )

    def fit(
        self, moments: Moments, normal: np.ndarray, discrepancy: float, joint: int = -1
    ) -> SizeEstimate:
        """Fits the size of every curve to samples by weighted least squares.

        Args:
            moments: Sums over the samples, relative to the map before the fault.
            normal: Mean squared errors of the map before the fault, without the fault, (joints,).
            discrepancy: Standard deviation of the share of the error that the true fault leaves.
            joint: Index of the joint whose samples are used; -1 for all joints.
        """
        return SizeEstimate(*self.core.fit(moments, normal, discrepancy, joint))
