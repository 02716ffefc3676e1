"""Priors: how machines are made, how large faults are, how many there are."""

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.thresholds import (
    ABSENT,
    BESIDE,
    FAULT_SIZE,
    NO_FAULT,
    SHAPE_SPREAD,
    SIZES,
    SPREADS,
    USUAL,
)


@dataclass(frozen=True, eq=False)
class Priors:
    """Priors of everything but the errors."""

    #: Standard deviations of good machines about the specimen, in smallest trials, all as probable;
    #: of parameters with a tolerance, that tolerance, and more on machines that depart more. Those
    #: beyond the roughest machines' hold beside a large fault alone, and without healthy recordings
    #: there are none, since a rough machine would buy its own departures by any large fault.
    spreads: tuple[float, ...] = SPREADS
    tolerances: float = 1.0  #: Share of the tolerances that counts
    #: Of all single unknowns, by healthy recordings, (single, single); None without.
    covariance: np.ndarray | None = None
    #: Of the model's own error in its unit size; 0 is an exact model.
    sizes: tuple[float, ...] = SIZES
    #: Log probabilities of these, (sizes,).
    log_sizes: np.ndarray = field(default_factory=lambda: np.zeros(len(SIZES)))

    @property
    def calibrated(self) -> bool:
        """Whether healthy recordings say how the specimen was and how far the model misses it."""
        return self.covariance is not None

    def force_size(self, place: int) -> float:
        """Size of the model's own error in forces, by place of that in replays."""
        return max(1.0, self.sizes[place]) if self.calibrated else 1.0

    def usual(self, largest: np.ndarray | float = 0.0) -> np.ndarray:
        """Mask of the spreads beside a fault of `largest` trials, (..., spreads)."""
        most = np.maximum(SPREADS[-1], BESIDE * np.asarray(largest))
        return np.asarray(np.array(self.spreads) <= most)

    def precision(self, unknowns: Unknowns, spread: float) -> tuple[np.ndarray, float]:
        """Prior precision of the single unknowns, (single, single), and its log determinant."""
        n = unknowns.single
        known = self.tolerances * unknowns.tolerance[:n]
        wider = max(1.0, spread / self.spreads[0] * USUAL)
        widest = np.minimum(known * wider, np.maximum(known, spread))
        deviation = np.where(known > 0.0, widest, spread)
        ranges = unknowns.upper[:n] - unknowns.lower[:n]
        # A moving part is there or is not.
        deviation = np.where(unknowns.gradual[:n], deviation, ABSENT)
        deviation = np.where(unknowns.shape[:n], SHAPE_SPREAD * ranges, deviation)
        if self.covariance is None:
            return np.diag(deviation**-2.0), float(-2.0 * np.log(deviation).sum())
        factor = cho_factor(self.covariance + np.diag(deviation**2))
        return cho_solve(factor, np.eye(n)), float(-2.0 * np.log(np.diag(factor[0])).sum())


def log_fault(unknowns: Unknowns, which: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Log density of faults' departures x in trials; both of one shape.

    Cauchy, on the sides on which faults lie, and none near 0: a prior that allows no fault of no
    size lets evidence grow for "nothing" as well (non-local prior; Johnson and Rossell 2010).
    """
    sides = unknowns.above[which].astype(int) + unknowns.below[which]
    square = x**2
    hole = np.log(np.maximum(square / (NO_FAULT**2 + square), 1e-9))
    density = np.pi * FAULT_SIZE * (1.0 + square / FAULT_SIZE**2) * np.maximum(sides, 1) / 2.0
    return np.asarray(hole - np.log(density))


def slab_curvature(x: np.ndarray) -> np.ndarray:
    """Curvature of the Cauchy density of faults' sizes x, by its weight there: never negative."""
    return np.asarray(2.0 / (FAULT_SIZE**2 + x**2))
