"""Errors of a model whose structure is only nearly right: their pattern, with a size to be found.

No model of a real machine is exact. What its best parameters leave has a memory in every channel
and a size in every recording (Kennedy and O'Hagan 2001); how much of it there is, nothing included,
is an unknown of the likelihood.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leglab.diagnosis.likelihood.columns import Errors
from leglab.diagnosis.plant.model import CYLINDER, Machine
from leglab.diagnosis.replay.residual import inverse_roots
from leglab.diagnosis.replay.windows import Channel
from leglab.diagnosis.thresholds import DEFAULT, LEAST_FORCE


def directions_of(machine: Machine, channels: Sequence[Channel]) -> np.ndarray:
    """Directions in which errors are independent, orthonormal, (channels, channels).

    The channels, but for the two chambers of a cylinder: what their errors do to its force, which
    the mechanism decides, and what they have in common, which the valve's edges and the oil decide.
    """
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


def _pattern(
    errors: np.ndarray, recording: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Covariance over the bins, of trace `bins`, and mean square by recording.

    The middle of all windows counts: single ones start in stick-slip or beside a jump.

    Args:
        errors: By direction, (windows, directions, bins).
        recording: Of each window.
        count: Of recordings.

    Returns:
        (directions, bins, bins) and (recordings, directions); 0 for recordings without windows.
    """
    windows, directions, bins = errors.shape
    size = np.sqrt((errors**2).mean(axis=2))
    usual = np.zeros((count, directions))
    for r in np.unique(recording):
        usual[r] = np.median(size[recording == r], axis=0)
    scale = np.maximum(usual[recording], 1e-300)
    normal = errors / np.maximum(size, scale)[:, :, None]
    shape = np.einsum("wki,wkj->kij", normal, normal) / windows
    # Few windows say little about how bins go together (Ledoit and Wolf 2004, with a fixed share).
    share = bins / (bins + windows)
    diagonal = np.einsum("kii->ki", shape)
    shape = (1.0 - share) * shape
    index = np.arange(bins)
    shape[:, index, index] += share * diagonal
    shape /= np.maximum(diagonal.mean(axis=1), 1e-300)[:, None, None]
    return shape, usual**2


@dataclass(frozen=True, eq=False)
class Spread:
    """Covariance of the model's own error in every recording, at its unit size.

    Attributes:
        replays: (recordings, size, size).
        forces: (recordings, joints x blocks, joints x blocks).
    """

    replays: np.ndarray
    forces: np.ndarray

    @classmethod
    def of(cls, at: Errors, errors: np.ndarray) -> "Spread":
        """What errors show, (windows, rows)."""
        problem = at.problem
        count, channels = len(problem.series), len(problem.channels)
        bins = problem.replay.bins
        directions = directions_of(problem.machine, problem.channels)
        parts = errors[:, : at.size].reshape(-1, channels, bins)
        turned = np.einsum("kc,wcb->wkb", directions, parts)
        shape, variance = _pattern(turned, at.recording, count)
        replays = np.zeros((count, channels, bins, channels, bins))
        for direction, pattern, own in zip(directions, shape, variance.T, strict=True):
            across = np.outer(direction, direction)[:, None, :, None] * pattern[None, :, None, :]
            replays += own[:, None, None, None, None] * across
        left = errors[:, at.size :]
        joints = left.shape[1] // DEFAULT.force_blocks
        forces = np.zeros((count, joints, DEFAULT.force_blocks, joints, DEFAULT.force_blocks))
        if joints:
            shape, variance = _pattern(
                left.reshape(-1, joints, DEFAULT.force_blocks), at.recording, count
            )
            variance = np.maximum(variance, LEAST_FORCE * variance.max(axis=0) + 1e-12)
            for j in range(joints):
                forces[:, j, :, j, :] = variance[:, j, None, None] * shape[j]
        return cls(
            replays.reshape(count, channels * bins, channels * bins),
            forces.reshape(count, joints * DEFAULT.force_blocks, joints * DEFAULT.force_blocks),
        )

    def of_recordings(self, which: Sequence[int]) -> "Spread":
        """That of other recordings, each with what one of these has."""
        return Spread(self.replays[list(which)], self.forces[list(which)])

    def whiteners(self, at: Errors, size: float, forces: float) -> tuple[np.ndarray, np.ndarray]:
        """Inverse roots of the windows' covariances, and log determinants.

        Forces have no covariance of their sensors': they count by the share of the replays' error
        that is the model's own. Those of an exact model are noise and say nothing. Their log
        determinants are in units of what the model as it is leaves over.

        Args:
            at: Windows.
            size: Of the model's own error in replays, as a factor.
            forces: The same in forces.

        Returns:
            (windows, rows, rows) and (windows,).
        """
        covariance = at.covariance + size**2 * self.replays[at.recording]
        n, f = covariance.shape[1], self.forces.shape[1]
        roots = np.zeros((len(covariance), n + f, n + f))
        roots[:, :n, :n] = inverse_roots(covariance)
        log = -2.0 * np.log(np.einsum("wii->wi", roots[:, :n, :n])).sum(axis=1)
        if f:
            noise = np.einsum("wii->wi", at.covariance)
            own = 1.0 - float(np.mean(noise / np.einsum("wii->wi", covariance)))
            force_roots = inverse_roots(forces**2 * self.forces)[at.recording]
            log -= 2.0 * own * np.log(np.einsum("wii->wi", force_roots)).sum(axis=1)
            log -= 2.0 * own * DEFAULT.force_blocks * np.log(at.unit).sum()
            roots[:, n:, n:] = np.sqrt(own) * force_roots
        return roots, log
