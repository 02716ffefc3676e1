"""Errors of a model whose structure is only nearly right, beside the noise of its sensors.

No model of a real machine is exact: with its best parameters it misses the recordings by many noise
levels, and judged by noise alone every explanation is as bad as any other. The errors of the best
fit so far say how far the model is to be trusted, channel by channel and recording by recording
(Kennedy and O'Hagan 2001); as explanations get better, so does the trust.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leglab.diagnosis.plant.model import CYLINDER, Machine
from leglab.diagnosis.replay.windows import Channel


@dataclass(frozen=True, kw_only=True, eq=False)
class Discrepancy:
    """Covariance of the model's own error in a window: a shape by direction, a size by recording.

    Directions are the channels, but for the two chambers of a cylinder: what their errors do to its
    force, which the mechanism decides, and what they have in common, which the valve's edges and
    the oil decide, have different sizes.

    Attributes:
        directions: Orthonormal, (channels, channels): each row one as a sum of channels.
        pattern: Covariance over the bins of a window, of trace `bins`, (channels, bins, bins):
            model errors have a memory of their own in every direction.
        variance: Mean over the bins, (recordings, channels), of every direction.
        forces: The same of the forces that the measured motion leaves over, whose channels are
            joints; None where no joint's forces can be known.
    """

    directions: np.ndarray
    pattern: np.ndarray
    variance: np.ndarray
    forces: "Discrepancy | None" = None

    def covariance(self, recording: np.ndarray) -> np.ndarray:
        """Covariance of windows of recordings, shape (windows, size, size)."""
        channels, bins, _ = self.pattern.shape
        whole = np.zeros((len(self.variance), channels, bins, channels, bins))
        for direction, pattern, variance in zip(
            self.directions, self.pattern, self.variance.T, strict=True
        ):
            together = np.outer(direction, direction)[:, None, :, None] * pattern[None, :, None, :]
            whole += variance[:, None, None, None, None] * together
        return whole.reshape(len(whole), channels * bins, channels * bins)[recording]

    def scaled(self, factor: float, *, forces: bool = False) -> "Discrepancy":
        """The same with all variances multiplied, those of forces only if `forces`."""
        other = self.forces
        if forces and other is not None:
            other = other.scaled(factor)
        return replace(self, variance=factor * self.variance, forces=other)

    def of(self, recordings: Sequence[int]) -> "Discrepancy":
        """That of other recordings, each with the variances of one of these."""
        forces = None if self.forces is None else self.forces.of(recordings)
        return replace(self, variance=self.variance[list(recordings)], forces=forces)

    def at_least(self, floor: "Discrepancy | None") -> "Discrepancy":
        """The same, in no recording and channel below a floor's."""
        if floor is None:
            return self
        forces = None if self.forces is None else self.forces.at_least(floor.forces)
        variance = np.maximum(self.variance, floor.variance)
        return replace(self, variance=variance, forces=forces)


def directions_of(machine: Machine, channels: Sequence[Channel]) -> np.ndarray:
    """Directions of a discrepancy, (channels, channels), as `Discrepancy` has them."""
    found = np.eye(len(channels))
    for cylinder in machine.instances(CYLINDER):
        own = sorted((c.chamber or "", k) for k, c in enumerate(channels) if c.cylinder == cylinder)
        chambers = [k for _, k in own]
        if len(chambers) < 2:
            continue
        bore, rod = (machine.parameter(cylinder, name) for name in ("bore", "rod"))
        areas = np.array([bore**2, bore**2 - rod**2])
        cap, ring = areas / np.linalg.norm(areas)
        found[np.ix_(chambers, chambers)] = [[cap, -ring], [ring, cap]]
    return found


def from_errors(
    errors: np.ndarray, recording: np.ndarray, excess: np.ndarray, directions: np.ndarray
) -> Discrepancy:
    """The discrepancy that errors of a fitted model show.

    Args:
        errors: Measured less predicted, shape (windows, channels, bins).
        recording: Of each window, shape (windows,).
        excess: Share of the errors' variance that sensors do not explain, (recordings, channels).
        directions: As of `Discrepancy`.
    """
    excess = excess @ (directions**2).T
    errors = np.einsum("kc,wcb->wkb", directions, errors)
    windows, _, bins = errors.shape
    # The middle of all windows counts: single ones start in stick-slip or beside a jump.
    size = np.sqrt((errors**2).mean(axis=2))
    usual = np.stack([np.median(size[recording == r], axis=0) for r in np.unique(recording)])
    places = np.searchsorted(np.unique(recording), recording)
    scale = np.maximum(usual[places], 1e-300)
    normal = errors / np.maximum(size, scale)[:, :, None]
    shape = np.einsum("wki,wkj->kij", normal, normal) / windows
    # Few windows say little about how bins go together (Ledoit and Wolf 2004, with a fixed share).
    share = bins / (bins + windows)
    diagonal = np.einsum("kii->ki", shape)
    shape = (1.0 - share) * shape
    index = np.arange(bins)
    shape[:, index, index] += share * diagonal
    shape /= diagonal.mean(axis=1)[:, None, None]
    return Discrepancy(directions=directions, pattern=shape, variance=excess * usual**2)
