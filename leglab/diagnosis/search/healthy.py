"""Calibrates the model to healthy recordings of the same machine."""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from leglab.base.scale import rms
from leglab.diagnosis import thresholds
from leglab.diagnosis.effects.hypothesis import Hypothesis, Library
from leglab.diagnosis.intake.series import UniformSeries
from leglab.diagnosis.likelihood.columns import Errors
from leglab.diagnosis.likelihood.evidence import Evidence, parts_of
from leglab.diagnosis.likelihood.priors import Priors
from leglab.diagnosis.likelihood.spread import Spread
from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.replay.residual import Problem, thinned
from leglab.diagnosis.search.search import search
from leglab.diagnosis.search.settle import Candidate, Fit, Fitter


@dataclass(frozen=True, eq=False)
class Specimen:
    """A machine as its healthy recordings show it."""

    problem: Problem  #: Healthy recordings and machine
    values: Hypothesis  #: Of all strengths and shapes
    priors: Priors  #: Of the same machine on another day
    #: Pattern of the error in each healthy recording where the others alone are fitted.
    spread: Spread
    kappa: float  #: 1/design effect
    #: Error of each healthy recording in noise levels, of the model as it is and where the others
    #: alone are fitted, (recordings, 2).
    levels: np.ndarray
    #: Median error of the windows of each healthy recording where the others alone are fitted, in
    #: noise levels, (recordings,).
    usual: np.ndarray
    chosen: np.ndarray  #: Mask of the windows that were fitted, (windows,)
    left_out: tuple[Hypothesis, ...]  #: Fits without each part of the recordings in turn

    def nearest(self, problem: Problem) -> list[int]:
        """The healthy recording of the most similar motion to each of others."""
        columns = problem.machine.columns
        own = np.stack([_motion(s, columns) for s in self.problem.series])
        other = np.stack([_motion(s, columns) for s in problem.series])
        return np.argmin(((other[:, None] - own) ** 2).sum(axis=2), axis=1).tolist()

    def surprise(self, problem: Problem) -> float:
        """How little fitted recordings, of a problem about the model, are those of this specimen.

        Negative log density of their median errors, as the healthy ones have them.
        """
        fitted, nearest = problem.fitted, np.array(self.nearest(problem))
        usual = self.usual[nearest[problem.replay.recording]][fitted]
        ratio = problem.noise_levels(self.values)[fitted] ** 0.5 / usual
        return float(np.median(0.5 * ratio**2 + np.log(usual)))

    @cached_property
    def day(self) -> float:
        """Log deviation of an error on another day: at least that of healthy recordings."""
        apart = np.log(self.usual)
        return max(thresholds.DAY_FACTOR, float(np.std(apart, ddof=1)) if apart.size > 1 else 0.0)

    def as_it_was(self, problem: Problem, at: Hypothesis) -> bool:
        """Whether errors in all windows are those of the healthy specimen on another day.

        In every recording: one that moves tells more than three that rest. `at` is where the
        specimen is: what a day moves may hide a fault.
        """
        level, recording = problem.noise_levels(at) ** 0.5, problem.replay.recording
        ratio = level / self.usual[np.array(self.nearest(problem))[recording]]
        largest = max(float(np.median(ratio[recording == r])) for r in np.unique(recording))
        # Of several recordings the largest departs by two deviations where none is ill.
        limits = np.exp([self.day, 2.0 * self.day])
        return bool(np.median(ratio) <= limits[0] and largest <= limits[1])

    def as_new(self, library: Library, kappa: float) -> Evidence:
        """Evidence that sets have on recordings of an unchanged machine.

        Each part of the healthy recordings is compared with the fit of all others, as new ones are;
        departures are from the specimen.

        Args:
            library: Effects on the specimen.
            kappa: Share of the log likelihood that counts.
        """
        problem = copy(self.problem)
        problem.library = library
        at = Errors(problem, Unknowns.of(library), self.chosen)
        fitter = Fitter(at, self.priors, self.spread)
        columns = replace(at.columns(thresholds.FINE), errors=_apart(at, self.left_out))
        return fitter.evidence(columns, *fitter.about(columns.errors), kappa)


def _motion(series: UniformSeries, columns: Sequence[str]) -> np.ndarray:
    """How far and how fast a recording goes: logarithms of spreads and rates, (2 columns,)."""
    values = np.stack([series.columns[column] for column in columns])
    spread = np.std(values, axis=1)
    rate = rms(np.diff(values, axis=1), axis=1) / series.period
    return np.log(np.concatenate([spread, rate]) + 1e-9)


def calibrate(problem: Problem, log: Callable[[str], None]) -> list[Specimen]:
    """Fits the model to healthy recordings, under the priors of machines as they are built.

    Where that leaves more than noise they are searched as new ones are. The specimen is what any of
    the best sets says, named or not, or no set, the most probable first.
    """
    at = Errors(
        problem, Unknowns.of(problem.library), thinned(problem.fitted, 3 * thresholds.WINDOWS // 2)
    )
    fitter, kappa = Fitter(at, Priors()), thresholds.KAPPA
    first = at.columns(thresholds.COARSE)
    spread, weight = fitter.about(first.errors)
    for _ in range(2):
        fit = fitter.fit(Candidate((), {}, first, spread, weight), kappa)
        spread, weight, first = fit.spread, fit.weight, fit.columns
        evidence = fitter.evidence(first, spread, weight, kappa)
        kappa = 1.0 / max(evidence.design_effect(evidence.score(())), 1.0)
        log(f"  healthy: level {fit.level:.4g} kappa {kappa:.3f}")
    if fitter.explains(fit):
        return [_specimen(problem, fitter, fit, kappa)]
    found = search(problem, log=log)
    ranks, fitter = found.ranks, found.fitter
    least, kappa = ranks[0].score.log - thresholds.NEAR, ranks[0].evidence.kappa
    near = [r.fit for r in ranks if r.score.log > least or not r.fit.members]
    return [_specimen(problem, fitter, fit, kappa) for fit in near]


def _specimen(problem: Problem, fitter: Fitter, fit: Fit, kappa: float) -> Specimen:
    """The specimen by a fit to its healthy recordings."""
    at, unknowns = fitter.at, fitter.at.unknowns
    # From here on the error that is left has size 1.
    unit = Priors(sizes=(1.0,), log_sizes=np.zeros(1))
    own = Spread.of(at, fit.columns.errors)
    evidence = fitter.evidence(fit.columns, own, fit.weight, kappa, unit)
    score = evidence.score([(q, None) for q in fit.members])
    sites = problem.library.sites
    values = Hypothesis({k: fit.columns.base.get(k, s.nominal) for k, s in sites.items()})
    priors = Priors(
        spreads=thresholds.SPREADS + thresholds.WIDER,
        tolerances=thresholds.DAY_TOLERANCES,
        covariance=evidence.posterior(score),
        sizes=thresholds.DAY_SIZES,
        log_sizes=-0.5 * (np.log(thresholds.DAY_SIZES) / thresholds.DAY_FACTOR) ** 2,
    )
    apart = evidence.apart(score.members, score.spread)
    left_out = [unknowns.moved(values, evidence.departures(one)) for one in apart]
    # Windows between those that are fitted belong to the part of their neighbour.
    place = np.searchsorted(np.flatnonzero(at.chosen), np.arange(at.chosen.size))
    part = evidence.part[np.minimum(place, evidence.part.size - 1)]
    squares = np.stack([problem.noise_levels(h) for h in (Hypothesis(), *left_out)])
    squares = np.stack([squares[0], squares[1 + part, np.arange(part.size)]])
    windows = [problem.replay.recording == i for i in range(len(problem.series))]
    return Specimen(
        problem=problem,
        values=values,
        priors=priors,
        spread=Spread.of(at, _apart(at, left_out)),
        kappa=kappa,
        levels=np.sqrt([squares[:, own].mean(axis=1) for own in windows]),
        usual=np.sqrt([np.median(squares[1, own]) for own in windows]),
        chosen=at.chosen,
        left_out=tuple(left_out),
    )


def _apart(at: Errors, left_out: Sequence[Hypothesis]) -> np.ndarray:
    """Errors of each part of the recordings by the fit without it, (windows, rows)."""
    part = parts_of(at.recording)
    errors = np.stack([at.at(h) for h in left_out])[part, np.arange(part.size)]
    return np.clip(errors, -thresholds.BLOWN, thresholds.BLOWN)
