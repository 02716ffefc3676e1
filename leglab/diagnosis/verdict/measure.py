"""The error that `explained` compares: in noise levels, or beside a healthy specimen's own."""

from dataclasses import dataclass

import numpy as np

from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.former.naming import rms
from leglab.diagnosis.former.specimen import Specimen
from leglab.diagnosis.replay.residual import Problem


@dataclass(frozen=True, kw_only=True, eq=False)
class Measure:
    """Errors of hypotheses in some windows, and what is no part of a gap there.

    Where healthy recordings have shown how far the model misses this specimen, errors count by how
    unusual they are for it, and single windows by their logarithm: else a few windows that start
    in stick-slip, as healthy ones do, would hide what the fault opens in all others.

    Attributes:
        problem: Under the discrepancy of the healthy specimen where that has one.
        weighed: Whether it has.
        floors: Mean square that the healthy specimen, or noise, gives in each recording,
            (recordings,).
    """

    problem: Problem
    weighed: bool
    floors: np.ndarray

    @classmethod
    def of(cls, problem: Problem, specimen: Specimen | None) -> "Measure":
        """The measure for recordings, with what healthy ones of the specimen said."""
        if specimen is None:
            return cls(problem=problem, weighed=False, floors=np.ones(len(problem.series)))
        nearest = specimen.nearest(problem.series)
        if specimen.discrepancy is None:
            floors = np.array(specimen.after)[nearest] ** 2
            return cls(problem=problem, weighed=False, floors=floors)
        healthy = specimen.problem.trusting(specimen.discrepancy)
        costs = healthy.window_cost(specimen.values)
        recording = healthy.replay.recording
        own = [costs[recording == i].mean() for i in range(len(healthy.series))]
        trusted = problem.trusting(specimen.discrepancy_of(problem.series))
        return cls(problem=trusted, weighed=True, floors=np.array(own)[nearest])

    def squares(self, hypothesis: Hypothesis) -> np.ndarray:
        """Mean square error of a hypothesis in every window, (windows,)."""
        if self.weighed:
            return self.problem.window_cost(hypothesis)
        return self.problem.noise_levels(hypothesis)

    def hardly_shows(self, windows: np.ndarray, without: Hypothesis, final: Hypothesis) -> bool:
        """Whether effects show in few of a mask of windows beside all, (windows,).

        They show where they move the prediction by more than the model errs. What they move, not
        what they mend: that would excuse effects that are wrong there. How many windows, not how
        far: a play shows in a few, which say nothing of all the others.

        Args:
            windows: The mask.
            without: The final hypothesis without the effects.
            final: With them.
        """
        problem = self.problem
        change = problem.raw_errors(without) - problem.raw_errors(final)
        shows = np.mean(problem.noise.white(change) ** 2, axis=1) > 1.0
        return bool(shows[windows].mean() < problem.thresholds.shown_share * shows.mean())

    def floor(self, windows: np.ndarray) -> float:
        """RMS error that is no part of the gap in a mask of windows."""
        return rms(self.floors[self.problem.replay.recording[windows]])
