"""From the search to the verdict: names, confusion sets, confidence, gaps."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np

from leglab.base.recording import Recording
from leglab.diagnosis.effects.joints import unit
from leglab.diagnosis.experiment import propose
from leglab.diagnosis.fitting import Fit
from leglab.diagnosis.hypothesis import Hypothesis, Key
from leglab.diagnosis.isolation import isolate
from leglab.diagnosis.judging import intervals, preferences
from leglab.diagnosis.recordings import check_recordings
from leglab.diagnosis.residual import Problem
from leglab.diagnosis.result import (
    Diagnosis,
    Estimate,
    Gap,
    NamedEffect,
    NotTestable,
    Proposal,
    Rank,
    RecordingGap,
    ResidualTrace,
    Rivals,
    Verdict,
)
from leglab.diagnosis.search import Stage, window_cost
from leglab.diagnosis.windows import Channel
from leglab.diagnosis.workflow import EXPLAINED, Search, Settings, search, set_up


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


# A rival is told apart if resampling prefers the named effect at least this often ...
_PREFERENCE = 0.975
# ... and the difference is more than this share of a noise variance.
_DISTANCE = 0.01
# Explaining less than this share of the misfit is no explanation.
_HALF = 0.5
_DELAYS = frozenset({"command_delay", "sensor_delay"})
# An effect whose largest trial moves whitened errors less than this was not excited.
_DETECTABLE = 8.0


def diagnose(
    model: str | Path,
    recordings: Mapping[str, Recording],
    *,
    held_out: Iterable[str],
    settings: Settings | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Diagnosis, Search]:
    """Diagnoses a model on recordings.

    Args:
        model: MJCF file, or the name of a model that ships with leglab.
        recordings: By name.
        held_out: Names of the recordings on which the verdict is judged.
        settings: How.
        progress: Called with a line on what is being done.

    Returns:
        The verdict, and what it rests on.

    Raises:
        LeglabError: Model or recordings cannot be used.
    """
    began = perf_counter()
    settings = settings or Settings()
    progress("reading the machine")
    problem = set_up(model, recordings, held_out, settings)
    remarks = check_recordings(problem.machine, recordings)
    found = search(problem, settings, progress)
    progress("verdict")
    result = assemble(found, settings, seconds=perf_counter() - began)
    return replace(result, notes=(*remarks, *result.notes)), found


def assemble(found: Search, settings: Settings, *, seconds: float) -> Diagnosis:
    """Builds the verdict of a finished search."""
    problem = found.problem
    rng = np.random.default_rng(settings.seed + 1)
    final = found.fit.hypothesis
    squares = {
        "before": np.mean(problem.residual(Hypothesis()) ** 2, axis=1),
        "baseline": np.mean(problem.residual(found.baseline.hypothesis) ** 2, axis=1),
        "after": np.mean(problem.residual(final) ** 2, axis=1),
    }
    start = window_cost(problem, found.baseline.hypothesis)
    end = window_cost(problem, final)
    rivals = tuple(
        _rivals(i + 1, stage, rng) for i, stage in enumerate(found.stages) if stage.contenders
    )
    share = _explained(start, end)
    effects = _effects(found, start, end, share, rng)
    verdict = _verdict(effects, start, end, share)
    where, ceiling = isolate(problem.machine, problem.series, problem.channels)
    return Diagnosis(
        verdict=verdict,
        effects=effects,
        where=where,
        not_testable=_not_testable(found),
        gap=_gap(problem, squares),
        recordings=tuple(
            RecordingGap(
                name=series.name,
                held_out=bool(problem.held[problem.replay.recording == i].any()),
                **{k: _rms(v[problem.replay.recording == i]) for k, v in squares.items()},
            )
            for i, series in enumerate(problem.series)
        ),
        ceiling=ceiling,
        ranking=tuple(
            Rank(
                name=c.key[0],
                element=c.key[1],
                round=i + 1,
                gain=c.gain,
                threshold=stage.threshold,
            )
            for i, stage in enumerate(found.stages)
            for c in stage.candidates
        ),
        rivals=rivals,
        traces=traces(problem, found.fit.hypothesis),
        nuisances=nuisance_estimates(problem, found.fit),
        next_experiment=_next_experiment(found, effects),
        notes=notes(problem),
        rollouts=problem.replay.rollouts,
        seconds=seconds,
    )


def _rms(squares: np.ndarray) -> float:
    return float(np.sqrt(squares.mean())) if squares.size else float("nan")


def _explained(start: np.ndarray, end: np.ndarray) -> float:
    """Share of the robust misfit of the baseline that the final fit takes away."""
    return float((start.mean() - end.mean()) / max(start.mean() - 1.0, 1e-3))


def _verdict(
    effects: tuple[NamedEffect, ...], start: np.ndarray, end: np.ndarray, share: float
) -> Verdict:
    if not effects:
        return "nothing_missing" if start.mean() <= EXPLAINED else "unexplained"
    if end.mean() > EXPLAINED:
        return "partial" if share >= _HALF else "unexplained"
    return "confusion_set" if any(e.indistinguishable_from for e in effects) else "named"


def _rivals(number: int, stage: Stage, rng: np.random.Generator) -> Rivals:
    costs = [c.cost for c in stage.contenders]
    return Rivals(
        round=number,
        names=tuple(c.key[0] for c in stage.contenders),
        cost=tuple(float(c.mean()) for c in costs),
        preference=preferences(costs, rng),
    )


def _effects(
    found: Search, start: np.ndarray, end: np.ndarray, share: float, rng: np.random.Generator
) -> tuple[NamedEffect, ...]:
    problem, final = found.problem, found.fit.hypothesis
    if not found.named:
        return ()
    _, half = intervals(problem, found.fit, found.chosen)
    place = {}
    at = 0
    for key in sorted(found.fit.free):
        count = len(problem.library.sites[key].parameters)
        place[key] = slice(at, at + count)
        at += count
    quality = min(1.0, EXPLAINED / float(end.mean())) * float(np.clip(share, 0.0, 1.0))
    if end.mean() <= EXPLAINED:
        quality = 1.0
    effects = []
    for key in found.named:
        site = problem.library.sites[key]
        tied, certainty = _ties(found, key, rng)
        lost = window_cost(problem, final.without(key))
        values = final[key]
        margin = half[place[key]]
        effects.append(
            NamedEffect(
                name=key[0],
                element=key[1],
                group=site.effect.group,
                physics=site.effect.physics,
                onset=tuple(
                    (series.name, float(time - series.time[0]))
                    for series, time in zip(problem.series, final.onsets.get(key, ()), strict=False)
                    if np.isfinite(time)
                ),
                confidence=certainty * quality,
                contribution=float(
                    np.clip((lost.mean() - end.mean()) / max(lost.mean() - 1.0, 1e-3), 0.0, 1.0)
                ),
                parameters=tuple(
                    Estimate(
                        name=p.name,
                        unit=p.unit,
                        value=float(v),
                        nominal=p.nominal,
                        interval=(
                            max(p.lower, float(v - m)),
                            min(p.upper, float(v + m)),
                        ),
                    )
                    for p, v, m in zip(site.parameters, values, margin, strict=True)
                ),
                indistinguishable_from=tied,
            )
        )
    weight = {e.name: e.contribution for e in effects}
    return tuple(sorted(effects, key=lambda e: -weight[e.name]))


def _ties(found: Search, key: Key, rng: np.random.Generator) -> tuple[tuple[str, ...], float]:
    """Rivals that explain the recordings as well, and how sure the name is against all."""
    twins = exact_twins(found.problem.channels, key[0])
    twins = tuple(t for t in twins if t in found.problem.library.names)
    if twins:
        return twins, 1.0 / (1 + len(twins))
    fitted = [
        (c.cost.mean(), i) for i, s in enumerate(found.stages) for c in s.contenders if c.key == key
    ]
    if not fitted:
        return (), 1.0
    stage = found.stages[min(fitted)[1]]
    own = next(c for c in stage.contenders if c.key == key)
    tied, sure = [], 1.0
    for rival in stage.contenders:
        if rival.key == key or rival.key in found.named:
            continue
        preferred = preferences([own.cost, rival.cost], rng)[0, 1]
        near = rival.cost.mean() - own.cost.mean() < _DISTANCE
        if preferred < _PREFERENCE or near:
            tied.append(rival.key[0])
        sure = min(sure, preferred if not near else min(preferred, 0.5))
    return tuple(tied), float(sure)


def exact_twins(channels: Sequence[Channel], name: str) -> tuple[str, ...]:
    """Effects that no recording of these channels can tell from one, whatever the excitation.

    A late command and a late position sensor shift the same motion against the same command. Only
    a third signal says which, and fits differ merely in where their windows start.
    """
    if name in _DELAYS and not any(c.chamber for c in channels):
        return tuple(sorted(_DELAYS - {name}))
    return ()


def _next_experiment(found: Search, effects: tuple[NamedEffect, ...]) -> Proposal | None:
    """What would tell the first effect that is tied from its rival."""
    for effect in effects:
        if exact_twins(found.problem.channels, effect.name):
            continue  # No excitation tells them apart, only a further sensor.
        for stage in found.stages:
            fits = {c.key[0]: c.fit.hypothesis for c in stage.contenders}
            tied = [name for name in effect.indistinguishable_from if name in fits]
            if effect.name in fits and tied:
                rivals = {effect.name: fits[effect.name], tied[0]: fits[tied[0]]}
                return propose(found.problem, rivals)
    return None


def _gap(problem: Problem, squares: Mapping[str, np.ndarray]) -> Gap:
    mask = problem.held if problem.held.any() else np.ones_like(problem.held)
    names = tuple(
        s.name
        for i, s in enumerate(problem.series)
        if problem.held[problem.replay.recording == i].any()
    )
    rms = {k: _rms(v[mask]) for k, v in squares.items()}
    return Gap(held_out=names, before=rms["before"], baseline=rms["baseline"], after=rms["after"])


def _not_testable(found: Search) -> tuple[NotTestable, ...]:
    if not found.stages:
        return ()
    entries = []
    for candidate in found.stages[0].candidates:
        if candidate.detectable < _DETECTABLE and candidate.key not in found.named:
            effect = found.problem.library.sites[candidate.key].effect
            entries.append(
                NotTestable(
                    name=candidate.key[0],
                    element=candidate.key[1],
                    reason=f"needs {effect.excitation}",
                )
            )
    return tuple(entries)
