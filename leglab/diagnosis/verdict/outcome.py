"""Judged search: the hypotheses that are reported, and the covariance of their parameters."""

from dataclasses import replace
from functools import cached_property

import numpy as np

from leglab.diagnosis.effects.hypothesis import Hypothesis, Key, Library
from leglab.diagnosis.likelihood.columns import Errors
from leglab.diagnosis.likelihood.evidence import Evidence, Score
from leglab.diagnosis.likelihood.unknowns import EVERY
from leglab.diagnosis.replay.residual import Problem
from leglab.diagnosis.result import Diagnosis, root_mean
from leglab.diagnosis.search.healthy import Specimen
from leglab.diagnosis.search.onset import begun
from leglab.diagnosis.search.settle import Candidate, Fit, Fitter
from leglab.diagnosis.thresholds import ABSENT, RENEWALS, SMALL
from leglab.diagnosis.verdict.confidence import Judgement
from leglab.diagnosis.verdict.sets import Row, Sets
from leglab.diagnosis.verdict.table import Table


class Outcome:
    """Judged search with the hypotheses and parameters that are reported.

    `result` is the reported diagnosis; `diagnose` sets it.
    """

    result: Diagnosis

    def __init__(
        self, sets: Sets, table: Table, judged: Judgement, specimen: Specimen | None
    ) -> None:
        self.sets, self.table, self.judged = sets, table, judged
        self.specimen, self.found = specimen, sets.found
        rows, fitter = sets.rows, sets.fitter
        # Values come from a fit of the reported effect, not of an effect with the same motion.
        fitted = {key for row in rows if not row.renamed for key in row.keys}
        names = judged.named or tuple(k for k in judged.confusion if k in fitted)[:1]
        self.problem = problem = fitter.at.problem
        nothing = next(r for r in rows if not r.keys)
        row = next((r for r in rows if r.keys.issuperset(names) and not r.renamed), rows[0])
        if judged.verdict == "nothing_missing":
            row = nothing
        self.row = row  #: the set whose values are reported
        #: Fit of the empty set: all parameters within the tolerances of good machines.
        self.nothing = nothing.hypothesis
        self.final = row.hypothesis  #: the reported set with all other parameters as fitted
        #: The problem with the noise model linearised at the reported set.
        self.about = problem.about(self.final)
        #: Covariance of single unknowns (parameters of one element) at the reported set, in trials.
        self.spread = _scatter(row.evidence, row.score)
        if specimen is not None:  # both values of a difference are uncertain
            self.spread = self.spread + specimen.priors.covariance
        #: Effects that are reported, named or in a confusion set.
        self.named = _single(problem.library, names)
        #: Recalibrated model: parameters refitted within tolerances; named effects are absent.
        self.baseline = self.nothing
        #: Improved model: only reported effects, and parameters with a tolerance, are changed.
        if specimen is not None:
            self.written = self.final.only(self.named)
            if judged.verdict == "nothing_missing" and not self.named:
                self.final = self.written
        else:
            lean, spread = _lean(self.about, fitter, row, self.named)
            if lean.level <= (1.0 + SMALL) * row.level:
                self.written = _named_alone(problem.library, lean.columns.base, self.named)
                self.final, self.spread = self.written, spread
            else:  # the written model has the reported values; its other parameters are refitted
                lean, _ = _lean(self.about, fitter, row, self.named, fixed=self.named)
                told = {key: self.final[key] for key in self.named if key in self.final}
                alone = _named_alone(problem.library, lean.columns.base, self.named)
                self.written = Hypothesis({**alone, **told}, alone.onsets)
            tuned = lean
            if row is not nothing or self.named:
                about = problem.about(self.nothing)
                tuned, _ = _lean(about, fitter, nothing, (), fixed=self.named)
            tuning = _within(problem.library, tuned.columns.base).without(*self.named)
            # Under a gross fault, recalibration may worsen the fit, so the better model is used.
            self.baseline = min(Hypothesis(), tuning, key=self._fitted_level)
        #: Earliest and latest possible onset [s] of each effect that begins during a recording,
        #: (recordings, 2), inf in recordings in which the effect does not begin.
        self.onsets: dict[Key, np.ndarray] = {}
        if self.found.onsets is not None:
            self.final, self.onsets = begun(problem, self.final, self.named, self.found.onsets)

    def __repr__(self) -> str:
        named = ", ".join(f"{name} at {element}" for name, element in self.named) or "nothing"
        return f"Outcome({self.judged.verdict}: {named})"

    def _fitted_level(self, hypothesis: Hypothesis) -> float:
        """Computes the RMS error of the fitted windows, in noise levels."""
        return root_mean(self.about.noise_levels(hypothesis)[self.problem.fitted])

    @property
    def unnamed(self) -> Hypothesis:
        """The reported set without the named effects; empty if none is named."""
        return self.final.without(*self.named) if self.named else Hypothesis()

    @cached_property
    def compared(self) -> Problem:
        """The problem `about` with the healthy specimen's error covariance added to the noise."""
        fixed = self.sets.fitter.fixed
        return self.about.beside(fixed.replays) if fixed else self.about

    def floors(self) -> np.ndarray:
        """Returns mean squared errors expected from noise or the healthy specimen, (windows,)."""
        problem = self.problem
        if self.specimen is None:
            return np.ones(problem.replay.windows)
        nearest = np.array(self.specimen.nearest(problem))
        return self.specimen.levels[nearest[problem.replay.recording], 1] ** 2


def _single(library: Library, names: tuple[Key, ...]) -> tuple[Key, ...]:
    """Returns effects on single elements: an effect on all joints becomes one on each joint."""
    return tuple(
        dict.fromkeys(  # An effect may act on all joints and, in addition, on a single joint.
            key
            for name, element in names
            for key in sorted(library.sites)
            if key[0] == name and element in (key[1], EVERY)
        )
    )


def _named_alone(library: Library, fitted: Hypothesis, named: tuple[Key, ...]) -> Hypothesis:
    """Sets parameters that are not named and have no tolerance to the model's values.

    Otherwise the model would contain the small values that a fit gives to all effects.
    """
    values = {}
    for key, value in fitted.items():
        site = library.sites[key]
        tolerant = [p.tolerance > 0.0 or key in named for p in site.parameters]
        if any(tolerant):
            values[key] = np.where(tolerant, value, site.nominal)
    return Hypothesis(values, fitted.onsets)


def _within(library: Library, fitted: Hypothesis) -> Hypothesis:
    """Limits parameters to their tolerances; parameters without a tolerance become nominal."""
    values = {}
    for key, value in _named_alone(library, fitted, ()).items():
        site = library.sites[key]
        pairs = zip(site.parameters, site.nominal.tolist(), strict=True)
        values[key] = np.clip(value, *np.transpose([p.usual(own) for p, own in pairs]))
    return Hypothesis(values, fitted.onsets)


def _lean(
    about: Problem, fitter: Fitter, row: Row, named: tuple[Key, ...], *, fixed: tuple[Key, ...] = ()
) -> tuple[Fit, np.ndarray]:
    """Refits the reported effects; all other parameters are nominal or within their tolerance.

    Otherwise small deviations of other parameters would explain a part of each effect. Effects in
    `fixed` do not move. Also returns the covariance of all single unknowns.
    """
    u, old, kappa = fitter.at.unknowns, row.evidence.columns, row.evidence.kappa
    values = zip(row.score.unknowns, row.score.values.tolist(), strict=True)
    kept = {q: value for q, value in values if u.library_keys(q) <= set(named)}
    # Shape parameters keep their fitted values.
    goal = np.where(u.shape, old.x, 0.0)
    for q, value in kept.items():
        goal[list(u.singles(q))] += value
    # Bounds fix all parameters that the written model omits, because even a thousandth of a trial
    # value may change errors by five noise levels.
    own = frozenset[Key]().union(*map(u.library_keys, kept))
    held = np.array(
        [
            not u.library_keys(q).isdisjoint(fixed)
            or (u.tolerance[q] == 0.0 and u.library_keys(q).isdisjoint(own))
            for q in range(len(u))
        ]
    )
    lower, upper = np.where(held, goal, u.lower), np.where(held, goal, u.upper)
    tolerance, shape = np.where(held, 0.0, u.tolerance), u.shape & ~held
    bounded = replace(u, tolerance=tolerance, lower=lower, upper=upper, shape=shape)
    at = Errors(about, bounded, fitter.at.chosen)
    lean = Fitter(at, replace(fitter.priors, spreads=(ABSENT,)))
    there = replace(old, errors=at.at(old.base))
    start = dict(enumerate((goal - old.x)[: u.single].tolist()))
    new = Candidate(tuple(kept), start, there, row.evidence.spread, row.evidence.weight)
    fit = lean.fit(new, kappa, renewals=RENEWALS if kept or fixed else 0, beside=True)
    evidence = lean.evidence(fit.columns, fit.spread, fit.weight, kappa)
    return fit, _scatter(evidence, evidence.score([(q, None) for q in kept]))


def _scatter(evidence: Evidence, score: Score) -> np.ndarray:
    """Computes the single unknowns' covariance, (single, single), by posterior and jackknife.

    The posterior ignores errors that all windows of a recording share. So a parameter of the set
    gets the larger of two variances: by the posterior, or by a jackknife over recordings' parts.
    """
    spread, u = evidence.posterior(score), evidence.unknowns
    parts = int(evidence.part.max()) + 1
    if not score.members or parts < 2:
        return spread
    without = np.array([one.values for one in evidence.apart(score.members)])
    away = without - without.mean(axis=0)
    for i, q in enumerate(score.unknowns):
        jack = (parts - 1) / parts * float(away[:, i] @ away[:, i])
        for k in u.singles(q):
            widened = np.sqrt(max(1.0, jack / max(spread[k, k], 1e-300)))
            spread[k] *= widened
            spread[:, k] *= widened
    return spread
