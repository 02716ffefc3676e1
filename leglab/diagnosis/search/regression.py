"""Sets of effects from the balance of forces, by regression: joint by joint, nothing integrated.

Along the measured motion, the force that a joint's drive, gravity and friction leave over is nearly
linear in most parameters, however far they are from where they should be, and no joint's balance
depends on what another joint lacks (inverse dynamic identification; Gautier and Khalil 1992).
A replay of motion tells less where much is missing: any misfit makes a weaker drive look right.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.likelihood.columns import Errors, Jump
from leglab.diagnosis.replay.lacking import balanced_joints, lacking_forces
from leglab.diagnosis.thresholds import COARSE, DEFAULT, EACH_WAY, JOINT_EFFECTS, SCORED


@dataclass(frozen=True)
class Balanced:
    """A set that balances one joint.

    Attributes:
        joint: Whose forces.
        start: Departures of its unknowns.
        left: Share of the square of the forces that it leaves.
        gain: Nats gained over no effect, at one number a window, less half log windows a parameter.
    """

    joint: str
    start: dict[int, float]
    left: float
    gain: float


def forces_of(at: Errors, hypothesis: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
    """Forces along the measured motion, each (windows, joints, moments) [N m or N].

    Those that are left over, and those of the drives.
    """
    problem = at.problem
    replay, joints = problem.replay, balanced_joints(problem.machine, problem.channels)
    change = problem.library.change(hypothesis, replay.machine)
    model = change.variant.model
    dofs = [int(model.joint(joint).dofadr[0]) for joint in joints]
    rows: list[np.ndarray] = []
    drives: list[np.ndarray] = []
    for cut, moments, states in replay.along(change, at.chosen):
        found = lacking_forces(change, moments, states, replay.half)
        for out, force in ((rows, found.lacking), (drives, found.load)):
            out.append(force[:, dofs].reshape(cut.firsts.size, -1, len(dofs)).transpose(0, 2, 1))
    left, drive = np.concatenate(rows), np.concatenate(drives)
    return np.nan_to_num(left, nan=1e12, posinf=1e12, neginf=-1e12), drive


def balanced_sets(at: Errors, jumps: Sequence[Jump]) -> dict[str, list[Balanced]]:
    """Sets that balance each joint best, by joint, best first."""
    u, base = at.unknowns, Hypothesis()
    joints = balanced_joints(at.problem.machine, at.problem.channels)
    if not joints:
        return {}
    jumps = [jump for jump in jumps if jump[0] < u.single]
    if not jumps:
        return {}
    left, drive = forces_of(at, base)
    moved = [forces_of(at, u.moved(base, dict([jump])))[0] - left for jump in jumps]
    stronger = COARSE[1]
    louder = {q: stronger / u.scale[q] for q in range(u.single) if u.keys[q][0] == "actuator_gain"}
    loud = forces_of(at, u.moved(base, louder))[0] if louder else left
    found = {}
    for j, joint in enumerate(joints):
        # Of a joint that rests nothing is learned; the middle of all windows sets the scale.
        size = np.sqrt((left[:, j] ** 2).mean(axis=1))
        scale = np.ones(len(size))
        for r in np.unique(at.recording):
            own = at.recording == r
            scale[own] = max(
                float(np.median(size[own])), DEFAULT.negligible * float(np.median(size)), 1e-12
            )
        weight = 1.0 / np.maximum(scale, size / 3.0)
        y = (left[:, j] * weight[:, None]).ravel()
        columns, scaling = [], []
        for jump, change in zip(jumps, moved, strict=True):
            own = change[:, j]
            share = _proportion(own.ravel(), drive[:, j].ravel()) if louder else 0.0
            if share and jump[0] not in louder:
                # What is in proportion to the drive grows with its gain; other friction does not.
                both = forces_of(at, u.moved(base, {**louder, jump[0]: jump[1]}))[0] - loud
                grown = float((both[:, j] * own).sum() / (own**2).sum()) - 1.0
                share = share if abs(grown - stronger) < DEFAULT.smaller_share * stronger else 0.0
            if share:
                # A gain of 0 leaves no force over, nor does a friction that eats the drive's:
                # regressed on itself the drive explains itself. The motion's force stands for it.
                own = np.sign(own * drive[:, j]) * share * (left[:, j] + drive[:, j])
            columns.append((own * weight[:, None]).ravel())
            scaling.append(share)
        x = np.stack(columns, axis=1)
        sets: dict[frozenset[int], Balanced] = {}
        # A drive that is turned down or late imitates what resists: once with the machine alone.
        machine = [
            i
            for i, (q, _) in enumerate(jumps)
            if scaling[i] == 0.0 and u.effect(q).group in ("friction", "mechanics")
        ]
        for pool in (range(len(jumps)), machine):
            for one in _subsets(joint, y, x, jumps, len(size), pool):
                sets.setdefault(frozenset(one.start), _bent(one, jumps, scaling))
        found[joint] = sorted(sets.values(), key=lambda b: -b.gain)
    return found


def _proportion(change: np.ndarray, drive: np.ndarray) -> float:
    """Proportion of a change of forces to the drive's, (moments,) each; 0 where there is none."""
    moves = np.abs(drive) > DEFAULT.smaller_share * np.abs(drive).max()
    if not drive.any() or not moves.any():
        return 0.0
    ratio = np.abs(change[moves] / drive[moves])
    middle = float(np.median(ratio))
    # Beside reversals, which bend what rubs.
    return middle if np.median(np.abs(ratio - middle)) <= DEFAULT.same * middle else 0.0


def _bent(balanced: Balanced, jumps: Sequence[Jump], scaling: Sequence[float]) -> Balanced:
    """With departures of what scales the drive: 1/(1 + s) for a motion that takes 1 + s as much."""
    share = {(q, by): s for (q, by), s in zip(jumps, scaling, strict=True)}
    start = {}
    for q, value in balanced.start.items():
        by = next(b for (k, b) in jumps if k == q and b * value > 0.0)
        factor = value / by * share[q, by]
        start[q] = value / (1.0 + factor)
    return replace(balanced, start=start)


def _subsets(
    joint: str,
    y: np.ndarray,
    x: np.ndarray,
    jumps: Sequence[Jump],
    windows: int,
    allowed: Iterable[int],
) -> list[Balanced]:
    """The best subsets of some columns with factors above 0, (numbers, columns)."""
    gram, slope, total = x.T @ x, -x.T @ y, float(y @ y)
    every = [i for i in allowed if 1e-8 * total < gram[i, i] < 1e20]

    def fitted(columns: Sequence[int]) -> tuple[float, np.ndarray] | None:
        index = np.array(columns)
        matrix = gram[np.ix_(index, index)]
        try:
            factors = np.linalg.solve(matrix * (1.0 + 1e-9 * np.eye(index.size)), slope[index])
        except np.linalg.LinAlgError:
            return None
        if (factors <= 0.0).any():
            return None
        return max(total - float(slope[index] @ factors), 1e-12 * total), factors

    singles: dict[int, tuple[float, int]] = {}
    for i in every:
        if one := fitted([i]):
            unknown = jumps[i][0]
            if unknown not in singles or one[0] < singles[unknown][0]:
                singles[unknown] = one[0], i
    # Alone a column may have the wrong sign: beside another one it is right.
    best_of: dict[tuple[int, float], int] = {}
    for i in every:
        unknown, by = jumps[i]
        best_of.setdefault((unknown, np.sign(by)), i)
    for unknown, (_, i) in singles.items():
        best_of[unknown, np.sign(jumps[i][1])] = i
    pool = sorted(best_of.values(), key=lambda i: -(max(slope[i], 0.0) ** 2) / gram[i, i])
    sets: list[tuple[float, tuple[int, ...], np.ndarray]] = []
    current: list[tuple[int, ...]] = [()]
    for count in range(1, JOINT_EFFECTS + 1):
        level = []
        starts = (
            combinations(pool, 2)
            if count == 2
            else ((*s, i) for s in current for i in pool if i not in s)
        )
        done = set()
        for columns in starts:
            names = frozenset(columns)
            if names in done or len({jumps[i][0] for i in columns}) < count:
                continue
            done.add(names)
            if one := fitted(columns):
                level.append((one[0], tuple(columns), one[1]))
        level.sort(key=lambda s: s[0])
        current = [s[1] for s in level[: 2 * SCORED]]
        sets += level[:EACH_WAY]
    found = []
    for rest, columns, factors in sets:
        start = {jumps[i][0]: float(f * jumps[i][1]) for i, f in zip(columns, factors, strict=True)}
        gain = 0.5 * windows * np.log(total / rest) - 0.5 * np.log(windows) * len(columns)
        found.append(Balanced(joint, start, rest / total, float(gain)))
    return sorted(found, key=lambda b: -b.gain)
