"""Sets of effects by regression of residual forces, joint by joint, without integration.

Along the measured motion the residual force is nearly linear in most parameters, and no joint's
balance depends on effects missing at another joint (Gautier and Khalil 1992). Replays far from the
true model say less, as any misfit makes a weaker drive seem more probable. Jumps are finite steps.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.likelihood.columns import Errors, Jump
from leglab.diagnosis.plant.moments import dofs
from leglab.diagnosis.replay.lacking import lacking_forces
from leglab.diagnosis.thresholds import (
    COARSE,
    EACH_WAY,
    JOINT_EFFECTS,
    NEGLIGIBLE,
    SAME,
    SCORED,
    SMALL,
)


@dataclass(frozen=True)
class Balanced:
    """A set of effects that reduces the residual forces of one joint."""

    start: dict[int, float]  #: Departures of the set's unknowns
    #: Log-likelihood gain [nats], one datum per window, less log(windows)/2 per parameter.
    gain: float


def balanced_sets(at: Errors, jumps: Sequence[Jump]) -> dict[str, list[Balanced]]:
    """Returns by joint the sets of effects that leave the least residual force, best first."""
    u, base, joints = at.unknowns, Hypothesis(), at.problem.balanced
    jumps = [jump for jump in jumps if jump[0] < u.single]
    if not joints or not jumps:
        return {}
    left, drive = _forces(at, base)
    moved = [_forces(at, u.moved(base, dict([jump])))[0] - left for jump in jumps]
    stronger = COARSE[1]
    louder = {q: stronger / u.scale[q] for q in range(u.single) if u.keys[q][0] == "actuator_gain"}
    loud = _forces(at, u.moved(base, louder))[0] if louder else left
    found = {}
    for j, joint in enumerate(joints):
        # Forces are divided by their median RMS in a recording, bounded below for joints at rest.
        size = np.sqrt((left[:, j] ** 2).mean(axis=1))
        least = max(NEGLIGIBLE * float(np.median(size)), 1e-12)
        scale = np.ones(len(size))
        for r in np.unique(at.recording):
            own = at.recording == r
            scale[own] = max(float(np.median(size[own])), least)
        weight = 1.0 / np.maximum(scale, size / 3.0)
        y = (left[:, j] * weight[:, None]).ravel()
        columns, scaling = [], []
        for jump, change in zip(jumps, moved, strict=True):
            own = change[:, j]
            share = _proportion(own.ravel(), drive[:, j].ravel()) if louder else 0.0
            if share and jump[0] not in louder:
                # Friction in proportion to the drive's force grows with the drive's gain; dry and
                # viscous friction do not.
                both = _forces(at, u.moved(base, {**louder, jump[0]: jump[1]}))[0] - loud
                grown = float((both[:, j] * own).sum() / (own**2).sum()) - 1.0
                share = share if abs(grown - stronger) < SMALL * stronger else 0.0
            if share:
                # A multiple of the drive's force could cancel that force and leave no residual. So
                # the change is fitted as a multiple of the force that the measured motion requires.
                own = np.sign(own * drive[:, j]) * share * (left[:, j] + drive[:, j])
            columns.append((own * weight[:, None]).ravel())
            scaling.append(share)
        x = np.stack(columns, axis=1)
        # A weak or late drive resembles resistance, so friction and mechanics are also tried alone.
        resists = [u.effect(q).group in ("friction", "mechanics") for q, _ in jumps]
        machine = [i for i, share in enumerate(scaling) if share == 0.0 and resists[i]]
        sets: dict[frozenset[int], Balanced] = {}
        for pool in (range(len(jumps)), machine):
            for one in _subsets(y, x, jumps, scaling, len(size), pool):
                sets.setdefault(frozenset(one.start), one)
        found[joint] = sorted(sets.values(), key=lambda b: -b.gain)
    return found


def _forces(at: Errors, hypothesis: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
    """Computes residual and drive forces [N m or N], (windows, joints, moments) each."""
    problem, replay = at.problem, at.problem.replay
    change = problem.library.change(hypothesis, replay.machine)
    own = dofs(change.variant.model, problem.balanced)
    parts = []
    for cut, moments, states in replay.along(change, at.chosen):
        found = lacking_forces(change, moments, states, replay.half)
        both = np.stack([found.lacking, found.load])[:, :, own]
        parts.append(both.reshape(2, cut.firsts.size, -1, len(own)).swapaxes(2, 3))
    left, drive = np.concatenate(parts, axis=1)
    return np.nan_to_num(left, nan=1e12, posinf=1e12, neginf=-1e12), drive


def _proportion(change: np.ndarray, drive: np.ndarray) -> float:
    """Returns the ratio of a force change to the drive's force if the ratio is constant, else 0."""
    moves = np.abs(drive) > SMALL * np.abs(drive).max()
    if not moves.any():
        return 0.0
    ratio = np.abs(change[moves] / drive[moves])
    middle = float(np.median(ratio))
    # The median ignores samples at reversals of motion, at which friction is nonlinear.
    return middle if np.median(np.abs(ratio - middle)) <= SAME * middle else 0.0


def _subsets(
    y: np.ndarray,
    x: np.ndarray,
    jumps: Sequence[Jump],
    scaling: Sequence[float],
    windows: int,
    allowed: Iterable[int],
) -> list[Balanced]:
    """Finds sets of columns of `x` (the force's changes by jumps) whose sum best cancels `y`."""
    gram, slope, total = x.T @ x, -x.T @ y, float(y @ y)
    every = [i for i in allowed if 1e-8 * total < gram[i, i] < 1e20]

    def fitted(columns: tuple[int, ...]) -> tuple[float, tuple[int, ...], np.ndarray] | None:
        """Returns squared residual, columns, factors; None for a shared unknown or factor <= 0."""
        if len({jumps[i][0] for i in columns}) < len(columns):
            return None
        index = np.array(columns)
        matrix = gram[np.ix_(index, index)] * (1.0 + 1e-9 * np.eye(index.size))
        factors = np.linalg.solve(matrix, slope[index])
        if (factors <= 0.0).any():
            return None
        return max(total - float(slope[index] @ factors), 1e-12 * total), columns, factors

    # A column whose factor is negative alone may have a positive factor with another column.
    best_of: dict[tuple[int, float], int] = {}
    for i in every:
        best_of.setdefault((jumps[i][0], np.sign(jumps[i][1])), i)
    alone = sorted((one[:2] for i in every if (one := fitted((i,)))), reverse=True)
    leaders = {jumps[i][0]: i for _, (i,) in alone}
    best_of |= {(q, np.sign(jumps[i][1])): i for q, i in leaders.items()}
    pool = sorted(best_of.values(), key=lambda i: -(max(slope[i], 0.0) ** 2) / gram[i, i])
    sets: list[tuple[float, tuple[int, ...], np.ndarray]] = []
    current: list[tuple[int, ...]] = [()]
    for count in range(1, JOINT_EFFECTS + 1):
        grown = ((*s, i) for s in current for i in pool if i not in s)
        distinct: dict[frozenset[int], tuple[int, ...]] = {}
        for columns in combinations(pool, 2) if count == 2 else grown:
            distinct.setdefault(frozenset(columns), columns)
        level = [one for columns in distinct.values() if (one := fitted(columns))]
        level.sort(key=lambda s: s[0])
        current = [s[1] for s in level[: 2 * SCORED]]
        sets += level[:EACH_WAY]
    # A force in proportion to the drive was fitted as the share s of the force that the motion
    # requires. As a share of the drive's force, it is s/(1 + s).
    scales: dict[tuple[int, bool], tuple[float, float]] = {}
    for (q, by), share in zip(jumps, scaling, strict=True):
        scales.setdefault((q, by > 0.0), (by, share))
    found = []
    for rest, columns, factors in sets:
        start = {}
        for i, factor in zip(columns, factors, strict=True):
            q, value = jumps[i][0], float(factor * jumps[i][1])
            by, share = scales[q, value > 0.0]
            start[q] = value / (1.0 + value / by * share)
        gain = 0.5 * windows * np.log(total / rest) - 0.5 * np.log(windows) * len(columns)
        found.append(Balanced(start, float(gain)))
    return sorted(found, key=lambda b: -b.gain)
