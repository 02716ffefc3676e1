"""Tuning of a sweep's block by Optuna, which proposes each point from the figures of earlier ones.

A point (a trial of Optuna) has one run per combination of the block's grid; its value is the mean
or the worst of one figure over these runs. Point 0, the baseline, sets none of the ranges. Each
proposal uses a new sampler with its own seed and depends only on earlier proposals and figures, so
a sweep that continues after a kill proposes the same points as an uninterrupted sweep.
"""

import statistics
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from leglab.base.errors import LeglabError
from leglab.runs.sweeps.plan import Runs, SweepPlan
from leglab.runs.sweeps.rows import column

Figures = Mapping[int, float | None]


def check_optuna(samplers: set[str]) -> None:
    """Tests that the packages of samplers are installed.

    Args:
        samplers: Names as in `Block.draw`.

    Raises:
        LeglabError: A package is missing; the message says how to install it.
    """
    if not find_spec("optuna"):
        raise LeglabError(
            f"draw = {min(samplers)!r} needs the package optuna: pip install 'leglab[tune]'"
        )
    if "gp" in samplers and not find_spec("torch"):
        raise LeglabError(
            "draw = 'gp' needs the package torch: pip install torch; allowed without it: 'tpe'"
        )


def due(points: Runs) -> range:
    """Returns the points of the next batch without proposals; empty after the last batch."""
    end = min(before(points).stop + points.tune.together, points.points)
    return range(len(points.proposals) + 1, end)


def before(points: Runs) -> range:
    """Returns the points of earlier batches, whose runs must be done before the next batch."""
    batch = len(points.proposals) // points.tune.together
    return range(1, batch * points.tune.together + 1)


def propose(points: Runs, figures: Figures) -> dict[str, float]:
    """Proposes the next point of a block.

    Args:
        points: Runs of the block, with the proposals so far.
        figures: The tuned figure by number of the run, None if a run lacks it. Figures of the
            current batch are ignored.

    Returns:
        A value for each of the block's ranges, by dotted name.
    """
    import optuna
    from optuna.trial import TrialState, create_trial

    tune, drawn = points.tune, (points.block.draw_seed, points.number, len(points.proposals) + 1)
    kinds: dict[str, optuna.distributions.BaseDistribution] = {
        name: optuna.distributions.FloatDistribution(one.low, one.high, log=one.log)
        for name, one in points.ranges.items()
    }
    seed = int(np.random.SeedSequence(drawn).generate_state(1)[0])
    shown = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        with warnings.catch_warnings(action="ignore"):
            samplers = optuna.samplers
            sampler = samplers.GPSampler if points.block.draw == "gp" else samplers.TPESampler
            study = optuna.create_study(
                sampler=sampler(seed=seed),
                direction="minimize" if tune.aim == "lowest" else "maximize",
            )
            for earlier, values in sorted(points.proposals.items()):
                value, state = None, TrialState.RUNNING
                if earlier in before(points):
                    value = value_of(points, earlier, figures)
                    # A point without a value is a pruned trial, which Optuna ranks below others.
                    state = TrialState.PRUNED if value is None else TrialState.COMPLETE
                study.add_trial(
                    create_trial(state=state, params=values, distributions=kinds, value=value)
                )
            return {name: float(value) for name, value in study.ask(kinds).params.items()}
    finally:
        optuna.logging.set_verbosity(shown)


def value_of(points: Runs, point: int, figures: Figures) -> float | None:
    """Returns a point's value, to be minimised or maximised; None if a run has no figure."""
    found = [figures.get(number) for number in points.runs(point)]
    values = [value for value in found if value is not None]
    if len(values) < len(found):
        return None
    if points.tune.over == "mean":
        return statistics.fmean(values)
    return max(values) if points.tune.aim == "lowest" else min(values)


@dataclass(frozen=True, kw_only=True)
class Tuned:
    """Result of tuning a block."""

    block: int  #: Number of the block, from 1 on
    metric: str  #: Column that is tuned
    over: str  #: "mean" or "worst" of the column over the grid
    runs: int  #: Number of runs of a point
    points: int  #: Number of points with a value, including the baseline
    given_up: int  #: Number of points without a value, since a run failed or lacks the figure
    as_it_is: float | None  #: Value of the baseline, point 0; None if a run of it lacks the figure
    best: float | None  #: Value of the best point
    point: int  #: Number of the best point; 0 if none is better than the baseline
    values: dict[str, float]  #: Settings of the best point by dotted name

    def __str__(self) -> str:
        over = f"{self.over} {self.metric} of {self.runs} run{'s' * (self.runs > 1)}"
        if self.best is None:
            return f"block {self.block}: no point has a {over}"
        tried = f"{self.points + self.given_up} points"
        if self.point == 0:
            return (
                f"block {self.block}: none of {tried} is better than the block as it is: "
                f"{over} {self.best:.4g}"
            )
        chosen = ", ".join(f"{name} = {value:.4g}" for name, value in self.values.items())
        text = f"block {self.block}: best of {tried} is point {self.point}, {chosen}: "
        text += f"{over} {self.best:.4g}"
        if self.as_it_is is None:
            return f"{text}; the block as it is has none"
        change = f", {100 * (self.best / self.as_it_is - 1):+.1f} %" if self.as_it_is else ""
        return f"{text}; {self.as_it_is:.4g} as it is{change}"


def tuned(plan: SweepPlan, rows: list[dict[str, Any]]) -> list[Tuned]:
    """Returns the best point of each tuned block.

    Args:
        plan: Plan of the sweep.
        rows: Rows of the dataset with `run`, `status`, and the tuned and varied columns.
    """
    by_run = {row["run"]: row for row in rows}
    found = []
    for points in plan.tuned:
        figures = {n: figure_of(row, points.tune.metric) for n, row in by_run.items()}
        made = [p for p in range(points.points) if all(n in by_run for n in points.runs(p))]
        values = {p: v for p in made if (v := value_of(points, p, figures)) is not None}
        sign = 1.0 if points.tune.aim == "lowest" else -1.0
        # Among equally good points the first is taken, preferably the baseline.
        best = min(values, key=lambda p: (sign * values[p], p), default=None)
        settings = {}
        if best:
            row = by_run[points.runs(best)[0]]
            settings = {name: row[column(name)] for name in points.ranges}
        found.append(
            Tuned(
                block=points.number + 1,
                metric=points.tune.metric,
                over=points.tune.over,
                runs=len(points.runs(0)),
                points=len(values),
                given_up=len(made) - len(values),
                as_it_is=values.get(0),
                best=None if best is None else values[best],
                point=best or 0,
                values=settings,
            )
        )
    return found


def figure_of(row: Mapping[str, Any], metric: str) -> float | None:
    """Returns the tuned figure of a row; None if the run failed or has no such figure."""
    return row[metric] if row["status"] == "ok" else None
