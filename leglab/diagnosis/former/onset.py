"""Effects that begin during a recording: when, and whether the onset is needed."""

from collections.abc import Mapping, Sequence

import numpy as np

from leglab.diagnosis.effects.hypothesis import Key
from leglab.diagnosis.former.fitting import Fit
from leglab.diagnosis.former.search import baseline, sharpen, thinned
from leglab.diagnosis.replay.residual import Linearisation, Problem
from leglab.diagnosis.thresholds import DEFAULT, Thresholds


def suspected_onset(problem: Problem, chosen: np.ndarray) -> tuple[np.ndarray, Fit] | None:
    """Change point of the residual of a model that was fitted to the starts of the recordings.

    Returns:
        Times [s], shape (recordings,), inf where a recording shows no change, with the fit of the
        nuisances to what lies before; None where nothing begins.
    """
    replay, limits = problem.replay, problem.thresholds
    first = np.array([series.time[0] for series in problem.series])
    last = np.array([series.time[-1] for series in problem.series])
    limit = (first + limits.early_share * (last - first))[replay.recording]
    end = replay.start + replay.window
    early = problem.fitted & (end < limit)
    if early.sum() < limits.onset_windows:
        return None
    fit = baseline(problem, early)
    cost = problem.window_cost(fit.hypothesis)
    if cost[early].mean() > limits.healthy_cost:
        return None
    windows = [np.flatnonzero(replay.recording == i) for i in range(len(problem.series))]
    changes = [change_point(np.log(cost[own]), limits) for own in windows]
    if all(change is None for change in changes):
        return None
    errors = problem.raw_errors(fit.hypothesis)
    onsets = np.full(len(windows), np.inf)
    for i, (own, change) in enumerate(zip(windows, changes, strict=True)):
        if change is not None:
            coarse = float(replay.start[own[change]] + 0.5 * replay.window)
            onsets[i] = _refined(problem, errors, own, coarse)
    before = problem.fitted & (end < onsets[replay.recording])
    healthy = thinned(before, max(1, round(before.sum() / max(chosen.sum(), 1))))
    base = baseline(problem, healthy).hypothesis
    residual = problem.residual(base, chosen)
    none = np.zeros((*residual.shape, 0))
    at = Linearisation(base=base, residual=residual, tangents=none, nuisances=(), chosen=chosen)
    cost_now = problem.cost(residual, problem.departed(base, ()))
    return onsets, Fit(free=frozenset(), cost=cost_now, at=at)


def checked_onsets(
    problem: Problem, fit: Fit, named: Sequence[Key]
) -> tuple[Fit, Mapping[Key, np.ndarray]]:
    """Drops onsets that are not needed, adds those that are, and centres them.

    Returns:
        The fit, and by effect the earliest and the latest onset [s] that the recordings allow,
        shape (recordings, 2), nan where it begins in none.
    """
    replay, limits = problem.replay, problem.thresholds
    for key in named:
        now = problem.window_cost(fit.hypothesis)
        if key in fit.hypothesis.onsets:
            plain = fit.with_hypothesis(fit.hypothesis.with_onset(key, None))
            plain = sharpen(problem, plain, iterations=3)
            lost = problem.window_cost(plain.hypothesis) - now
            if problem.size * lost.sum() < limits.onset_gain:
                fit = plain
            continue
        absent = problem.window_cost(fit.hypothesis.without(key))
        onsets = np.full(len(problem.series), -np.inf)
        for i in range(onsets.size):
            windows = np.flatnonzero(replay.recording == i)
            saved = np.cumsum(now[windows] - absent[windows])
            best = int(np.argmax(saved))
            needed = problem.size * saved[best] > limits.onset_gain
            if needed and best + 1 >= limits.onset_windows:
                onsets[i] = replay.start[windows[best]] + 1.25 * replay.window
        if np.isfinite(onsets).any():
            later = fit.with_hypothesis(fit.hypothesis.with_onset(key, onsets))
            later = sharpen(problem, later, iterations=3)
            saved = now - problem.window_cost(later.hypothesis)
            if problem.size * saved.sum() > limits.onset_gain:
                fit = later
    return _bracketed(problem, fit, named)


def _bracketed(
    problem: Problem, fit: Fit, named: Sequence[Key]
) -> tuple[Fit, Mapping[Key, np.ndarray]]:
    """Moves onsets to the middle of the time in which the effect may have begun.

    An effect that shows only in fast motion, say, departs from the noise some time after it began.
    It was surely absent in windows that replays with it miss, and present from the start of
    windows that replays without it miss and those with it meet.
    """
    limits = problem.thresholds
    begin, length = problem.replay.start, problem.replay.window
    intervals = {}
    for key in named:
        if key not in fit.hypothesis.onsets:
            continue
        present = problem.window_cost(fit.hypothesis.with_onset(key, None))
        absent = problem.window_cost(fit.hypothesis.not_begun(key))
        evidence = problem.size * (absent - present)
        onsets = fit.hypothesis.onsets[key].copy()
        between = np.where(np.isfinite(onsets), onsets, np.nan)[:, np.newaxis].repeat(2, axis=1)
        for i in np.flatnonzero(np.isfinite(onsets)):
            seen, here = onsets[i], problem.replay.recording == i
            later = present[here & (begin > seen)]
            if not later.size:
                continue
            usual = limits.onset_factor * float(np.median(later))
            met = present < max(limits.healthy_cost, usual)
            # Where a replay without the effect misses far more than one with it, it had begun.
            missed = ~met & (absent < limits.onset_factor * present)
            out = here & ((evidence < -limits.onset_evidence) | missed) & (begin < seen)
            if not out.any():
                continue
            last = begin[out].max()
            clear = here & (evidence > limits.onset_evidence) & met
            seen = min([seen, *begin[clear & (begin > last) & (begin + length < seen)]])
            between[i] = min(seen, last + length), seen
            onsets[i] = between[i].mean()
        fit = fit.with_hypothesis(fit.hypothesis.with_onset(key, onsets))
        intervals[key] = between
    return fit, intervals


def change_point(values: np.ndarray, thresholds: Thresholds = DEFAULT) -> int | None:
    """First index after the most likely rise of the mean (Page 1954), None where there is none."""
    count, least = values.size, thresholds.onset_windows
    best, where = 0.0, None
    for k in range(least, count - least + 1):
        rise = float(values[k:].mean() - values[:k].mean())
        gain = rise**2 * k * (count - k) / count
        if rise > np.log(thresholds.onset_factor) and gain > best:
            best, where = gain, k
    if where is None:
        return None
    before, after = values[:where], values[where:]
    # Windows before a true onset are noise: their costs hardly vary.
    return where if before.std() < 0.5 * (after.mean() - before.mean()) else None


def _refined(problem: Problem, errors: np.ndarray, windows: np.ndarray, onset: float) -> float:
    """First bin, around a coarse onset, in which errors leave those of healthy windows."""
    replay = problem.replay
    start, length = replay.start[windows], replay.window
    healthy = windows[start + length < onset - length]
    near = windows[(start + length > onset - length) & (start < onset + length)]
    if not healthy.size:
        return onset
    level = np.sqrt(np.mean(errors[healthy] ** 2, axis=0)) + 1e-12
    for window in near:
        out = (np.abs(errors[window]) > problem.thresholds.departed_factor * level).any(axis=0)
        lasting = out[:-1] & out[1:]
        if lasting.any():
            return float(replay.start[window] + int(np.argmax(lasting)) / replay.bins * length)
    return onset
