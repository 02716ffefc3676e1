"""The diagnosis from recordings to verdict."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from leglab.base.recording import Recording
from leglab.diagnosis.fitting import Fit, refit
from leglab.diagnosis.hypothesis import Hypothesis, Key, Library
from leglab.diagnosis.judging import rarely_but_surely, t_value
from leglab.diagnosis.model import Machine
from leglab.diagnosis.onset import checked_onsets, suspected_onset
from leglab.diagnosis.recordings import check_recordings
from leglab.diagnosis.replay import Layout
from leglab.diagnosis.residual import Problem
from leglab.diagnosis.search import (
    Contender,
    Stage,
    baseline,
    pair_search,
    round_of_search,
    sharpen,
    thinned,
    window_cost,
)
from leglab.diagnosis.windows import Series, channels, sampling_period

# Robust mean square error below which nothing more is missing: noise gives 1, windows that start
# in stick-slip or beside jumps of the command lift it on good models to at most this.
EXPLAINED = 2.0
# Below it not even a further round is worthwhile.
_CLEAN = 1.25
# An effect is named only if its strength is at least this share of its smallest trial ...
_NOTICEABLE = 0.15
# ... and saves at least this much of a noise variance, or of what was in excess of noise.
_WORTHWHILE = 0.08
_SIGNIFICANT = 2.5  # t value of paired window differences on held-out recordings
# Above it more is certainly missing, and finishing the present fit can wait.
_MUCH = 8.0
# Two effects at once must cost less than this share of the best single one.
_TOGETHER = 0.6
# An early effect may be swapped for a rival that cost at most this factor more.
_NEAR = 1.2
_ROUNDS = 3
# The noise model is taken about the fit and the fit made anew, this often at most.
_SETTLING = 3
_SCREENED_WINDOWS = 40


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How a diagnosis is done.

    Attributes:
        layout: How recordings are cut.
        effects: Names of the effects to consider; None for all.
        excluded: Names of effects to leave out.
        threads: Of the rollouts.
        seed: Of the bootstraps.
        rounds: How many effects may be named.
    """

    layout: Layout = field(default_factory=Layout)
    effects: tuple[str, ...] | None = None
    excluded: tuple[str, ...] = ()
    threads: int = 2
    seed: int = 0
    rounds: int = _ROUNDS


@dataclass(kw_only=True, eq=False)
class Search:
    """What the search found.

    Attributes:
        problem: With its noise model about the final fit.
        baseline: Unmodified model, nuisances refitted.
        fit: The final fit.
        named: Effects in the order of discovery.
        stages: All rounds, the last one included that found nothing.
        chosen: Windows of the fits.
    """

    problem: Problem
    baseline: Fit
    fit: Fit
    named: tuple[Key, ...]
    stages: list[Stage]
    chosen: np.ndarray


def replay_timestep(machine: Machine, period: float) -> float:
    """Longest time step that divides the sampling period and is at most twice the model's own.

    The error that it makes is measured and taken off (`Problem`).
    """
    return period / max(1, int(np.ceil(period / (2.0 * machine.file_timestep) - 1e-9)))


def set_up(
    model: str | Path,
    recordings: Mapping[str, Recording],
    held_out: Iterable[str],
    settings: Settings,
) -> Problem:
    """Builds the fit problem.

    Raises:
        LeglabError: Model or recordings do not fit each other, or are too short.
    """
    machine = Machine(model)
    found = channels(machine, recordings)
    check_recordings(machine, recordings)  # Before anything is replayed with wrong units.
    period = sampling_period(recordings)
    machine = machine.at_timestep(replay_timestep(machine, period))
    needed = tuple(dict.fromkeys([*(c.column for c in found), *machine.columns]))
    series = [Series.from_recording(r, name, needed) for name, r in recordings.items()]
    held = set(held_out)
    fit = [i for i, name in enumerate(recordings) if name not in held]
    library = Library(machine, names=settings.effects, excluded=settings.excluded)
    return Problem(machine, library, series, found, settings.layout, fit, threads=settings.threads)


def search(
    problem: Problem, settings: Settings, progress: Callable[[str], None] = lambda _: None
) -> Search:
    """Finds the effects that are missing, one a round."""
    rng = np.random.default_rng(settings.seed)
    every = max(1, round(problem.fitted.sum() / _SCREENED_WINDOWS))
    chosen = thinned(problem.fitted, every)
    progress("baseline")
    floor = baseline(problem, chosen)
    current = floor
    named: list[Key] = []
    stages: list[Stage] = []
    # Nuisances that a missing effect has pulled along would mislead the screening.
    typical = floor.cost / (problem.size * chosen.sum())
    start = floor.hypothesis if typical < EXPLAINED else Hypothesis()
    onset = None
    if typical > EXPLAINED:
        progress("looking for an onset")
        suspect = suspected_onset(problem, chosen)
        if suspect is not None:
            onset, current = suspect
            start = current.hypothesis
    while len(stages) < settings.rounds:
        stage = round_of_search(
            problem, start, frozenset(named), current, chosen, rng, progress, onset
        )
        stages.append(stage)
        best = min((c.cost.mean() for c in stage.contenders), default=np.inf)
        if not named and onset is None and best > _MUCH and stage.base.mean() > _MUCH:
            pair = pair_search(problem, stage, chosen, progress)
            if pair is not None and pair[0].cost.mean() < _TOGETHER * min(best, stage.base.mean()):
                contender, first = pair
                stages.append(replace(stage, contenders=(contender,)))
                named = [first, contender.key]
                current = contender.fit
                if contender.cost.mean() < _CLEAN:
                    break
                if contender.cost.mean() < _MUCH:
                    current = _settled(problem, current, chosen)
                start = current.hypothesis
                if window_cost(problem, start).mean() > EXPLAINED:
                    start = start.only(current.free)
                continue
        winner = next((c for c in stage.contenders if _accepted(problem, stage, c, chosen)), None)
        if winner is None:
            break
        named.append(winner.key)
        current = winner.fit
        if winner.cost.mean() < _CLEAN:
            break
        if winner.cost.mean() < _MUCH:
            # What the next round sees must not be what this one left half fitted.
            progress("refining")
            current = _settled(problem, current, chosen)
        left = float(window_cost(problem, current.hypothesis).mean())
        if left < _CLEAN:
            break
        start = current.hypothesis
        if left > EXPLAINED:
            start = start.only(current.free)
    if len(named) > 1:
        progress("checking each effect against the others")
        current, named = _pruned(problem, current, named, stages, chosen)
    if named:
        progress("last refinement")
        chosen = thinned(problem.fitted, max(1, every // 2))
        current = _settled(problem, current, chosen)
        current = checked_onsets(problem, current, named, chosen)
    return Search(
        problem=problem,
        baseline=floor,
        fit=current,
        named=tuple(named),
        stages=stages,
        chosen=chosen,
    )


def _settled(problem: Problem, fit: Fit, chosen: np.ndarray) -> Fit:
    """Noise model about the fit and fit under the noise model, in turn until they agree."""
    cost = np.inf
    for _ in range(_SETTLING):
        problem.rewhiten(fit.hypothesis)
        fit = sharpen(problem, fit, chosen, iterations=6)
        now = float(window_cost(problem, fit.hypothesis).mean())
        if now < _CLEAN or now > 0.95 * cost:
            break
        cost = now
    return fit


def _accepted(problem: Problem, stage: Stage, contender: Contender, chosen: np.ndarray) -> bool:
    """Whether the gain is beyond chance, holds on held-out recordings, and matters."""
    saved = stage.base - contender.cost
    held = problem.held if problem.held.sum() > 3 else np.ones_like(problem.held)
    if problem.size * saved[chosen].sum() < stage.threshold:
        return False
    if t_value(saved[held]) < _SIGNIFICANT and not rarely_but_surely(saved[held]):
        return False
    if saved.mean() < _WORTHWHILE * max(1.0, stage.base.mean() - 1.0):
        return False
    return noticeable(problem, contender.key, contender.fit.hypothesis)


def noticeable(problem: Problem, key: Key, hypothesis: Mapping[Key, np.ndarray]) -> bool:
    """Whether a strength departs from nominal by a share of its smallest trial that matters."""
    site = problem.library.sites[key]
    return any(
        abs(value - p.nominal) > _NOTICEABLE * p.scale
        for value, p in zip(hypothesis[key], site.parameters, strict=True)
        if p.role == "strength"
    )


def _pruned(
    problem: Problem, current: Fit, named: list[Key], stages: list[Stage], chosen: np.ndarray
) -> tuple[Fit, list[Key]]:
    """Drops effects that later ones made needless, and swaps early impostors for their rivals."""
    best = window_cost(problem, current.hypothesis)
    nuisances = problem.active_nuisances(set(current.free))
    tangents = current.tangents

    def fitted(free: frozenset[Key], start: Hypothesis) -> Fit:
        return refit(problem, start, free, chosen, tangents, nuisances, iterations=3, fine=0.3)

    for key in list(named):
        others = frozenset(named) - {key}
        without = fitted(others, current.hypothesis.without(key))
        cost = window_cost(problem, without.hypothesis)
        if (cost - best).mean() < _WORTHWHILE * max(1.0, cost.mean() - 1.0):
            return without, [k for k in named if k in others]
        stage = next((s for s in stages if any(c.key == key for c in s.contenders)), None)
        rivals = () if stage is None else stage.contenders
        limit = _NEAR * min((c.cost.mean() for c in rivals if c.key == key), default=0.0)
        for rival in rivals:
            if rival.key in named or rival.cost.mean() > limit:
                continue
            start = current.hypothesis.without(key)
            start = start.with_values(rival.key, rival.fit.hypothesis[rival.key])
            swapped = fitted(others | {rival.key}, start)
            cost = window_cost(problem, swapped.hypothesis)
            if t_value(best - cost) > _SIGNIFICANT:
                current, best = swapped, cost
                named = [rival.key if k == key else k for k in named]
                break
    return current, named
