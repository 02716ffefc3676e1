"""Onsets of faults that begin during a recording."""

from collections.abc import Sequence

import numpy as np

from leglab.base.scale import rms
from leglab.diagnosis import thresholds
from leglab.diagnosis.effects.hypothesis import Hypothesis, Key
from leglab.diagnosis.likelihood.columns import Errors
from leglab.diagnosis.likelihood.priors import Priors
from leglab.diagnosis.likelihood.unknowns import Unknowns
from leglab.diagnosis.replay.residual import Problem, noise_alone, thinned
from leglab.diagnosis.search.settle import Candidate, Fitter
from leglab.diagnosis.thresholds import EXPLAINED


def onset_of(problem: Problem) -> np.ndarray | None:
    """Finds the times [s] from which a model no longer explains recordings, (recordings,).

    The time is inf for a recording without such a change; returns None if no recording has one.
    """
    replay = problem.replay
    if noise_alone(problem.noise_levels(Hypothesis()), replay.recording):
        return None
    ends = np.array([series.time[[0, -1]] for series in problem.series])
    limit = ends[:, 0] + thresholds.EARLY_SHARE * np.ptp(ends, axis=1)
    early = problem.fitted & (replay.start + replay.window < limit[replay.recording])
    if early.sum() < thresholds.FEWEST_WINDOWS:
        return None
    some = thinned(early, thresholds.WINDOWS // 2)
    fitter = Fitter(Errors(problem, Unknowns.of(problem.library), some), Priors())
    columns = fitter.at.columns(thresholds.COARSE)
    nothing = Candidate((), {}, columns, *fitter.about(columns.errors))
    # Most fits are given up early, because the first iterations show that the model does not fit.
    hopeless = thresholds.HOPELESS * EXPLAINED
    fit = fitter.fit(nothing, thresholds.KAPPA, give_up=hopeless, renewals=0)
    if fit.level > EXPLAINED:
        return None
    base = fit.columns.base
    cost = problem.window_cost(base)
    windows = [np.flatnonzero(replay.recording == i) for i in range(len(problem.series))]
    rises = (_change_point(np.log(cost[own])) for own in windows)
    changes = {i: change for i, change in enumerate(rises) if change is not None}
    if not changes:
        return None
    errors = problem.raw_errors(base)
    onsets = np.full(len(windows), np.inf)
    for i, change in changes.items():
        coarse = float(replay.start[windows[i][change]] + 0.5 * replay.window)
        onsets[i] = _refined(problem, errors, windows[i], coarse)
    return onsets


def begun(
    problem: Problem, final: Hypothesis, named: Sequence[Key], onsets: np.ndarray
) -> tuple[Hypothesis, dict[Key, np.ndarray]]:
    """Returns a hypothesis whose named effects begin at an onset if the recordings require it.

    An effect is absent in windows that replays with the effect do not fit, and present from the
    start of windows that only replays with the effect fit. The onset is the middle of the interval
    between the two, since an effect that only fast motion shows exceeds the noise late. Also
    returns the earliest and latest possible onset [s] by effect, (recordings, 2), inf without one.
    """
    begin, length = problem.replay.start, problem.replay.window
    between: dict[Key, np.ndarray] = {}
    for key in named:
        present = problem.window_cost(final)
        later = problem.window_cost(final.with_onset(key, onsets))
        if problem.size * (present - later).sum() < 2.0 * thresholds.BEHIND * thresholds.NEAR:
            continue
        absent = problem.window_cost(final.without(key))
        evidence = problem.size * (absent - present)
        ends = np.stack([onsets, onsets], axis=1)
        for i in np.flatnonzero(np.isfinite(onsets)):
            seen, here = onsets[i], problem.replay.recording == i
            after = present[here & (begin > seen)]
            if not after.size:
                continue
            met = present < max(EXPLAINED, thresholds.ONSET_RISE * float(np.median(after)))
            # A bad fit with the effect shows its absence, unless a fit without it is far worse.
            missed = ~met & (absent < thresholds.ONSET_RISE * present)
            out = here & ((evidence < -thresholds.ONSET_TOLD) | missed) & (begin < seen)
            if not out.any():
                continue
            last = begin[out].max()
            clear = (
                here
                & (evidence > thresholds.ONSET_TOLD)
                & met
                & (begin > last)
                & (begin + length < seen)
            )
            seen = min([seen, *begin[clear]])
            ends[i] = min(seen, last + length), seen
        final, between[key] = final.with_onset(key, ends.mean(axis=1)), ends
    return final, between


def _change_point(values: np.ndarray) -> int | None:
    """Finds the first index after the likeliest rise of the values' mean (Page 1954), or None."""
    count = values.size
    places = np.arange(thresholds.FEWEST_WINDOWS, count - thresholds.FEWEST_WINDOWS + 1)
    rise = np.array([values[k:].mean() - values[:k].mean() for k in places])
    gain = np.where(
        rise > np.log(thresholds.ONSET_RISE), rise**2 * places * (count - places) / count, 0.0
    )
    if not gain.any():
        return None
    where = int(places[np.argmax(gain)])
    before, after = values[:where], values[where:]
    # Before a true onset the errors are noise alone, so the costs of windows hardly vary.
    return where if before.std() < 0.5 * (after.mean() - before.mean()) else None


def _refined(problem: Problem, errors: np.ndarray, windows: np.ndarray, onset: float) -> float:
    """Finds the time near a coarse onset at which errors exceed the errors of healthy windows."""
    replay = problem.replay
    start, length = replay.start[windows], replay.window
    healthy = windows[start + length < onset - length]
    near = windows[(start + length > onset - length) & (start < onset + length)]
    if not healthy.size:
        return onset
    level = rms(errors[healthy], axis=0) + 1e-12
    for window in near:
        out = (np.abs(errors[window]) > problem.thresholds.still_noise * level).any(axis=0)
        lasting = out[:-1] & out[1:]
        if lasting.any():
            return float(replay.start[window] + int(np.argmax(lasting)) / replay.bins * length)
    return onset
