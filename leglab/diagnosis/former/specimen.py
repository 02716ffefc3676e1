"""The specimen at hand, from recordings of it while it was healthy."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.former.discrepancy import Discrepancy
from leglab.diagnosis.former.fitting import Fit
from leglab.diagnosis.former.nuisances import all_strengths
from leglab.diagnosis.former.rough import settled_baseline
from leglab.diagnosis.former.search import Progress, baseline, thinned
from leglab.diagnosis.replay.residual import Problem
from leglab.diagnosis.replay.windows import UniformSeries


@dataclass(frozen=True, kw_only=True, eq=False)
class Specimen:
    """A machine as its healthy recordings show it.

    Attributes:
        problem: Healthy recordings and model.
        fit: Of all strengths within what is barely noticeable, or within their tolerances where
            that explains the healthy recordings.
        before: Normalised error of every healthy recording by the model as it was.
        after: The same by the calibrated model.
        discrepancy: That the calibrated model leaves; None where it leaves noise alone.
    """

    problem: Problem
    fit: Fit
    before: tuple[float, ...]
    after: tuple[float, ...]
    discrepancy: Discrepancy | None

    @property
    def values(self) -> Hypothesis:
        """Values of the strengths."""
        return self.fit.hypothesis

    def discrepancy_of(self, series: Sequence[UniformSeries]) -> Discrepancy | None:
        """The discrepancy to expect in other recordings: that of the most similar motion each."""
        if self.discrepancy is None:
            return None
        return self.discrepancy.of(self.nearest(series))

    def nearest(self, series: Sequence[UniformSeries]) -> list[int]:
        """The healthy recording of the most similar motion to each of others."""
        columns = self.problem.machine.columns
        known = np.stack([motion(one, columns) for one in self.problem.series])
        return [int(np.argmin(((known - motion(one, columns)) ** 2).sum(axis=1))) for one in series]


def motion(series: UniformSeries, columns: Sequence[str]) -> np.ndarray:
    """How far and how fast a recording goes: logarithms of spreads and rates, (2 columns,)."""
    values = np.stack([series.columns[column] for column in columns])
    spread = np.std(values, axis=1)
    rate = np.sqrt(np.mean(np.diff(values, axis=1) ** 2, axis=1)) / series.period
    return np.log(np.concatenate([spread, rate]) + 1e-9)


def calibrate(problem: Problem, progress: Progress) -> Specimen:
    """Fits the model to healthy recordings of a specimen.

    Args:
        problem: Healthy recordings, all fitted.
        progress: Called with what is being done.
    """
    limits = problem.thresholds
    count = problem.fitted.sum()
    chosen = thinned(problem.fitted, max(1, round(count / limits.calibration_windows)))
    progress("calibration of the specimen")
    fit = baseline(problem, chosen)
    exact = float(problem.window_cost(fit.hypothesis).mean()) <= limits.explained
    if not exact:
        nuisances = all_strengths(problem.library, 1.0, limits.healthy_tolerance)
        problem = problem.with_nuisances(nuisances)
        problem, fit = settled_baseline(problem, chosen, sharpenings=limits.sharpenings)
    return Specimen(
        problem=problem,
        fit=fit,
        before=_levels(problem, Hypothesis()),
        after=_levels(problem, fit.hypothesis),
        discrepancy=None if exact else problem.discrepancy(fit.hypothesis),
    )


def _levels(problem: Problem, hypothesis: Hypothesis) -> tuple[float, ...]:
    """Root mean square of every recording in noise levels."""
    squares = problem.noise_levels(hypothesis)
    windows = (problem.replay.recording == i for i in range(len(problem.series)))
    return tuple(float(np.sqrt(squares[own].mean())) for own in windows)
