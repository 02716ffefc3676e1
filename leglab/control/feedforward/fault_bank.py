"""Bank of faults: how each shifts the parameters of the learned map, along a curve of its sizes."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from leglab.base.errors import LeglabError

# Element of a fault that all cylinders have alike, or that none has for itself.
ALL = "all"

# Name of a change that no fault of a bank explains.
UNKNOWN = "unknown change"


@dataclass(frozen=True, kw_only=True, eq=False)
class FaultCurve:
    """Parameter shifts of one fault of one element, straight between its sizes.

    Attributes:
        fault: Its name, that of the scenario it was made with.
        element: Name of a joint whose cylinder and spring have it, or "all".
        meaning: What the size says, with its unit.
        sizes: Strictly monotone, the healthy one first, (sizes,).
        shifts: Parameters with the fault less those without, (sizes, joints, parameters); zero at
            the healthy size.
        undoes: When the change began that the curve leads back from [s]; None of one that leads
            away from the healthy size. Such a curve has the present size first.

    Raises:
        LeglabError: Shapes do not fit, sizes are not monotone or the first shift is not zero.
    """

    fault: str
    element: str
    meaning: str
    sizes: np.ndarray
    shifts: np.ndarray
    undoes: float | None = None

    def __post_init__(self) -> None:
        where = f"fault {self.fault!r} of {self.element!r}"
        steps = np.diff(self.sizes)
        if len(self.sizes) < 2 or not (np.all(steps > 0) or np.all(steps < 0)):
            raise LeglabError(f"{where}: sizes {np.asarray(self.sizes)!r} are not monotone")
        if self.shifts.ndim != 3 or len(self.shifts) != len(self.sizes):
            raise LeglabError(
                f"{where}: shifts have shape {self.shifts.shape}, allowed is "
                f"({len(self.sizes)}, joints, parameters)"
            )
        if not np.isfinite(self.shifts).all() or np.any(self.shifts[0] != 0):
            raise LeglabError(f"{where}: shifts must be finite, and zero at the healthy size")

    def shift(self, size: float) -> np.ndarray:
        """Shift at a size, (joints, parameters); beyond the ends that of the end."""
        order = np.argsort(self.sizes)
        place = float(np.interp(size, self.sizes[order], order.astype(float)))
        low = min(int(place), len(self.sizes) - 2)
        return self.shifts[low] + (place - low) * (self.shifts[low + 1] - self.shifts[low])


@dataclass(frozen=True, kw_only=True, eq=False)
class Moments:
    """Sums over samples that least squares needs, of all joints.

    Attributes:
        information: Sums of regressor times regressor, (joints, parameters, parameters).
        correlation: Sums of regressor times output, (joints, parameters).
        power: Sums of squared outputs, (joints,).
        count: Samples, (joints,).
    """

    information: np.ndarray
    correlation: np.ndarray
    power: np.ndarray
    count: np.ndarray

    @classmethod
    def of(cls, regressor: np.ndarray, output: np.ndarray, used: np.ndarray) -> "Moments":
        """Sums over samples.

        Args:
            regressor: (n, joints, parameters), zeros where a sample is not used.
            output: (n, joints), likewise.
            used: 1 where a sample counts, else 0, (n, joints).
        """
        by_joint = np.ascontiguousarray(regressor.transpose(1, 0, 2))
        return cls(
            information=by_joint.transpose(0, 2, 1) @ by_joint,
            correlation=np.einsum("njp,nj->jp", regressor, output),
            power=np.einsum("nj,nj->j", output, output),
            count=used.sum(axis=0),
        )

    def __add__(self, other: "Moments") -> "Moments":
        return Moments(
            information=self.information + other.information,
            correlation=self.correlation + other.correlation,
            power=self.power + other.power,
            count=self.count + other.count,
        )

    def __sub__(self, other: "Moments") -> "Moments":
        return Moments(
            information=self.information - other.information,
            correlation=self.correlation - other.correlation,
            power=self.power - other.power,
            count=self.count - other.count,
        )

    def about(self, parameters: np.ndarray) -> "Moments":
        """The sums with what a map already predicts taken off the outputs.

        Args:
            parameters: Of the map, (joints, parameters).
        """
        product = np.einsum("jpq,jq->jp", self.information, parameters)
        power = self.power - np.einsum("jp,jp->j", 2 * self.correlation - product, parameters)
        return Moments(
            information=self.information,
            correlation=self.correlation - product,
            power=np.maximum(power, 0.0),
            count=self.count,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """The best size of each curve of a bank by weighted least squares.

    Attributes:
        size: In the unit of the curve, (curves,).
        spread: Change of size that raises the cost by one, (curves,).
        cost: Weighted sum of squared errors with the shift at that size, (curves,).
        without: The same without any shift.
    """

    size: np.ndarray
    spread: np.ndarray
    cost: np.ndarray
    without: float


@dataclass(frozen=True, kw_only=True, eq=False)
class FaultBank:
    """Curves of many faults for one machine, motion and map.

    Attributes:
        curves: Of one number of joints and parameters.

    Raises:
        LeglabError: There are none, or they differ in shape.
    """

    curves: tuple[FaultCurve, ...]

    def __post_init__(self) -> None:
        shapes = {curve.shifts.shape[1:] for curve in self.curves}
        if len(shapes) != 1:
            raise LeglabError(f"curves of a fault bank have shapes {sorted(shapes)}: need one")

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

    def chances(
        self, cost: np.ndarray, correlation: float, independent: float | None = None
    ) -> np.ndarray:
        """Probability of every fault and element among all of the bank, by likelihood, (keys,).

        What the best fault leaves is partly noise, of which more samples tell more, and partly
        that the machine is not the nominal one, of which they do not. Either has its likelihood:
        that of a known variance, and that of an unknown one, cost^(-n/2), with n errors that differ
        independently. A rival is as unlikely as the weaker of both makes it.

        Args:
            cost: Weighted sum of squared errors of each curve, (curves,).
            correlation: Samples that count as one.
            independent: n; None counts noise alone.
        """
        best_of = np.full(len(self.keys), np.inf)
        np.minimum.at(best_of, self.group, cost)
        least = max(best_of.min(), 1e-300)
        unlikely = (best_of - least) / (2 * correlation)
        if independent is not None:
            structure = 0.5 * independent * np.log(np.maximum(best_of, least) / least)
            unlikely = np.minimum(unlikely, structure)
        weight = np.exp(-unlikely)
        chance: np.ndarray = weight / weight.sum()
        return chance

    def without(self, faults: Sequence[str]) -> "FaultBank":
        """The bank without all curves of some faults.

        Raises:
            LeglabError: A fault is not in the bank, or none is left.
        """
        for fault in faults:
            if fault not in self.faults:
                raise LeglabError(
                    f"fault {fault!r} is not in the bank, which has {', '.join(self.faults)}"
                )
        kept = tuple(curve for curve in self.curves if curve.fault not in faults)
        if not kept:
            raise LeglabError("no fault would be left in the bank")
        return FaultBank(curves=kept)

    @cached_property
    def _nodes(self) -> np.ndarray:
        """Shifts of all sizes of all curves, (joints, nodes, parameters)."""
        return np.ascontiguousarray(
            np.concatenate([curve.shifts for curve in self.curves]).transpose(1, 0, 2)
        )

    @cached_property
    def _sizes(self) -> np.ndarray:
        return np.concatenate([curve.sizes for curve in self.curves])

    @cached_property
    def _segments(self) -> tuple[np.ndarray, np.ndarray]:
        """First node of every straight piece, and the first piece of every curve."""
        counts = np.array([len(curve.sizes) for curve in self.curves])
        starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
        first = np.concatenate(
            [start + np.arange(count - 1) for start, count in zip(starts, counts, strict=True)]
        )
        pieces = np.concatenate([[0], np.cumsum(counts - 1)[:-1]])
        return first, pieces

    def fit(self, moments: Moments, weight: np.ndarray) -> Fit:
        """Finds the size of every curve that fits samples best.

        On a piece D(t) = D_0 + t (D_1 - D_0) of a curve the cost
        sum_j w_j sum (y - phi D_j(t))^2 is a parabola in t, so its least value within [0, 1] is
        in closed form.

        Args:
            moments: Of the samples, about the map before the fault.
            weight: Of the squared errors of each joint, (joints,).
        """
        nodes = self._nodes
        weighted = weight[:, None, None] * moments.information
        image = nodes @ weighted  # (joints, nodes, parameters)
        first, starts = self._segments
        linear = np.einsum("jnp,jp->n", nodes, weight[:, None] * moments.correlation)
        square = np.einsum("jnp,jnp->n", image, nodes)
        cross = np.einsum("jnp,jnp->n", image[:, first], nodes[:, first + 1])
        one, two = first, first + 1
        rise = linear[two] - linear[one] - (cross - square[one])
        bend = np.maximum(square[one] - 2 * cross + square[two], 1e-300)
        share = np.clip(rise / bend, 0.0, 1.0)
        gain = 2 * (linear[one] + share * (linear[two] - linear[one])) - (
            square[one] + 2 * share * (cross - square[one]) + share**2 * bend
        )
        best = np.array(
            [
                start + int(np.argmax(part))
                for start, part in zip(starts, np.split(gain, starts[1:]), strict=True)
            ]
        )
        width = self._sizes[two[best]] - self._sizes[one[best]]
        without = float(weight @ moments.power)
        return Fit(
            size=self._sizes[one[best]] + share[best] * width,
            spread=np.abs(width) / np.sqrt(bend[best]),
            cost=np.maximum(without - gain[best], 0.0),
            without=without,
        )
