"""Priors of good machines' deviations, of fault magnitudes, and of the model error's scale."""

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
    """Priors of parameters, of faults, and of the model error's scale."""

    #: Candidate standard deviations of good machines' parameters from the specimen (the machine
    #: as identified), in smallest trial values, all equally probable. A parameter with a tolerance
    #: has its tolerance instead, widened for larger candidates. Candidates beyond `SPREADS` need
    #: healthy recordings and a large fault in the set; otherwise they would explain faults.
    spreads: tuple[float, ...] = SPREADS
    tolerances: float = 1.0  #: Factor on the tolerances
    #: Covariance of single unknowns (one parameter of one element) by healthy recordings, if any.
    covariance: np.ndarray | None = None
    #: Scales of the model error; 0 is an exact model.
    sizes: tuple[float, ...] = SIZES
    #: Log probabilities of `sizes`, (sizes,).
    log_sizes: np.ndarray = field(default_factory=lambda: np.zeros(len(SIZES)))

    @property
    def calibrated(self) -> bool:
        """Tests whether healthy recordings determine the specimen and the model error's scale."""
        return self.covariance is not None

    def force_size(self, place: int) -> float:
        """Returns the model-error scale of forces for the scale `sizes[place]` of replay errors."""
        return max(1.0, self.sizes[place]) if self.calibrated else 1.0

    def usual(self, largest: np.ndarray | float = 0.0) -> np.ndarray:
        """Tests which `spreads` are allowed for the largest fault of a set (in smallest trials)."""
        most = np.maximum(SPREADS[-1], BESIDE * np.asarray(largest))
        return np.asarray(np.array(self.spreads) <= most)

    def precision(self, unknowns: Unknowns, spread: float) -> tuple[np.ndarray, float]:
        """Computes single unknowns' prior precision, (single, single), and its log determinant."""
        n = unknowns.single
        known = self.tolerances * unknowns.tolerance[:n]
        wider = max(1.0, spread / self.spreads[0] * USUAL)
        widest = np.minimum(known * wider, np.maximum(known, spread))
        deviation = np.where(known > 0.0, widest, spread)
        ranges = unknowns.upper[:n] - unknowns.lower[:n]
        # An effect that is not gradual is present or absent, so that it has no small deviations.
        deviation = np.where(unknowns.gradual[:n], deviation, ABSENT)
        deviation = np.where(unknowns.shape[:n], SHAPE_SPREAD * ranges, deviation)
        if self.covariance is None:
            return np.diag(deviation**-2.0), float(-2.0 * np.log(deviation).sum())
        factor = cho_factor(self.covariance + np.diag(deviation**2))
        return cho_solve(factor, np.eye(n)), float(-2.0 * np.log(np.diag(factor[0])).sum())


def log_fault(unknowns: Unknowns, which: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Computes the log prior density of fault magnitudes x of unknowns `which`, shaped as x.

    It is a Cauchy density, in smallest trials, on the sides on which faults lie. A factor vanishes
    at 0, so that evidence for "no fault" also grows with the data (Johnson and Rossell 2010).
    """
    sides = unknowns.above[which].astype(int) + unknowns.below[which]
    square = x**2
    hole = np.log(np.maximum(square / (NO_FAULT**2 + square), 1e-9))
    density = np.pi * FAULT_SIZE * (1.0 + square / FAULT_SIZE**2) * np.maximum(sides, 1) / 2.0
    return np.asarray(hole - np.log(density))


def slab_curvature(x: np.ndarray) -> np.ndarray:
    """Returns slope / x of the negative log Cauchy density: an approximate curvature > 0."""
    return np.asarray(2.0 / (FAULT_SIZE**2 + x**2))
