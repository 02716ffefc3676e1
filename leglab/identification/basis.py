"""Quadratic B-spline bases: knots, kind and continuation outside the knots."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from leglab.base.errors import SettingsError
from leglab.identification import checks

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

Kind = Literal["full", "paper"]
Outside = Literal["clamp", "linear", "quadratic"]
MiddlePiece = Literal["corrected", "printed"]
DEGREE = 2


@dataclass(frozen=True, kw_only=True)
class Basis(checks.Settings):
    """Quadratic B-splines over increasing knots (Eq. 9 of Folgheraiter).

    Attributes:
        knots: Knots k_1 < ... < k_p in units of the input; equidistant or not.
        kind: "full" adds two knots at each end and has p + 1 splines, which sum to one on all of
            [k_1, k_p]. "paper" has the p - 3 splines whose support lies within the knots.
        outside: How the basis continues outside the knots: "clamp" holds the value at the end,
            "linear" follows the tangent, "quadratic" the outermost polynomial piece.
        middle_piece: "corrected" is the standard B-spline; "printed" has (u - k_i + dk) in the
            middle piece as Eq. 9 prints it, which jumps at the knots. Equidistant knots only.

    Raises:
        SettingsError: The knots do not increase, are too few, or a choice is unknown.
    """

    owner: ClassVar = "basis"
    knots: tuple[float, ...]
    kind: Kind = "full"
    outside: Outside = "clamp"
    middle_piece: MiddlePiece = "corrected"

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "knots", tuple(float(k) for k in self.knots))
        least = 2 if self.kind == "full" else 6
        if len(self.knots) < least:
            text = f"basis has {len(self.knots)} knots: kind {self.kind!r} needs "
            raise SettingsError(text, given=self.knots, allowed=f"at least {least}")
        for left, right in zip(self.knots, self.knots[1:], strict=False):
            checks.number("basis knot", right, above=left)
        checks.number("basis knot", self.knots[0])
        if self.middle_piece == "printed" and not self.equidistant:
            text = "basis middle_piece is 'printed': needs "
            raise SettingsError(text, given=self.knots, allowed="equidistant knots")

    @classmethod
    def uniform(
        cls,
        lower: float,
        upper: float,
        splines: int,
        *,
        kind: Kind = "full",
        outside: Outside = "clamp",
        middle_piece: MiddlePiece = "corrected",
    ) -> "Basis":
        """Builds a basis of `splines` splines over equidistant knots on [lower, upper]."""
        checks.interval("basis range", (lower, upper))
        knots = np.linspace(lower, upper, _knots_for(splines, kind))
        return cls(knots=tuple(knots), kind=kind, outside=outside, middle_piece=middle_piece)

    @classmethod
    def asinh(
        cls,
        lower: float,
        upper: float,
        splines: int,
        *,
        centre: float = 0.0,
        width: float,
        outside: Outside = "linear",
    ) -> "Basis":
        """Builds a full basis with knots dense around a centre: evenly spaced on an asinh scale.

        Equidistant knots in asinh((x - centre) / width) are dense within about `width` of `centre`
        and sparse far from it, which suits friction and valve overlap around zero.
        """
        checks.interval("basis range", (lower, upper))
        checks.number("basis width", width, above=0.0)
        first, last = (math.asinh((end - centre) / width) for end in (lower, upper))
        grid = centre + width * np.sinh(np.linspace(first, last, _knots_for(splines, "full")))
        grid[0], grid[-1] = lower, upper
        return cls(knots=tuple(grid), outside=outside)

    @property
    def count(self) -> int:
        """Number of splines."""
        return len(self.knots) + 1 if self.kind == "full" else len(self.knots) - 3

    @property
    def equidistant(self) -> bool:
        """True if all gaps between knots agree to 1e-9 of their mean."""
        gaps = np.diff(self.knots)
        return bool(np.all(np.abs(gaps - gaps.mean()) <= 1e-9 * gaps.mean()))

    @property
    def extended_knots(self) -> NDArray[np.float64]:
        """Knots with two more at each end, spaced like the outermost gap, (p + 4,)."""
        k = np.asarray(self.knots)
        head, tail = k[1] - k[0], k[-1] - k[-2]
        return np.concatenate(([k[0] - 2 * head, k[0] - head], k, [k[-1] + tail, k[-1] + 2 * tail]))

    def identity_weights(self) -> NDArray[np.float64]:
        """Returns the weights that make the network the identity (Greville abscissae), (count,)."""
        t = self.extended_knots if self.kind == "full" else np.asarray(self.knots)
        return (t[1 : 1 + self.count] + t[2 : 2 + self.count]) / 2

    def spline(self, weights: ArrayLike, bias: float = 0.0) -> "BSpline":
        """Returns sum_i weights_i N_i + bias as a SciPy spline of degree 2.

        It agrees with the network within the knots; SciPy continues it quadratically outside.

        Args:
            weights: One weight per spline, (count,).
            bias: Added to the output.

        Raises:
            SettingsError: The middle piece is the printed one, which is no spline, or the number
                of weights is wrong.
        """
        from scipy.interpolate import BSpline  # takes half a second

        w = np.asarray(weights, dtype=float)
        if w.shape != (self.count,):
            text = f"weights have shape {w.shape}: must be "
            raise SettingsError(text, given=w.shape, allowed=f"({self.count},)")
        if self.middle_piece == "printed":
            raise SettingsError("basis middle_piece is 'printed': it jumps and is no B-spline")
        if self.kind == "paper":  # the dropped outer splines have weight zero
            w = np.concatenate(([0.0, 0.0], w, [0.0, 0.0]))
        return BSpline(self.extended_knots, w + bias, DEGREE, extrapolate=True)


def _knots_for(splines: int, kind: Kind) -> int:
    checks.whole("basis splines", splines, least=3)
    return splines - 1 if kind == "full" else splines + 3
