"""The search for missing effects, from recordings to the final fit."""

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from leglab.base.errors import LeglabError
from leglab.base.recording import Recording
from leglab.diagnosis.effects.hypothesis import Hypothesis, Key, Library
from leglab.diagnosis.former.challenge import Checks, challenged
from leglab.diagnosis.former.discrepancy import Discrepancy
from leglab.diagnosis.former.fitting import Fit, refit
from leglab.diagnosis.former.judging import accepted, simplest_first
from leglab.diagnosis.former.onset import checked_onsets, suspected_onset
from leglab.diagnosis.former.rough import cost_under, rough_search, suspected
from leglab.diagnosis.former.search import (
    Contender,
    Progress,
    Round,
    baseline,
    pair_search,
    search_round,
    sharpen,
    thinned,
)
from leglab.diagnosis.former.specimen import Specimen
from leglab.diagnosis.intake.admission import admit
from leglab.diagnosis.intake.series import UniformSeries, common_period
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.replay.residual import Problem
from leglab.diagnosis.replay.windows import channels
from leglab.diagnosis.thresholds import DEFAULT, Thresholds


def _threads() -> int:
    told = os.environ.get("OMP_NUM_THREADS", "")
    return int(told) if told.isdigit() and int(told) else len(os.sched_getaffinity(0))


@dataclass(frozen=True, kw_only=True)
class DiagnosisSettings:
    """Settings of a diagnosis.

    Attributes:
        effects: Names of the effects to consider; None for all.
        excluded: Names of effects to leave out.
        threads: Of the rollouts; by default OMP_NUM_THREADS, or one a core where that is not set.
            Results do not depend on it.
        seed: Of the bootstraps.
        rounds: How many effects may be named.
        thresholds: Of all steps.
    """

    effects: tuple[str, ...] | None = None
    excluded: tuple[str, ...] = ()
    threads: int = field(default_factory=_threads)
    seed: int = 0
    rounds: int = 8
    thresholds: Thresholds = DEFAULT


@dataclass(frozen=True, kw_only=True, eq=False)
class Search:
    """Results of the search.

    Attributes:
        problem: With its noise model about the final fit.
        baseline: Unmodified model, nuisances refitted.
        fit: The final fit.
        named: Effects in the order of discovery.
        rounds: All rounds, the last one included that found nothing.
        checks: Of several named effects, by effect: the final fit, and what became of it with a
            rival in the effect's place.
        specimen: What healthy recordings said; None without any.
        suspect: Of `named`, the effect that comes nearest to a cause where none is one: too little
            speaks for it. It was fitted with its rivals in the last round.
        onsets: Of effects that begin during a recording, the earliest and the latest time [s] at
            which the recordings allow it, shape (recordings, 2), nan where it begins in none.
    """

    problem: Problem
    baseline: Fit
    fit: Fit
    named: tuple[Key, ...]
    rounds: tuple[Round, ...]
    checks: Mapping[Key, tuple[Contender, ...]] = field(default_factory=dict)
    specimen: Specimen | None = None
    suspect: Key | None = None
    onsets: Mapping[Key, np.ndarray] = field(default_factory=dict)

    def __repr__(self) -> str:
        told = (f"{key[0]} at {key[1]}" for key in self.named if key != self.suspect)
        named = ", ".join(told) or "nothing"
        kind = "rough" if self.rough else "exact"
        doubt = f", nearest {self.suspect[0]}" if self.suspect else ""
        return f"Search({kind}, {len(self.rounds)} rounds, named: {named}{doubt})"

    @property
    def rough(self) -> bool:
        """Whether the machine differs from its model beyond any effect, and was judged so."""
        return self.problem.noise.discrepancy is not None


def set_up(
    model: str | Path,
    recordings: Mapping[str, Recording],
    held_out: Iterable[str],
    settings: DiagnosisSettings,
    *,
    specimen: Mapping[Key, np.ndarray] | None = None,
    beside: Mapping[str, Recording] | None = None,
) -> Problem:
    """Builds the fit problem.

    Args:
        model: MJCF file, or the name of a model that ships with leglab.
        recordings: By name.
        held_out: Names of the recordings that are not fitted.
        settings: Of the diagnosis.
        specimen: Values of the specimen that was recorded; None for the model's.
        beside: Further recordings that must be predicted alike: only columns that all share count.

    Raises:
        LeglabError: Model or recordings do not fit each other, or are too short.
    """
    machine, limits = Machine(model), settings.thresholds
    admitted = admit(machine, recordings, held_out, limits)
    recordings = admitted.recordings
    together = {**recordings}
    if beside:
        others = admit(machine, beside, (), limits).recordings
        together |= {f"beside {name}": recording for name, recording in others.items()}
    found = channels(machine, together, limits)
    period = common_period(together, limits)
    machine = at_replay_step(machine, period)
    needed = tuple(dict.fromkeys([*(c.column for c in found), *machine.columns]))
    held = set(admitted.held_out)
    return Problem(
        machine,
        Library(
            machine,
            names=settings.effects,
            excluded=settings.excluded,
            specimen=specimen,
            # When in its period a sample was taken, or a command arrived, no log tells: times are
            # rounded to it.
            shortest=float(period / np.sqrt(12.0)),
        ),
        [
            UniformSeries.from_recording(r, name, needed, limits, period=period)
            for name, r in recordings.items()
        ],
        found,
        [i for i, name in enumerate(recordings) if name not in held],
        threads=settings.threads,
        thresholds=limits,
    )


def at_replay_step(machine: Machine, period: float) -> Machine:
    """The machine at the step of its replays, whose error `Problem` takes off.

    The longest that divides the sampling period [s], is at most twice the model's own and that the
    model accepts: a plugin may refuse a long one. Below the model's own there is nothing to accept.

    Raises:
        LeglabError: The model refuses its own step as well.
    """
    own = machine.file_timestep
    fewest = max(1, int(np.ceil(period / (2.0 * own) - 1e-9)))
    most = max(fewest, int(np.ceil(period / own - 1e-9)))
    for steps in range(fewest, most):
        try:
            return machine.at_timestep(period / steps)
        except LeglabError:
            continue
    return machine.at_timestep(period / most)


def search(
    problem: Problem,
    settings: DiagnosisSettings,
    progress: Progress = lambda _: None,
    specimen: Specimen | None = None,
) -> Search:
    """Finds the effects that are missing, one a round.

    The model is taken for exact first. Where the effects then leave more than noise, or healthy
    recordings of the specimen have shown that it is not, its own errors are counted in.

    Args:
        problem: About the values of the specimen, where there is one.
        settings: How.
        progress: Called with what is being done.
        specimen: What healthy recordings said.
    """
    floor = specimen.discrepancy_of(problem.series) if specimen else None
    exact, limits = None, problem.thresholds
    if floor is None:
        exact = replace(_exact_search(problem, settings, progress), specimen=specimen)
        left = float(exact.problem.window_cost(exact.fit.hypothesis).mean())
        if left <= limits.explained:
            return exact
    rough = replace(_rough_search(problem, settings, progress, specimen, floor), specimen=specimen)
    if exact is None:
        return rough
    if len(rough.named) > 1 and _level(rough) <= limits.hardly_explained:
        # Several gross effects hid that the model is exact: with them it may leave noise alone.
        again = _exact_search(problem, settings, progress, rough)
        if float(again.problem.window_cost(again.fit.hypothesis).mean()) <= limits.explained:
            return replace(again, specimen=specimen)
    # Where a machine differs everywhere, the search that allows for it errs far less: where it does
    # not, one cause is missing that no effect is. The little that is left of effects which explain
    # nearly all is judged by what comes nearer; and so are more effects than a rough machine needs,
    # which may imitate that it is rough.
    close = exact.named and left <= limits.close_cost
    nearer = 1.0 if close or len(exact.named) > len(rough.named) else limits.no_rougher
    return exact if _level(exact) <= nearer * _level(rough) else rough


def _level(found: Search) -> float:
    """Mean square error of the final fit in noise levels, where held out."""
    problem = found.problem
    return float(problem.noise_levels(found.fit.hypothesis)[problem.judged].mean())


def _rough_search(
    problem: Problem,
    settings: DiagnosisSettings,
    progress: Progress,
    specimen: Specimen | None,
    floor: Discrepancy | None,
) -> Search:
    """The search on a machine that differs from its model everywhere a little."""
    rng = np.random.default_rng(settings.seed)
    calibrated = specimen is not None
    problem, start, fit, named, rounds = rough_search(
        problem, settings.rounds, rng, progress, floor=floor, calibrated=calibrated
    )
    checks: Checks = {}
    if len(named) > 1:
        progress("checking each effect against the others")
        problem, fit, named, checks = challenged(problem, fit, named, rounds)
    if named:
        progress("last refinement")
        fit = _converged(problem, fit)
    suspect = None
    ill = floor is None or cost_under(problem, start, floor) > problem.thresholds.explained
    if rounds and ill:
        tried, best = suspected(problem, fit, named, rounds[-1], progress, calibrated=calibrated)
        if best is not None:
            rounds[-1], fit, suspect = tried, best.fit, best.key
            named = [*named, suspect]
    return Search(
        problem=problem,
        baseline=start,
        fit=fit,
        named=tuple(named),
        rounds=tuple(rounds),
        checks=checks,
        suspect=suspect,
    )


def _converged(problem: Problem, fit: Fit) -> Fit:
    """A fit whose cost falls no further: the period of a force is slow to be found."""
    limits, cost = problem.thresholds, np.inf
    for _ in range(limits.sharpenings):
        fit = sharpen(problem, fit, iterations=6)
        if fit.cost > limits.converged * cost:
            break
        cost = fit.cost
    return fit


def _exact_search(
    problem: Problem,
    settings: DiagnosisSettings,
    progress: Progress,
    begun: Search | None = None,
) -> Search:
    """The search on a machine that the right effects explain down to the sensors' noise.

    It goes on from the effects that a search has `begun` with, if there is one.
    """
    limits = problem.thresholds
    rng = np.random.default_rng(settings.seed)
    every = max(1, round(problem.fitted.sum() / limits.screened_windows))
    chosen = thinned(problem.fitted, every)
    progress("baseline")
    floor = current = baseline(problem, chosen)
    named: list[Key] = []
    rounds: list[Round] = []
    onset = None
    start, beside = floor.hypothesis, None
    typical = floor.cost / (problem.size * chosen.sum())
    if begun is not None:
        named, rounds = list(begun.named), list(begun.rounds)
        progress("fitting all that was found as if the model were exact")
        start = begun.fit.hypothesis.only(named)
        at = problem.linearise(start, chosen, named)
        current = refit(problem, at, frozenset(named), iterations=6)
        problem, current = _settled(problem, current, chosen)
        start = current.hypothesis
    elif typical >= limits.explained:
        # Nuisances that a missing effect has pulled along would mislead the screening.
        start = Hypothesis()
        progress("looking for an onset")
        suspect = suspected_onset(problem, chosen)
        if suspect is not None:
            onset, current = suspect
            start = current.hypothesis
    while len(named) < settings.rounds:
        problem, tried = search_round(problem, start, current, rng, progress, onset, beside=beside)
        tried = replace(tried, contenders=simplest_first(problem, tried.contenders))
        rounds.append(tried)
        winner = next((c for c in tried.contenders if accepted(problem, tried, c)), None)
        best = min((c.cost.mean() for c in tried.contenders), default=np.inf)
        most = min(best, tried.base.mean())
        pair = None
        if not named and onset is None and most > limits.much_missing:
            problem, pair = pair_search(problem, tried, chosen, progress)
            if pair is not None and pair.cost.mean() < limits.pair_share * most:
                rounds.append(replace(tried, contenders=(pair,)))
                named = sorted(pair.fit.free - {pair.key})
                winner = pair
            elif most > limits.hardly_explained:
                break  # No two effects explain it: the model is not exact.
        if winner is None:
            break
        named.append(winner.key)
        current = winner.fit
        if winner.cost.mean() < limits.clean:
            break
        if winner.cost.mean() < limits.much_missing:
            # The next round must not see what this one left half fitted.
            progress("refining")
            problem, current = _settled(problem, current, chosen)
        left = float(problem.window_cost(current.hypothesis).mean())
        if left < limits.clean and winner is not pair:
            break
        start, beside = current.hypothesis, None
        if left > limits.explained:
            # Nuisances far from where they belong hide what is small: screened both ways.
            start, beside = start.only(current.free), start
    checks: Checks = {}
    onsets: Mapping[Key, np.ndarray] = {}
    if len(named) > 1:
        progress("checking each effect against the others")
        problem, current, named, checks = challenged(problem, current, named, rounds)
    if named:
        progress("last refinement")
        chosen = thinned(problem.fitted, max(1, every // 2))
        problem, current = _settled(problem, current, chosen)
        current, onsets = checked_onsets(problem, current, named)
    return Search(
        problem=problem,
        baseline=floor,
        fit=current,
        named=tuple(named),
        rounds=tuple(rounds),
        checks=checks,
        onsets=onsets,
    )


def _settled(problem: Problem, fit: Fit, chosen: np.ndarray) -> tuple[Problem, Fit]:
    """Noise model about the fit and fit under the noise model, in turn until they agree."""
    cost = np.inf
    for _ in range(problem.thresholds.settling):
        problem = problem.about(fit.hypothesis)
        fit = sharpen(problem, fit, chosen=chosen, iterations=6)
        now = float(problem.window_cost(fit.hypothesis).mean())
        if now < problem.thresholds.clean or now > 0.95 * cost:
            break
        cost = now
    return problem, fit
