"""Renewal of the noise model of a search at the most probable set of effects.

The noise model contains the growth of start-state errors in replays of the unchanged model. Under a
very different model they grow otherwise, so even the right set would leave several noise levels.
"""

from collections.abc import Hashable
from dataclasses import replace
from itertools import repeat

import numpy as np

from leglab.diagnosis.likelihood.columns import Columns
from leglab.diagnosis.search.pool import Pool, Scene
from leglab.diagnosis.search.rank import Compared
from leglab.diagnosis.search.settle import Fit, Fitter
from leglab.diagnosis.thresholds import EXPLAINED, HOPELESS


def wanted(pool: Pool) -> bool:
    """Tests whether the best set leaves little more than noise and caused no renewal yet."""
    best = pool.best.fit
    return EXPLAINED < best.level < HOPELESS * EXPLAINED and _about(best) not in pool.done


def renewed(pool: Pool) -> Pool:
    """Ranks the pool by the noise model at the best set; only the empty set remains finished."""
    scene, best = pool.scene, pool.best.fit
    old = scene.fitter
    new = Fitter(old.at.about(best.columns.base), old.priors, old.fixed)
    now, then = (f.at.problem.noise.defect[f.at.chosen] for f in (new, old))
    by = (now - then).reshape(len(now), -1)
    here = Scene(new, scene.aim, _moved(scene.first, by), Compared(new))
    columns = (_moved(fit.columns, by) for fit in pool.fits)
    fits = tuple(map(_judged, repeat(new), pool.fits, columns, repeat(pool.kappa)))
    done = pool.done | {_about(best)}
    return replace(pool, scene=here, fits=fits, done=done, erring=None).ranked()


def _about(fit: Fit) -> Hashable:
    """Returns the key of the renewal at a set, because a renewal is done once per set."""
    return "noise", fit.keys


def _moved(columns: Columns, by: np.ndarray) -> Columns:
    """Adds the change `by` of the time-step error, (windows, replay errors), to the errors."""
    errors = columns.errors.copy()
    errors[:, : by.shape[1]] += by
    return replace(columns, errors=errors)


def _judged(fitter: Fitter, fit: Fit, columns: Columns, kappa: float) -> Fit:
    """Scores a fit under a new noise model; the fit of a non-empty set becomes unfinished."""
    spread = fitter.own_spread(columns.errors)
    weight = fitter.weights(columns.errors, spread, fit.score.size)
    evidence = fitter.evidence(columns, spread, weight, kappa)
    return replace(
        fit,
        columns=columns,
        spread=spread,
        weight=weight,
        score=evidence.score([(q, None) for q in fit.members]),
        level=fitter.level(columns.errors),
        finished=not fit.members,
        unkept=0.0,
        gained=0.0,
    )
