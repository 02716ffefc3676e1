"""Calibration of the model to healthy recordings of the individual machine (specimen)."""

from collections.abc import Callable, Iterable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from leglab.base.scale import rms
from leglab.diagnosis import thresholds
from leglab.diagnosis.effects.hypothesis import Hypothesis, Library
from leglab.diagnosis.intake.series import UniformSeries
from leglab.diagnosis.likelihood.columns import Columns, Errors, Jump
from leglab.diagnosis.likelihood.evidence import Evidence, parts_of
from leglab.diagnosis.likelihood.priors import Priors
from leglab.diagnosis.likelihood.spread import Spread
from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.replay.residual import Problem, thinned
from leglab.diagnosis.search.search import describe, windows_of
from leglab.diagnosis.search.settle import Candidate, Fit, Fitter


@dataclass(frozen=True, eq=False)
class Specimen:
    """The individual machine, identified from its healthy recordings."""

    at: Errors  #: Errors of healthy recordings in the windows that were fitted
    columns: Columns  #: Linearisation at the end of the fit
    values: Hypothesis  #: Values of all strengths and shapes of the fit
    priors: Priors  #: Priors of departures of the same machine on another day
    kappa: float  #: Factor on log likelihoods, 1/design effect
    left_out: tuple[Hypothesis, ...]  #: Values fitted without each part (see `parts_of`) in turn

    @property
    def problem(self) -> Problem:
        """Fit problem of the healthy recordings."""
        return self.at.problem

    @cached_property
    def errors(self) -> np.ndarray:
        """Errors of each window by the fit without the window's part, (windows, rows)."""
        out, part = np.zeros_like(self.columns.errors), parts_of(self.at.recording)
        for r, hypothesis in enumerate(self.left_out):
            own = part == r
            out[own] = self.at.some(own).at(hypothesis)
        return np.clip(out, -thresholds.BLOWN, thresholds.BLOWN)

    @cached_property
    def spread(self) -> Spread:
        """Covariance of the cross-validated errors in each healthy recording."""
        return Spread.of(self.at, self.errors)

    @cached_property
    def _squares(self) -> np.ndarray:
        """Mean square error of each window by the fit without the window's part, (windows,)."""
        at, problem = self.at, self.problem
        # A window that was not fitted is assigned to the part of the next fitted window.
        fitted = parts_of(at.recording)
        place = np.searchsorted(np.flatnonzero(at.chosen), np.arange(at.chosen.size))
        part = fitted[np.minimum(place, fitted.size - 1)]
        out = np.zeros(part.size)
        for r, hypothesis in enumerate(self.left_out):
            out[part == r] = np.mean(problem.residual(hypothesis, part == r) ** 2, axis=1)
        return out

    @cached_property
    def levels(self) -> np.ndarray:
        """Error of each healthy recording in noise levels, (recordings, 2).

        The columns are the errors of the unchanged model and the cross-validated errors.
        """
        recording = self.problem.replay.recording
        squares = np.stack([self.problem.noise_levels(Hypothesis()), self._squares])
        count = len(self.problem.series)
        return np.sqrt([squares[:, recording == i].mean(axis=1) for i in range(count)])

    @cached_property
    def usual(self) -> np.ndarray:
        """Median cross-validated error by recording, in noise levels, (recordings,)."""
        recording, count = self.problem.replay.recording, len(self.problem.series)
        return np.sqrt([np.median(self._squares[recording == i]) for i in range(count)])

    @cached_property
    def day(self) -> float:
        """Standard deviation of log errors between healthy recordings, at least `DAY_FACTOR`."""
        apart = np.log(self.usual)
        return max(thresholds.DAY_FACTOR, float(np.std(apart, ddof=1)) if apart.size > 1 else 0.0)

    def nearest(self, problem: Problem) -> list[int]:
        """Returns, for each new recording, the healthy recording with the most similar motion."""
        columns = problem.machine.columns
        own = np.stack([_motion(s, columns) for s in self.problem.series])
        other = np.stack([_motion(s, columns) for s in problem.series])
        return np.argmin(((other[:, None] - own) ** 2).sum(axis=2), axis=1).tolist()

    def as_it_was(self, problem: Problem, at: Hypothesis) -> bool:
        """Tests whether new errors are as small as a healthy specimen's errors on another day.

        Every recording has to pass, because one with motion shows more than several at rest. `at`
        are the specimen's values, which are not refitted, because a refit could hide a fault.
        """
        level, recording = problem.noise_levels(at) ** 0.5, problem.replay.recording
        ratio = level / self.usual[np.array(self.nearest(problem))[recording]]
        largest = max(float(np.median(ratio[recording == r])) for r in np.unique(recording))
        # The largest deviation among several healthy recordings is up to two standard deviations.
        limits = np.exp([self.day, 2.0 * self.day])
        return bool(np.median(ratio) <= limits[0] and largest <= limits[1])

    def as_new(
        self, library: Library, members: Iterable[int], jumps: Sequence[Jump], kappa: float
    ) -> Evidence:
        """Builds the evidence of sets of effects on healthy recordings, as if these were new.

        Each part of the healthy recordings is compared with the fit to the other parts, just as new
        recordings are compared with the specimen. Departures are relative to the specimen.

        Args:
            library: Effects on the specimen.
            members: Unknowns of the sets, whose tangents are computed anew.
            jumps: Finite steps of unknowns that are not `gradual`, which have no tangents.
            kappa: Factor on the log likelihood.
        """
        problem, u = copy(self.problem), Unknowns.of(library)
        problem.library = library
        own = sorted({i for q in members for i in u.singles(q)})
        here = self.values, self.columns.errors
        # The fit's tangents remain valid, because only the zero of the departures differs.
        single = self.at.tangents(*here, own, thresholds.FINE, self.columns.tangents)
        tangents = np.zeros((*self.errors.shape, len(u)))
        for q in range(len(u)):
            tangents[:, :, q] = single[:, :, list(u.singles(q))].sum(axis=2)
        none = np.zeros((*self.errors.shape, 0))
        at = Errors(problem, u, self.at.chosen)
        # Like the tangents, changes by jumps are those of the fit to all parts.
        columns = Columns(Hypothesis(), np.zeros(len(u)), self.columns.errors, tangents, (), none)
        columns = replace(at.jumped(columns, jumps), errors=self.errors)
        fitter = Fitter(at, self.priors, self.spread)
        return fitter.evidence(columns, *fitter.about(columns.errors), kappa)


def _motion(series: UniformSeries, columns: Sequence[str]) -> np.ndarray:
    """Computes log standard deviations and then log RMS rates of recorded columns, concatenated."""
    values = np.stack([series.columns[column] for column in columns])
    spread = np.std(values, axis=1)
    rate = rms(np.diff(values, axis=1), axis=1) / series.period
    return np.log(np.concatenate([spread, rate]) + 1e-9)


def calibrate(problem: Problem, later: Problem, log: Callable[[str], None]) -> Specimen:
    """Fits the model to healthy recordings, under the priors of good machines.

    If this fit leaves more than noise, and new errors exceed the cross-validated healthy errors,
    sets of effects that describe the healthy recordings are sought. New errors that one of the best
    sets explains are no change. So the first of the best sets that also explains the new recordings
    becomes the specimen; if none does, the most probable set.

    Args:
        problem: Healthy recordings and machine.
        later: New recordings and the same machine.
        log: Called with what is being done.
    """
    unknowns = Unknowns.of(problem.library)
    at = Errors(problem, unknowns, thinned(problem.fitted, 3 * windows_of(unknowns) // 2))
    fitter, kappa = Fitter(at, Priors()), thresholds.KAPPA
    first = at.columns(thresholds.COARSE)
    new = Candidate((), {}, first, *fitter.about(first.errors))
    for _ in range(2):
        fit = fitter.fit(new, kappa)
        evidence = fitter.evidence(fit.columns, fit.spread, fit.weight, kappa)
        kappa = 1.0 / max(evidence.design_effect(evidence.score(())), 1.0)
        log(f"  healthy: level {fit.level:.4g} kappa {kappa:.3f}")
        new = Candidate((), {}, fit.columns, fit.spread, fit.weight)
    specimen = _specimen(fitter, fit, kappa)
    if fitter.explains(fit) or specimen.as_it_was(later, specimen.values):
        return specimen
    ranks = describe(fitter, first, fit, kappa, log).ranks
    least, kappa = ranks[0].score.log - thresholds.NEAR, ranks[0].evidence.kappa
    near = [r.fit for r in ranks if r.score.log > least]
    made = [_specimen(fitter, fit, kappa) for fit in near]
    return next((one for one in made if one.as_it_was(later, one.values)), made[0])


def _specimen(fitter: Fitter, fit: Fit, kappa: float) -> Specimen:
    """Builds the specimen from a fit to its healthy recordings."""
    at, unknowns = fitter.at, fitter.at.unknowns
    # From here on, a model error of scale 1 is as large as the errors that this fit leaves.
    unit = Priors(sizes=(1.0,), log_sizes=np.zeros(1))
    own = Spread.of(at, fit.columns.errors)
    evidence = fitter.evidence(fit.columns, own, fit.weight, kappa, unit)
    score = evidence.score([(q, None) for q in fit.members])
    sites = at.problem.library.sites
    values = Hypothesis({k: fit.columns.base.get(k, s.nominal) for k, s in sites.items()})
    priors = Priors(
        spreads=thresholds.SPREADS + thresholds.WIDER,
        tolerances=thresholds.DAY_TOLERANCES,
        covariance=evidence.posterior(score),
        sizes=thresholds.DAY_SIZES,
        log_sizes=-0.5 * (np.log(thresholds.DAY_SIZES) / thresholds.DAY_FACTOR) ** 2,
    )
    apart = evidence.apart(score.members, score.spread)
    left_out = tuple(unknowns.moved(values, evidence.departures(one)) for one in apart)
    return Specimen(at, fit.columns, values, priors, kappa, left_out)
