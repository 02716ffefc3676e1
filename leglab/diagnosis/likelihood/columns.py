"""Errors about a hypothesis and what moves them: tangents of all unknowns, and finite jumps."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.plant.model import Change
from leglab.diagnosis.replay.residual import Problem
from leglab.diagnosis.thresholds import DEFAULT

# An unknown, and by how much it moves at once, in trials.
Jump = tuple[int, float]

# Errors beyond this are those of a replay that blew up [SI units].
BLOWN = 1e11
# Step of first tangents, in trials: effects that are not smooth have none at a smaller one.
COARSE = 0.3
# Step of later ones.
FINE = 0.05
# Of a large departure, the step of its tangent as a share, at the end and at first.
LARGE, LARGE_FIRST = 0.02, 0.1
# Factor on a command that shows what it moves.
LOUDER = 1.02
# Blocks of a window, over which forces are averaged.
BLOCKS = DEFAULT.force_blocks


@dataclass(frozen=True, eq=False)
class Columns:
    """Errors in SI units at a hypothesis, and what moves them.

    Rows of a window are channels x bins of its replay, then joints x blocks of the forces that its
    measured motion leaves over.

    Attributes:
        base: The hypothesis.
        x: Its departures, (unknowns,).
        errors: (windows, rows).
        tangents: Change of the errors by one trial, (windows, rows, unknowns).
        jumps: What was jumped.
        changes: Change of the errors by each jump, (windows, rows, jumps).
    """

    base: Hypothesis
    x: np.ndarray
    errors: np.ndarray
    tangents: np.ndarray
    jumps: tuple[Jump, ...]
    changes: np.ndarray


class Errors:
    """Errors of hypotheses in some windows of a problem.

    Args:
        problem: Recordings and machine.
        unknowns: Its unknowns.
        chosen: Mask of the windows, (all windows,).

    Attributes:
        recording: Of each chosen window, (windows,).
        size: Rows of a window that are replays'; the others are forces'.
    """

    def __init__(self, problem: Problem, unknowns: Unknowns, chosen: np.ndarray) -> None:
        self.problem, self.unknowns, self.chosen = problem, unknowns, chosen
        self.recording = problem.replay.recording[chosen]
        self.size = len(problem.channels) * problem.replay.bins
        self._own_influence: np.ndarray | None = None

    def at(self, hypothesis: Hypothesis, louder: str | None = None) -> np.ndarray:
        """Errors of a hypothesis, (windows, rows).

        Args:
            hypothesis: Effects and what else departs.
            louder: Actuator whose command is `LOUDER` times what was recorded; None for no one.
        """
        problem = self.problem
        change = problem.library.change(hypothesis, problem.replay.machine)
        if louder is not None:
            _louder(change, [louder])
        blocks = BLOCKS if problem.balanced else 0
        found = problem.replay.error(change, chosen=self.chosen, blocks=blocks)
        errors = found.normalised + problem.noise.defect[self.chosen]
        errors = errors.reshape(len(errors), -1)
        if found.left is None:
            return errors
        left = found.left / self._influence(hypothesis, found.left)[:, None]
        return np.concatenate([errors, left.reshape(len(errors), -1)], axis=1)

    def _influence(self, hypothesis: Hypothesis, left: np.ndarray) -> np.ndarray:
        """Influence of the commands on the forces of each joint, over the model's own, (joints,).

        Forces left over along a measured motion count in units of the drive: they say what drive
        the motion takes. A gain of 0, or a friction that eats the drive's force, leaves none over.
        """
        influence = self._commanded(hypothesis, left)
        if self._own_influence is None:
            same = not hypothesis
            self._own_influence = influence if same else self._commanded(Hypothesis(), None)
        own = self._own_influence
        return np.where(
            own > 0.0, np.maximum(influence, 1e-3 * own) / np.where(own > 0, own, 1), 1.0
        )

    def _commanded(self, hypothesis: Hypothesis, left: np.ndarray | None) -> np.ndarray:
        """Change of each joint's forces per log command, root mean square, (joints,)."""
        problem = self.problem
        native = problem.machine.native_actuators()
        if not native:
            return np.zeros(len(problem.balanced))

        def forces(loud: bool) -> np.ndarray:
            change = problem.library.change(hypothesis, problem.replay.machine)
            if loud:
                _louder(change, native)
            return problem.replay.lacking(change, self.chosen, BLOCKS)

        change = forces(True) - (forces(False) if left is None else left)
        return np.sqrt(np.mean(np.clip(change, -BLOWN, BLOWN) ** 2, axis=(0, 2)))

    def tangents(
        self,
        base: Hypothesis,
        errors: np.ndarray,
        which: Iterable[int],
        step: float,
        known: np.ndarray | None = None,
        large: float = LARGE,
    ) -> np.ndarray:
        """Tangents by differences over a step in trials, (windows, rows, unknowns).

        Args:
            base: Where.
            errors: There.
            which: Unknowns to take; tied ones are sums of the single ones.
            step: In trials.
            large: Of a large departure, the step as a share.
            known: Of the others; None for 0.
        """
        u = self.unknowns
        out = np.zeros((*errors.shape, len(u))) if known is None else known.copy()
        x = u.departures(base)
        for i in which:
            if i >= u.single:
                continue
            h = max(step, large * abs(x[i]))
            if x[i] + h > u.upper[i]:
                h = -h
            out[:, :, i] = 0.0
            if x[i] + h < u.lower[i]:
                continue
            moved = self.at(u.moved(base, {i: h}))
            difference = (moved - errors) / h
            difference[np.abs(moved).max(axis=1) > BLOWN] = 0.0
            out[:, :, i] = difference
        index = {places[0]: i for i, places in enumerate(u.places[: u.single])}
        for i in range(u.single, len(u)):
            out[:, :, i] = sum(out[:, :, index[place]] for place in u.places[i])
        return out

    def jumped(self, columns: Columns, jumps: Iterable[Jump]) -> Columns:
        """Columns with further jumps; in windows in which a replay blows up they change nothing."""
        known, new, changes = set(columns.jumps), [], []
        for u, by in jumps:
            if (u, by) in known:
                continue
            moved = self.at(self.unknowns.moved(columns.base, {u: by}))
            change = moved - columns.errors
            change[np.abs(moved).max(axis=1) > BLOWN] = 0.0
            new.append((u, by))
            changes.append(change)
        if not new:
            return columns
        return replace(
            columns,
            jumps=(*columns.jumps, *new),
            changes=np.concatenate([columns.changes, np.stack(changes, axis=2)], axis=2),
        )

    def columns(self, base: Hypothesis, *, step: float, known: np.ndarray | None = None) -> Columns:
        """Errors and all tangents at a hypothesis, without jumps.

        Tangents of shapes whose effects are not there are 0.
        """
        errors = self.at(base)
        u = self.unknowns
        x = u.departures(base)
        there = {u.keys[i] for i in range(u.single) if x[i] != 0.0 and not u.shape[i]}
        which = [i for i in range(u.single) if not u.shape[i] or u.keys[i] in there]
        tangents = self.tangents(base, errors, which, step, known)
        return Columns(base, x, errors, tangents, (), np.zeros((*errors.shape, 0)))


def _louder(change: Change, actuators: Iterable[str]) -> None:
    for actuator in actuators:
        change.commands.setdefault(actuator, []).insert(0, lambda u, _: LOUDER * u)


def trials(unknowns: Unknowns) -> list[Jump]:
    """Jumps to the trials beyond the smallest, which tangents know, of all that can be faults."""
    found: list[Jump] = []
    sites = unknowns.library.sites
    for u in range(len(unknowns)):
        if not unknowns.nameable[u]:
            continue
        sizes = []
        for key, i in unknowns.places[u]:
            p = sites[key].parameters[i]
            sizes.append(sorted(round((t - p.nominal) / p.scale, 6) for t in p.trials))
        # What like parts share goes by the first one's trials.
        found += [
            (u, float(by))
            for by in sizes[0]
            if abs(by) > 1.0 + 1e-6
            and unknowns.lower[u] <= by <= unknowns.upper[u]
            and ((by > 0 and unknowns.above[u]) or (by < 0 and unknowns.below[u]))
        ]
    return found
