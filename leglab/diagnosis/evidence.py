"""What a verdict rests on: residual series, refitted nuisances, notes for the reader."""

import numpy as np

from leglab.diagnosis.effects.joints import unit
from leglab.diagnosis.fitting import Fit
from leglab.diagnosis.hypothesis import Hypothesis
from leglab.diagnosis.problem import Problem
from leglab.diagnosis.result import Estimate, ResidualTrace


def nuisance_estimates(problem: Problem, fit: Fit) -> tuple[Estimate, ...]:
    """Refitted nuisance parameters, with the range of their tolerance."""
    rows = []
    for n in problem.active_nuisances(set(fit.free)):
        parameter = problem.library.sites[n.key].parameters[n.index]
        value = fit.hypothesis[n.key][n.index] if n.key in fit.hypothesis else n.nominal
        rows.append(
            Estimate(
                name=parameter.name,
                unit=parameter.unit,
                value=float(value),
                nominal=n.nominal,
                interval=(n.nominal - 1.96 * n.tolerance, n.nominal + 1.96 * n.tolerance),
            )
        )
    return tuple(rows)


def notes(problem: Problem) -> tuple[str, ...]:
    """What the reader should know about the recordings."""
    found = []
    if problem.machine.instances("leglab.cylinder") and not any(
        c.chamber for c in problem.channels
    ):
        found.append(
            "no chamber pressures: they were replayed from the commands; faults of mechanism and "
            "hydraulics are told apart by the motion alone, with wider intervals"
        )
    for series in problem.series:
        lost = int((~series.valid).sum())
        if lost:
            found.append(
                f"{series.name}: {lost} samples are missing; windows over them are skipped"
            )
    return tuple(found)


def traces(problem: Problem, final: Hypothesis) -> tuple[ResidualTrace, ...]:
    """Replay errors before and after, of every recording and channel."""
    replay = problem.replay
    before = problem.raw_errors(Hypothesis())
    after = problem.raw_errors(final)
    per_bin = replay.samples // replay.bins
    period = problem.series[0].period
    rows = []
    for i, series in enumerate(problem.series):
        mask = replay.recording == i
        middle = (np.arange(replay.bins) + 0.5) * per_bin
        first = np.round((replay.start[mask] - series.time[0]) / period)
        index = np.minimum((first[:, None] + middle).astype(int), series.time.size - 1).ravel()
        for k, channel in enumerate(problem.channels):
            q = series.columns[f"{channel.joint}_position"]
            first_chamber = series.columns.get(f"{channel.joint}_pressure_a")
            second_chamber = series.columns.get(f"{channel.joint}_pressure_b")
            difference = None
            if first_chamber is not None and second_chamber is not None:
                difference = (first_chamber - second_chamber)[index]
            rows.append(
                ResidualTrace(
                    recording=series.name,
                    channel=channel.column,
                    unit="Pa" if channel.chamber else unit(problem.machine, channel.joint),
                    time=series.time[index],
                    position=q[index],
                    velocity=np.gradient(q, period)[index],
                    pressure=difference,
                    before=before[mask, k].ravel(),
                    after=after[mask, k].ravel(),
                )
            )
    return tuple(rows)
