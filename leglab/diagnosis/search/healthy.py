"""Calibrates the model to healthy recordings of the same machine."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from leglab.base.scale import rms
from leglab.diagnosis import thresholds
from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.intake.series import UniformSeries
from leglab.diagnosis.likelihood.columns import Errors
from leglab.diagnosis.likelihood.priors import Priors
from leglab.diagnosis.likelihood.spread import Spread
from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.replay.residual import Problem, thinned
from leglab.diagnosis.search.settle import Candidate, Fitter


@dataclass(frozen=True, eq=False)
class Specimen:
    """A machine as its healthy recordings show it."""

    problem: Problem  #: Healthy recordings and machine
    values: Hypothesis  #: Of all strengths
    priors: Priors  #: Of the same machine on another day
    spread: Spread  #: Pattern of the error that the calibrated model leaves, by healthy recording
    kappa: float  #: 1/design effect
    #: Error of each healthy recording in noise levels, before and after calibration, (recordings,
    #: 2).
    levels: np.ndarray
    #: Median error of its windows after calibration, in noise levels, (recordings,).
    usual: np.ndarray

    def nearest(self, problem: Problem) -> list[int]:
        """The healthy recording of the most similar motion to each of others."""
        columns = problem.machine.columns
        own = np.stack([_motion(s, columns) for s in self.problem.series])
        other = np.stack([_motion(s, columns) for s in problem.series])
        return np.argmin(((other[:, None] - own) ** 2).sum(axis=2), axis=1).tolist()

    def as_it_was(self, problem: Problem) -> bool:
        """Whether errors in all windows are those of the healthy specimen on another day.

        In every recording: one that moves tells more than three that rest. Nothing is moved for it:
        what a day changes may hide a fault.
        """
        level, recording = problem.noise_levels(Hypothesis()) ** 0.5, problem.replay.recording
        ratio = level / self.usual[np.array(self.nearest(problem))[recording]]
        largest = max(float(np.median(ratio[recording == r])) for r in np.unique(recording))
        # Of several recordings the largest departs by two deviations where none is ill.
        limits = np.exp([thresholds.DAY_FACTOR, 2.0 * thresholds.DAY_FACTOR])
        return bool(np.median(ratio) <= limits[0] and largest <= limits[1])


def _motion(series: UniformSeries, columns: Sequence[str]) -> np.ndarray:
    """How far and how fast a recording goes: logarithms of spreads and rates, (2 columns,)."""
    values = np.stack([series.columns[column] for column in columns])
    spread = np.std(values, axis=1)
    rate = rms(np.diff(values, axis=1), axis=1) / series.period
    return np.log(np.concatenate([spread, rate]) + 1e-9)


def calibrate(problem: Problem, log: Callable[[str], None]) -> Specimen:
    """Fits all strengths to healthy recordings, under the priors of machines as they are built."""
    unknowns = Unknowns.of(problem.library)
    at = Errors(problem, unknowns, thinned(problem.fitted, 3 * thresholds.WINDOWS // 2))
    fitter = Fitter(at, Priors())
    first = at.columns(thresholds.COARSE)
    spread, weight = fitter.about(first.errors)
    kappa = thresholds.KAPPA
    for _ in range(2):
        fit = fitter.fit(Candidate((), {}, first, spread, weight), kappa)
        spread, weight, first = fit.spread, fit.weight, fit.columns
        evidence = fitter.evidence(first, spread, weight, kappa)
        kappa = 1.0 / max(evidence.design_effect(evidence.score(())), 1.0)
        log(f"  healthy: level {fit.level:.4g} kappa {kappa:.3f}")
    # From here on the error that is left has size 1.
    unit = Priors(sizes=(1.0,), log_sizes=np.zeros(1))
    evidence = fitter.evidence(first, Spread.of(at, first.errors), weight, kappa, unit)
    score = evidence.score(())
    sites = problem.library.sites
    values = Hypothesis({k: first.base.get(k, s.nominal) for k, s in sites.items()})
    priors = Priors(
        spreads=thresholds.SPREADS + thresholds.WIDER,
        tolerances=thresholds.DAY_TOLERANCES,
        covariance=evidence.posterior(score),
        sizes=thresholds.DAY_SIZES,
        log_sizes=-0.5 * (np.log(thresholds.DAY_SIZES) / thresholds.DAY_FACTOR) ** 2,
    )
    squares = [problem.noise_levels(h) for h in (Hypothesis(), values)]
    windows = [problem.replay.recording == i for i in range(len(problem.series))]
    levels = np.sqrt([[square[own].mean() for square in squares] for own in windows])
    usual = np.sqrt([np.median(squares[1][own]) for own in windows])
    return Specimen(problem, values, priors, evidence.spread, kappa, levels, usual)
