"""Model error: covariance, up to a scale, of the errors that an inexact model structure causes.

These errors remain at the best parameters. They are correlated in time within a channel, and their
magnitude differs between recordings (Kennedy and O'Hagan 2001).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leglab.diagnosis.likelihood.columns import Errors
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.replay.residual import inverse_roots
from leglab.diagnosis.replay.windows import Channel
from leglab.diagnosis.thresholds import FORCE_BLOCKS, SMALL


def directions_of(machine: Machine, channels: Sequence[Channel]) -> np.ndarray:
    """Returns orthonormal directions in which errors are independent, (channels, channels).

    They are the channels, except for the two chambers of a cylinder. One direction of the chambers
    is the cylinder's force, with errors of the mechanism; the other has those of valves and oil.
    """
    found = np.eye(len(channels))
    for cylinder in machine.cylinders:
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
    """Computes covariance matrices over the bins, scaled to the trace `bins`, and mean squares.

    `errors`, (windows, directions, bins), give covariances, (directions, bins, bins), and mean
    squares, (recordings, directions), which are 0 for recordings without windows. Mean squares are
    medians over windows, because a few windows start in stick-slip or next to a discontinuity.
    """
    windows, directions, bins = errors.shape
    size = np.sqrt((errors**2).mean(axis=2))
    usual = np.zeros((count, directions))
    for r in np.unique(recording):
        usual[r] = np.median(size[recording == r], axis=0)
    scale = np.maximum(usual[recording], 1e-300)
    normal = errors / np.maximum(size, scale)[:, :, None]
    shape = np.einsum("wki,wkj->kij", normal, normal) / windows
    # The fewer the windows, the more correlations of bins are shrunk (Ledoit and Wolf 2004).
    share = bins / (bins + windows)
    diagonal = np.einsum("kii->ki", shape)
    shape = (1.0 - share) * shape
    index = np.arange(bins)
    shape[:, index, index] += share * diagonal
    shape /= np.maximum(diagonal.mean(axis=1), 1e-300)[:, None, None]
    return shape, usual**2


@dataclass(frozen=True, eq=False)
class Spread:
    """Covariance of the model error in each recording, at scale 1."""

    replays: np.ndarray  #: Covariance of replay errors, (recordings, size, size)
    forces: np.ndarray  #: Covariance of residual forces, (recordings, n, n) for n joints x blocks

    @classmethod
    def of(cls, at: Errors, errors: np.ndarray) -> "Spread":
        """Estimates the covariance from errors, (windows, rows), at a linearisation."""
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
        left, blocks = errors[:, at.size :], FORCE_BLOCKS
        joints = left.shape[1] // blocks
        forces = np.zeros((count, joints, blocks, joints, blocks))
        if joints:
            shape, variance = _pattern(left.reshape(-1, joints, blocks), at.recording, count)
            # A joint at rest has no residual force, but no force is exact: a minimum is needed.
            least = SMALL**2 * variance.max(axis=0)
            variance = np.maximum(variance, least + 1e-12)
            for j in range(joints):
                forces[:, j, :, j, :] = variance[:, j, None, None] * shape[j]
        sizes = channels * bins, joints * blocks
        return cls(*(x.reshape(count, n, n) for x, n in zip((replays, forces), sizes, strict=True)))

    def of_recordings(self, which: Sequence[int]) -> "Spread":
        """Returns covariances of other recordings; the i-th is copied from recording `which[i]`."""
        return Spread(self.replays[list(which)], self.forces[list(which)])

    def whitening(self, at: Errors) -> "Whitening":
        """Returns the whitening of the chosen windows' errors for every model-error scale."""
        for known, made in at.whitenings:
            if known is self:
                return made
        sensors = at.problem.noise.whitening[at.chosen]
        windows, n = sensors.shape[:2]
        f = self.forces.shape[1]
        basis, ratio = np.zeros((windows, n + f, n + f)), np.zeros((windows, n))
        for w, (root, r) in enumerate(zip(sensors, at.recording, strict=True)):
            values, vectors = np.linalg.eigh(root @ self.replays[r] @ root.T)
            ratio[w] = np.maximum(values, 0.0)
            basis[w, :n, :n] = vectors.T @ root
        force_log = np.zeros(windows)
        if f:
            roots = inverse_roots(self.forces)
            basis[:, n:, n:] = roots[at.recording]
            logs = np.log(np.einsum("rii->ri", roots)).sum(axis=1)
            force_log = -2.0 * (logs[at.recording] + FORCE_BLOCKS * np.log(at.unit).sum())
        made = Whitening(
            basis=basis,
            ratio=ratio,
            noise=np.einsum("wii->wi", at.covariance),
            own=np.einsum("rii->ri", self.replays)[at.recording],
            log=-2.0 * np.log(np.einsum("wii->wi", sensors)).sum(axis=1),
            force_log=force_log,
        )
        at.whitenings.append((self, made))
        return made


@dataclass(frozen=True, eq=False)
class Whitening:
    """Covariances N + s^2 D (noise + model error) of windows' errors, decomposed for all scales s.

    With N^-1 = L'L and L D L' = Q diag(r) Q', the errors multiplied by Q'L are independent and have
    the variances 1 + s^2 r.
    """

    basis: np.ndarray  #: Block diagonal of Q'L and inverse root of forces, (windows, rows, rows)
    ratio: np.ndarray  #: r, (windows, size)
    noise: np.ndarray  #: Diagonal of N, (windows, size)
    own: np.ndarray  #: Diagonal of D, (windows, size)
    log: np.ndarray  #: Log determinants of N, (windows,)
    force_log: np.ndarray  #: Log determinants of forces, in units of the unchanged model's forces

    def at(self, size: float, forces: float) -> tuple[np.ndarray, np.ndarray]:
        """Returns factors that give errors unit variance, (windows, rows), and log determinants.

        `size` and `forces` are the model-error scales of replays and of residual forces. Residual
        forces have no noise covariance. Their weight is the model error's share of the replays'
        variance, because if the model is exact, residual forces are noise of unknown magnitude.
        """
        n, f = self.ratio.shape[1], self.basis.shape[1] - self.ratio.shape[1]
        variance = 1.0 + size**2 * self.ratio
        share = 1.0 - float(np.mean(self.noise / (self.noise + size**2 * self.own)))
        factors = np.full((len(variance), n + f), np.sqrt(share) / forces)
        factors[:, :n] = 1.0 / np.sqrt(variance)
        log = self.log + np.log(variance).sum(axis=1)
        return factors, log + share * (self.force_log + 2.0 * f * np.log(forces))

    def white(self, errors: np.ndarray, size: float, forces: float) -> np.ndarray:
        """Whitens errors, (windows, rows); arguments as in `at`."""
        factors, _ = self.at(size, forces)
        return factors * (self.basis @ errors[:, :, None])[:, :, 0]
