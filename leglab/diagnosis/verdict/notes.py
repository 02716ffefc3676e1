"""Notes on the recordings and the fit for the reader of a verdict, one line per note."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import mannwhitneyu

from leglab.base.recording import Recording
from leglab.diagnosis.effects.hypothesis import Key, Library
from leglab.diagnosis.intake.remarks import Remark, merged
from leglab.diagnosis.intake.series import UniformSeries
from leglab.diagnosis.intake.states import state_changes
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.replay.pushes import poses
from leglab.diagnosis.replay.residual import Problem
from leglab.diagnosis.thresholds import NEGLIGIBLE

# Minimum number of windows with a state's value, and of windows without it, to compare them.
_FEWEST = 5
# Significance level of the comparison, at which one irrelevant state in a thousand is reported.
_CHANCE = 1e-3


def notes(problem: Problem) -> tuple[str, ...]:
    """Returns remarks on missing pressures and samples, and on contacts."""
    found = []
    touching = touching_share(problem.machine, problem.series)
    if touching:
        found.append(
            f"the machine touches something {100 * touching:.0f} % of the time and no sensor tells "
            "with what force: a friction or a force that is named may be the contact's"
        )
    if problem.machine.cylinders and not any(c.chamber for c in problem.channels):
        found.append(
            "no chamber pressures: they were replayed from the commands; faults of mechanism and "
            "hydraulics are told apart by the motion alone, with wider intervals"
        )
    lost = {series.name: int((~series.valid).sum()) for series in problem.series}
    text = "windows over gaps are skipped"
    gaps = [Remark(text, name, f"{count} samples") for name, count in lost.items() if count]
    return (*found, *merged(gaps, lost))


def by_states(
    problem: Problem, recordings: Mapping[str, Recording], squares: np.ndarray
) -> tuple[str, ...]:
    """Reports values of a state (mode, contact) during which the error is larger.

    Args:
        problem: Problem whose windows are compared.
        recordings: Recordings as logged, by name, with columns of states.
        squares: Mean squares of the errors of all windows, (windows,).

    Returns:
        One line for each value during which the median RMS error is more than twice as large as in
        the other windows, with significantly different ranks (Mann and Whitney 1947).
    """
    replay = problem.replay
    values: dict[str, np.ndarray] = {}
    for number, series in enumerate(problem.series):
        recording = recordings[series.name]
        own = np.flatnonzero(replay.recording == number)
        for column in state_changes(recording, problem.machine.columns, problem.thresholds.window):
            row = np.searchsorted(recording.time, replay.start[own], side="right") - 1
            whole = values.setdefault(column, np.full(replay.windows, np.nan))
            whole[own] = recording[column][np.maximum(row, 0)]
    lines = []
    for column, state in values.items():
        for value in np.unique(state[np.isfinite(state)]).tolist():
            there, elsewhere = (
                squares[state == value],
                squares[np.isfinite(state) & (state != value)],
            )
            if min(there.size, elsewhere.size) < _FEWEST:
                continue
            ratio = float(np.sqrt(np.median(there) / np.median(elsewhere)))
            sure = mannwhitneyu(there, elsewhere).pvalue < _CHANCE
            if sure and ratio > 2.0:
                lines.append(
                    f"the error is {ratio:.2g} times that of the other windows while {column} = "
                    f"{value:g}: does the machine change with it?"
                )
    return tuple(lines)


def at_limits(library: Library, values: Mapping[Key, np.ndarray]) -> tuple[str, ...]:
    """Reports the parameters whose fit ended at the smallest or largest value, one line each.

    `values` has the fitted values of effects, (parameters,) each.
    """
    lines = []
    for key, fitted in values.items():
        site = library.sites[key]
        for p, value, nominal in zip(site.parameters, fitted, site.nominal, strict=True):
            room = NEGLIGIBLE * (p.upper - p.lower)
            suffix = "" if p.unit == "1" else f" {p.unit}"
            ends = (("smallest", p.lower, value - p.lower), ("largest", p.upper, p.upper - value))
            lines += [
                f"{key[0]} at {key[1]}: {p.name} ended at {end:.4g}{suffix}, the {word} that is "
                "tried: the true value may lie beyond, and its other parameters are less sure"
                for word, end, left in ends
                if left <= room < abs(value - nominal)
            ]
    return tuple(lines)


def touching_share(machine: Machine, series: Sequence[UniformSeries]) -> float:
    """Computes the share of the measured poses in which bodies of the model touch."""
    touched = []
    for one in series:
        some = np.linspace(0, one.time.size - 1, 50).astype(int)  # 50 samples suffice for a share
        touched += [data.ncon > 0 for data in poses(machine, one, some)]
    return float(np.mean(touched))
