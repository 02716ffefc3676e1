"""Linearisation of errors: derivatives by unknowns (tangents), changes by finite steps (jumps)."""

import gc
import signal
from collections import deque
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import cached_property
from multiprocessing import current_process, get_context
from typing import Any

import numpy as np

from leglab.base.errors import SimulationError
from leglab.base.scale import rms
from leglab.diagnosis.effects.hypothesis import Hypothesis, Key
from leglab.diagnosis.likelihood.twins import twins
from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.replay.residual import Problem
from leglab.diagnosis.thresholds import BLOWN, LOUDER, NEGLIGIBLE

# Name of the effect that scales a drive's force.
DRIVE_GAIN = "actuator_gain"
# Names of the effects that limit a drive's command, and a drive's force on a joint.
COMMAND_LIMIT, FORCE_LIMIT = "command_saturation", "force_saturation"
# Finite step of an unknown: index of the unknown, step in multiples of the smallest trial value.
Jump = tuple[int, float]


@dataclass(frozen=True, eq=False)
class Columns:
    """Errors at a hypothesis, in SI units, and the changes of the errors if the unknowns change.

    Each window has a row of errors: first those of its replay (channels x bins of time), then the
    residual forces along the measured motion (joints x blocks of time).
    """

    base: Hypothesis  #: Hypothesis at which the errors are linearised
    x: np.ndarray  #: Departures of `base` from the specimen, (unknowns,)
    errors: np.ndarray  #: Errors of `base`, (windows, rows)
    tangents: np.ndarray  #: Derivatives of the errors by unknowns, (windows, rows, unknowns)
    jumps: tuple[Jump, ...]  #: Finite steps of unknowns, see `changes`
    changes: np.ndarray  #: Change of the errors by each jump, (windows, rows, jumps)
    #: Whether derivatives by unknowns that the data determine are differences over `FINE` steps.
    fine: bool = False


class Errors:
    """Errors of hypotheses in the windows of a problem that the mask `chosen` selects.

    Attributes:
        recording: Recording of each chosen window, (windows,).
        size: Number of replay errors per window; residual forces follow the replay errors.
    """

    def __init__(self, problem: Problem, unknowns: Unknowns, chosen: np.ndarray) -> None:
        self.problem, self.unknowns, self.chosen = problem, unknowns, chosen
        self.recording = problem.replay.recording[chosen]
        self.size = len(problem.channels) * problem.replay.bins
        self._workers: ProcessPoolExecutor | None = None
        # Cached whitenings of the last two model-error covariances, which a fit uses many times.
        self.whitenings: deque[tuple[object, Any]] = deque(maxlen=2)

    def about(self, hypothesis: Hypothesis) -> "Errors":
        """Returns a copy whose noise model is linearised at a hypothesis."""
        other = Errors(self.problem.about(hypothesis), self.unknowns, self.chosen)
        other.__dict__["_own"] = self._own  # independent of the noise model
        return other

    def some(self, own: np.ndarray) -> "Errors":
        """Returns a copy with a subset of the chosen windows, by a mask over the chosen windows."""
        chosen = np.zeros_like(self.chosen)
        chosen[np.flatnonzero(self.chosen)[own]] = True
        return Errors(self.problem, self.unknowns, chosen)

    def each(self, hypotheses: Sequence[Hypothesis]) -> list[np.ndarray]:
        """Computes errors of hypotheses in parallel processes, since half of a replay is Python."""
        count = min(self.problem.threads, len(hypotheses))
        if count < 2 or current_process().daemon:  # a worker of Dask cannot start processes
            return [self.at(h) for h in hypotheses]
        if self._workers is None:
            # Forked processes share the memory of this object, so nothing has to be sent.
            _ = self._own
            self._workers = ProcessPoolExecutor(
                self.problem.threads, get_context("fork"), _begin, (self,)
            )
            # Workers must not free inherited objects: destructors would end threads of an earlier
            # diagnosis, which belong to the parent process.
            gc.freeze()
            self._workers.submit(bool)  # starts all processes
            gc.unfreeze()
        portion = max(1, len(hypotheses) // (4 * count))
        try:
            made = list(self._workers.map(_errors, hypotheses, chunksize=portion))
        except BrokenProcessPool as error:
            raise SimulationError(
                "a process that replays was killed, perhaps for want of memory; with "
                "OMP_NUM_THREADS=1 there is one process alone"
            ) from error
        except BaseException:
            self._workers.shutdown(wait=False, cancel_futures=True)
            self._workers = None
            raise
        self.problem.replay.rollouts += sum(replays for _, replays in made)
        return [errors for errors, _ in made]

    def at(self, hypothesis: Hypothesis, louder: str | None = None) -> np.ndarray:
        """Computes errors of a hypothesis, (windows, rows).

        `louder` names an actuator whose gain is multiplied by `LOUDER`. If the library has no gain
        effect for it, the command is multiplied: a servo's motion grows with its command.
        """
        problem = self.problem
        gain = (DRIVE_GAIN, louder or "")
        scaled = gain in problem.library.sites
        if scaled:
            own = hypothesis.get(gain, problem.library.sites[gain].nominal)
            hypothesis = hypothesis.with_values(gain, LOUDER * own)
        elif louder is not None:
            hypothesis = _limits_scaled(hypothesis, [(COMMAND_LIMIT, louder)])
        if louder is not None:
            driven = problem.machine.driven[louder]
            hypothesis = _limits_scaled(hypothesis, [(FORCE_LIMIT, joint) for joint in driven])
        made = problem.library.change(hypothesis, problem.replay.machine)
        if louder is not None and not scaled:
            made.commands.setdefault(louder, []).insert(0, lambda u, _: LOUDER * u)
        forces = bool(problem.balanced)
        found = problem.replay.error(made, chosen=self.chosen, forces=forces)
        errors = found.normalised + problem.noise.defect[self.chosen]
        errors = errors.reshape(len(errors), -1)
        if found.left is None or found.pushed is None:
            return errors
        left = found.left / self._influence(found.pushed)[:, None]
        return np.concatenate([errors, left.reshape(len(errors), -1)], axis=1)

    @cached_property
    def covariance(self) -> np.ndarray:
        """Noise covariance of sensors, start states and time step, (windows, size, size)."""
        return self.problem.noise.covariance(self.chosen)

    @cached_property
    def _own(self) -> tuple[np.ndarray, np.ndarray]:
        """RMS of the unchanged model's residual forces, and of their change with commands."""
        problem = self.problem
        if not problem.balanced:
            return np.zeros(0), np.zeros(0)
        made = problem.library.change(Hypothesis(), problem.replay.machine)
        left, pushed = problem.replay.lacking(made, self.chosen)
        return _size(left), _size(pushed)

    @property
    def unit(self) -> np.ndarray:
        """RMS residual forces of the unchanged model [N m or N], shape (joints,)."""
        return np.maximum(self._own[0], 1e-300)

    def _influence(self, pushed: np.ndarray) -> np.ndarray:
        """Computes the influence of commands on forces over the unchanged model's, (joints,).

        Residual forces are divided by this ratio and so are relative to the drive's force.
        Otherwise a gain of 0, or friction as large as the drive's force, would leave no residual.
        """
        own = self._own[1]
        influence = np.maximum(_size(pushed), NEGLIGIBLE * own)
        return np.divide(influence, own, out=np.ones_like(own), where=own > 0.0)

    @cached_property
    def twins(self) -> frozenset[frozenset[Key]]:
        """Pairs of effects that no recording of these channels can distinguish."""
        problem = self.problem
        found = ((key, twin) for key in problem.library.searched for twin in twins(problem, key))
        return frozenset(frozenset(pair) for pair in found)

    def tangents(
        self,
        base: Hypothesis,
        errors: np.ndarray,
        which: Iterable[int],
        step: tuple[float, float],
        known: np.ndarray,
        most: np.ndarray | None = None,
    ) -> np.ndarray:
        """Computes tangents by finite differences, (windows, rows, unknowns).

        Args:
            base: Hypothesis at which errors are differentiated.
            errors: Errors of `base`.
            which: Single unknowns to differentiate by; a tied unknown's tangent is their sum.
            step: Least step in smallest trial values, and as a share of the present departure.
            known: Tangents that all other unknowns keep.
            most: Largest steps, (single unknowns,), if `gradual`; None for no limit.
        """
        u = self.unknowns
        out, x = known.copy(), u.departures(base)
        steps: dict[int, float] = {}
        for i in which:
            h = max(step[0], step[1] * abs(x[i]))
            if most is not None and u.gradual[i]:
                h = min(h, float(most[i]))
            if x[i] + h > u.upper[i]:
                h = -h
            out[:, :, i] = 0.0
            if x[i] + h >= u.lower[i]:
                steps[i] = h
        moved = self.each([u.moved(base, {i: h}) for i, h in steps.items()])
        for (i, h), there in zip(steps.items(), moved, strict=True):
            out[:, :, i] = change(errors, there) / h
        for i in range(u.single, len(u)):
            out[:, :, i] = sum(out[:, :, one] for one in u.singles(i))
        return out

    def jumped(self, columns: Columns, jumps: Sequence[Jump], *, near: bool = False) -> Columns:
        """Adds changes by jumps to a linearisation, 0 in windows where a replay blows up.

        If `near`, the changes by `gradual` unknowns are predicted by tangents, not replayed.
        """
        u = self.unknowns
        replayed = [k for k, (q, _) in enumerate(jumps) if not (near and u.gradual[q])]
        changes = columns.tangents[:, :, [q for q, _ in jumps]] * [by for _, by in jumps]
        moved = self.each([u.moved(columns.base, dict([jumps[k]])) for k in replayed])
        for k, there in zip(replayed, moved, strict=True):
            changes[:, :, k] = change(columns.errors, there)
        return replace(columns, jumps=tuple(jumps), changes=changes)

    def without(self, columns: Columns, members: Sequence[int], key: Key) -> Columns | None:
        """Linearises the hypothesis without one effect; None if a replay without it blows up.

        The errors are replayed, but the tangents remain those of the hypothesis with the effect.
        """
        u, x = self.unknowns, columns.x
        gone = {i: -float(x[i]) for q in members if u.keys[q] == key for i in u.singles(q)}
        base = u.moved(columns.base, gone)
        errors = self.at(base)
        if np.abs(errors).max() > BLOWN:
            return None
        return replace(columns, base=base, x=u.departures(base), errors=errors)

    def columns(self, step: tuple[float, float]) -> Columns:
        """Computes errors and tangents of the unchanged model; shape parameters have tangents 0."""
        base, u = Hypothesis(), self.unknowns
        errors = self.at(base)
        which = np.flatnonzero(~u.shape[: u.single]).tolist()
        tangents = self.tangents(base, errors, which, step, np.zeros((*errors.shape, len(u))))
        none = np.zeros((*errors.shape, 0))
        return Columns(base, u.departures(base), errors, tangents, (), none)


# In a worker process of `Errors.each`: the `Errors` object that it serves.
_served: list[Errors] = []


def _begin(at: Errors) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # only the parent process handles interrupts
    at.problem.replay.use_one_thread()
    _served.append(at)


def _errors(hypothesis: Hypothesis) -> tuple[np.ndarray, float]:
    """Computes errors in a worker process of `Errors.each`, and the number of its replays."""
    replay = _served[0].problem.replay
    before = replay.rollouts
    return _served[0].at(hypothesis), replay.rollouts - before


def _limits_scaled(hypothesis: Hypothesis, limits: Iterable[Key]) -> Hypothesis:
    """Multiplies by `LOUDER` the values of those effects in `limits` that the hypothesis has."""
    for key in limits:
        if key in hypothesis:
            hypothesis = hypothesis.with_values(key, LOUDER * hypothesis[key])
    return hypothesis


def _size(pushed: np.ndarray) -> np.ndarray:
    """Computes the RMS force over windows and blocks of time, (joints,)."""
    return np.asarray(rms(np.clip(pushed, -BLOWN, BLOWN), axis=(0, 2)))


def change(errors: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """Computes the change of errors, (windows, rows); 0 in windows where a replay blows up."""
    out = moved - errors
    out[np.abs(moved).max(axis=1) > BLOWN] = 0.0
    return out


def trials(unknowns: Unknowns) -> list[Jump]:
    """Returns jumps to the trial values of faults, except the smallest, which tangents predict."""
    found: list[Jump] = []
    for u in np.flatnonzero(unknowns.nameable).tolist():
        # An unknown that several elements share has the trial values of the first element.
        key, i = unknowns.places[u][0]
        p = unknowns.library.sites[key].parameters[i]
        found += [
            (u, float(by))
            for by in sorted(round(p.from_nominal(t) / p.scale, 6) for t in p.trials)
            if abs(by) > 1.0 + 1e-6
            and unknowns.lower[u] <= by <= unknowns.upper[u]
            and ((by > 0 and unknowns.above[u]) or (by < 0 and unknowns.below[u]))
        ]
    return found
