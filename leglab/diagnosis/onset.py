"""Effects that begin during a recording: when, and whether the onset is needed."""

from collections.abc import Sequence

import numpy as np

from leglab.diagnosis.fitting import Fit
from leglab.diagnosis.hypothesis import Hypothesis, Key
from leglab.diagnosis.residual import Problem
from leglab.diagnosis.search import baseline, sharpen, window_cost

# The first part of every recording is taken for healthy ...
_EARLY = 0.25
# ... if the refitted model explains it to this robust mean square.
_HEALTHY = 2.0
_LEAST = 3  # windows on either side of a change
# Windows after a change cost at least this factor more, in the mean of their logarithms.
_FACTOR = 3.0
# Chi-square that an onset must save over the same effect throughout.
_NEEDED = 60.0
# Chi-square by which a window tells that an effect is, or is not, at work in it.
_CLEAR = 12.0
# Errors of a window have left the noise where they exceed that of healthy windows this much.
_DEPARTED = 6.0


def suspected_onset(problem: Problem, chosen: np.ndarray) -> tuple[np.ndarray, Fit] | None:
    """Change point of the residual of a model that was fitted to the starts of the recordings.

    Returns:
        Times [s], shape (recordings,), inf where a recording shows no change, with the fit of the
        nuisances to what lies before; None where nothing begins.
    """
    replay = problem.replay
    early = np.zeros(replay.windows, dtype=bool)
    for i, series in enumerate(problem.series):
        limit = series.time[0] + _EARLY * (series.time[-1] - series.time[0])
        early |= (replay.recording == i) & (replay.start + replay.layout.window < limit)
    early &= problem.fitted
    if early.sum() < _LEAST:
        return None
    fit = baseline(problem, early)
    cost = window_cost(problem, fit.hypothesis)
    if cost[early].mean() > _HEALTHY:
        return None
    onsets = np.full(len(problem.series), np.inf)
    for i in range(onsets.size):
        windows = np.flatnonzero(replay.recording == i)
        first = _change(np.log(cost[windows]))
        if first is not None:
            onsets[i] = replay.start[windows[first]] + 0.5 * replay.layout.window
    if not np.isfinite(onsets).any():
        return None
    errors = problem.raw_errors(fit.hypothesis)
    onsets = np.array([_refined(problem, errors, i, t) for i, t in enumerate(onsets)])
    end = replay.start + replay.layout.window
    before = problem.fitted & (end < onsets[replay.recording])
    every = max(1, round(before.sum() / max(chosen.sum(), 1)))
    healthy = np.zeros_like(before)
    healthy[np.flatnonzero(before)[::every]] = True
    base = baseline(problem, healthy).hypothesis
    residual = problem.residual(base, chosen)
    return onsets, Fit(
        hypothesis=base,
        free=frozenset(),
        cost=problem.cost(residual, problem.prior_cost(base, set())),
        residual=residual,
        tangents=np.zeros((*residual.shape, 0)),
    )


def checked_onsets(problem: Problem, fit: Fit, named: Sequence[Key], chosen: np.ndarray) -> Fit:
    """Drops onsets that are not needed, adds those that are, and centres them."""
    for key in named:
        now = window_cost(problem, fit.hypothesis)
        if key in fit.hypothesis.onsets:
            plain = _with(fit, fit.hypothesis.with_onset(key, None))
            plain = sharpen(problem, plain, chosen, iterations=3)
            if problem.size * (window_cost(problem, plain.hypothesis) - now).sum() < _NEEDED:
                fit = plain
            continue
        absent = window_cost(problem, fit.hypothesis.without(key))
        onsets = np.full(len(problem.series), -np.inf)
        for i in range(onsets.size):
            windows = np.flatnonzero(problem.replay.recording == i)
            saved = np.cumsum(now[windows] - absent[windows])
            best = int(np.argmax(saved))
            if problem.size * saved[best] > _NEEDED and best + 1 >= _LEAST:
                onsets[i] = (
                    problem.replay.start[windows[best]] + 1.25 * problem.replay.layout.window
                )
        if np.isfinite(onsets).any():
            later = _with(fit, fit.hypothesis.with_onset(key, onsets))
            later = sharpen(problem, later, chosen, iterations=3)
            if problem.size * (now - window_cost(problem, later.hypothesis)).sum() > _NEEDED:
                fit = later
    return _bracketed(problem, fit, named)


def _bracketed(problem: Problem, fit: Fit, named: Sequence[Key]) -> Fit:
    """Moves onsets to the middle of the time in which the effect may have begun.

    An effect that shows only in fast motion, say, departs from the noise some time after it began.
    What is sure is that it was absent in windows that replays with it miss, and present from the
    start of windows that replays without it miss and those with it meet.
    """
    begin, length = problem.replay.start, problem.replay.layout.window
    for key in named:
        if key not in fit.hypothesis.onsets:
            continue
        present = window_cost(problem, fit.hypothesis.with_onset(key, None))
        absent = window_cost(problem, fit.hypothesis.without(key))
        evidence = problem.size * (absent - present)
        onsets = fit.hypothesis.onsets[key].copy()
        for i in np.flatnonzero(np.isfinite(onsets)):
            seen, here = onsets[i], problem.replay.recording == i
            later = present[here & (begin > seen)]
            if not later.size:
                continue
            met = present < max(_HEALTHY, _FACTOR * float(np.median(later)))
            out = here & ((evidence < -_CLEAR) | ~met) & (begin < seen)
            if not out.any():
                continue
            last = begin[out].max()
            shown = here & (evidence > _CLEAR) & met & (begin > last) & (begin + length < seen)
            seen = min([seen, *begin[shown]])
            onsets[i] = 0.5 * (seen + min(seen, last + length))
        fit = _with(fit, fit.hypothesis.with_onset(key, onsets))
    return fit


def _with(fit: Fit, hypothesis: Hypothesis) -> Fit:
    return Fit(
        hypothesis=hypothesis,
        free=fit.free,
        cost=fit.cost,
        residual=fit.residual,
        tangents=fit.tangents,
    )


def _change(values: np.ndarray) -> int | None:
    """First index after the most likely rise of the mean (Page 1954), None where there is none."""
    count = values.size
    best, where = 0.0, None
    for k in range(_LEAST, count - _LEAST + 1):
        before, after = values[:k], values[k:]
        rise = float(after.mean() - before.mean())
        gain = rise**2 * k * (count - k) / count
        if rise > np.log(_FACTOR) and gain > best:
            best, where = gain, k
    if where is None:
        return None
    spread = float(np.std(np.concatenate([values[:where], []])))
    # Windows before a true onset are noise: their costs hardly vary.
    return where if spread < 0.5 * (values[where:].mean() - values[:where].mean()) else None


def _refined(problem: Problem, errors: np.ndarray, recording: int, onset: float) -> float:
    """First bin, around a coarse onset, in which errors leave those of healthy windows."""
    if not np.isfinite(onset):
        return float(onset)
    replay = problem.replay
    windows = np.flatnonzero(replay.recording == recording)
    start, length = replay.start[windows], replay.layout.window
    healthy = windows[start + length < onset - length]
    near = windows[(start + length > onset - length) & (start < onset + length)]
    if not healthy.size:
        return float(onset)
    level = np.sqrt(np.mean(errors[healthy] ** 2, axis=0)) + 1e-12
    for window in near:
        out = (np.abs(errors[window]) > _DEPARTED * level).any(axis=0)
        lasting = out[:-1] & out[1:]
        if lasting.any():
            share = int(np.argmax(lasting)) / replay.bins
            return float(replay.start[window] + share * length)
    return float(onset)
