"""Screening: what each effect would gain at a few sizes, nuisances following to first order."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leglab.diagnosis.fitting import FreeTangents, profiled
from leglab.diagnosis.hypothesis import Hypothesis, Key
from leglab.diagnosis.problem import Nuisance, Problem


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """Best size of an effect in the screening.

    Attributes:
        key: Effect and element.
        values: Of its parameters, where a refit starts.
        gain: Cost saved against the baseline; chi-square units.
        direction: Whitened change of the errors by its smallest trial, (chosen windows, size).
        detectable: Norm of that direction, beyond what nuisances imitate: below some 5 the trial
            size could not be told from noise.
    """

    key: Key
    values: np.ndarray
    gain: float
    direction: np.ndarray
    detectable: float


def screen(
    problem: Problem,
    base: Hypothesis,
    residual: np.ndarray,
    tangents: np.ndarray,
    nuisances: Sequence[Nuisance],
    named: FreeTangents,
    chosen: np.ndarray,
    floor: float,
    *,
    skip: frozenset[Key] = frozenset(),
    onset: np.ndarray | None = None,
) -> list[Candidate]:
    """Tries every effect of the library on top of `base`, best first.

    Args:
        problem: What is fitted.
        base: Baseline.
        residual: Its whitened errors, shape (chosen windows, size).
        tangents: Of the nuisances at the baseline, shape (chosen windows, size, nuisances).
        nuisances: Those of the columns.
        named: Of the effects that the baseline has already, which follow as well.
        chosen: Mask of windows.
        floor: Cost of the best fit without a further effect, which gains are counted from.
        skip: Effects that the baseline has already.
        onset: Time at which what is looked for begins, shape (recordings,); None: throughout.
    """
    found = []
    for key, site in problem.library.sites.items():
        if key in skip:
            continue
        own = [i for i, n in enumerate(nuisances) if n.key != key]
        others = [nuisances[i] for i in own]
        space = tangents[:, :, own]
        known = np.concatenate([named.columns, space], axis=2)
        best, gain = site.nominal, -np.inf
        smallest: tuple[float, np.ndarray] | None = None
        now = base.get(key, site.nominal)
        for values in site.trials():
            other = problem.residual(base.with_values(key, values).with_onset(key, onset), chosen)
            cost = profiled(problem, base, other, space, others, named)
            if floor - cost > gain:
                best, gain = values, floor - cost
            difference = values - now
            moved = int(np.argmax(np.abs(difference) / [p.scale for p in site.parameters]))
            size = abs(difference[moved]) / site.parameters[moved].scale
            direction = other - residual
            # To first order the best size may lie between nothing and this trial.
            unit = _orthogonal(direction, known)
            norm = float((unit**2).sum())
            share = -float((unit * residual).sum()) / norm if norm > 0 else 0.0
            if 0.0 < share < 1.0:
                part = residual + share * direction
                cost = profiled(problem, base, part, space, others, named)
                if floor - cost > gain:
                    best, gain = now + share * difference, floor - cost
            if smallest is None or size < smallest[0]:
                smallest = (size, direction)
        if smallest is None:
            continue
        unit = _orthogonal(smallest[1], known)
        found.append(
            Candidate(
                key=key,
                values=best,
                gain=gain,
                direction=smallest[1],
                detectable=float(np.sqrt((unit**2).sum())),
            )
        )
    return sorted(found, key=lambda c: -c.gain)


def _orthogonal(direction: np.ndarray, tangents: np.ndarray) -> np.ndarray:
    """The part of a direction that nuisances, under their priors, cannot imitate."""
    flat = tangents.reshape(-1, tangents.shape[2])
    matrix = flat.T @ flat + np.eye(flat.shape[1])
    share = np.linalg.solve(matrix, flat.T @ direction.ravel())
    return direction - (flat @ share).reshape(direction.shape)
