"""From recordings to the verdict: names, confusion sets, confidence, gaps."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter

import mujoco
import numpy as np
from scipy.stats import t as student

from leglab.base.recording import Recording
from leglab.base.threads import one_blas_thread
from leglab.diagnosis.balance.isolation import isolate, sample_places
from leglab.diagnosis.effects.base import EffectParameter
from leglab.diagnosis.effects.hypothesis import Hypothesis, Key, Library, Site
from leglab.diagnosis.intake.admission import admit
from leglab.diagnosis.intake.recordings import split_held_out
from leglab.diagnosis.intake.remarks import Remark, merged
from leglab.diagnosis.intake.series import UniformSeries
from leglab.diagnosis.likelihood.columns import Errors
from leglab.diagnosis.likelihood.evidence import Evidence, Score
from leglab.diagnosis.likelihood.unknowns import EVERY
from leglab.diagnosis.plant.model import CYLINDER, Machine
from leglab.diagnosis.replay.residual import Problem, noise_alone, whitened
from leglab.diagnosis.result import (
    Calibration,
    Diagnosis,
    Estimate,
    Gap,
    NamedEffect,
    NotTestable,
    Proposal,
    Rank,
    RecordingGap,
    Remaining,
    ResidualTrace,
    Rivals,
    Verdict,
)
from leglab.diagnosis.search.onset import begun
from leglab.diagnosis.search.pipeline import DiagnosisSettings, Searched, searched
from leglab.diagnosis.search.settle import Fit, Fitter
from leglab.diagnosis.thresholds import (
    ABSENT,
    BEST_SETS,
    DEFAULT,
    LAW,
    NAMED,
    RENEWALS,
    ROOM,
    VISIBLE,
)
from leglab.diagnosis.verdict.confidence import Judgement, as_before, judged
from leglab.diagnosis.verdict.experiment import propose
from leglab.diagnosis.verdict.sets import Row, Sets
from leglab.diagnosis.verdict.whole import whole_recording

_HARDLY_SHOWN = (
    "the held-out recordings hardly show what is named: the share explained is that over all "
    "recordings"
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """A judged search.

    Attributes:
        searched: Problem, fitted sets, specimen.
        judged: Names and confidence.
        row: The set whose values are told.
        spread: Posterior covariance of all single unknowns there, in trials, (single, single).
        baseline: Nothing missing, all parameters within what machines differ by.
        final: The told set, all parameters as fitted beside it.
        written: What an improved model carries: the told effects, and what has a tolerance.
        about: The problem with its noise model about the told set: start states are as uncertain
            as that makes them.
        named: Effects that are told, named or in a confusion set.
        onsets: Of effects that begin during a recording, the earliest and the latest time [s] at
            which they can have begun, (recordings, 2), nan where an effect begins in none.
        result: The verdict as it is told.
    """

    searched: Searched
    judged: Judgement
    row: Row
    spread: np.ndarray
    baseline: Hypothesis
    final: Hypothesis
    written: Hypothesis
    about: Problem
    named: tuple[Key, ...]
    onsets: Mapping[Key, np.ndarray]
    result: Diagnosis = field(init=False)

    @property
    def problem(self) -> Problem:
        """Recordings and machine."""
        return self.searched.problem

    def __repr__(self) -> str:
        named = ", ".join(f"{name} at {element}" for name, element in self.named) or "nothing"
        return f"Outcome({self.judged.verdict}: {named})"


@one_blas_thread()
def diagnose(
    model: str | Path,
    recordings: Mapping[str, Recording],
    *,
    held_out: Iterable[str] | None = None,
    healthy: Mapping[str, Recording] | None = None,
    settings: DiagnosisSettings | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Diagnosis, Outcome]:
    """Diagnoses a model on recordings.

    Args:
        model: MJCF file, or the name of a model that ships with leglab.
        recordings: By name.
        held_out: Names of the recordings on which the verdict is judged; None for the choice of
            `split_held_out`, which cuts the end off a single recording.
        healthy: Recordings of the same specimen before it changed, by name: what is named is what
            changed since.
        settings: How.
        progress: Called with a line on what is being done.

    Returns:
        The verdict, and the judged search that it rests on.

    Raises:
        LeglabError: Model or recordings cannot be used.
    """
    began = perf_counter()
    settings = settings or DiagnosisSettings()
    progress("reading the machine")
    if held_out is None:
        recordings, held_out = split_held_out(model, recordings, (), settings.thresholds)
    held_out = tuple(held_out)
    found = searched(model, recordings, held_out, healthy, settings, progress)
    machine, limits = found.problem.machine, settings.thresholds
    remarks = admit(machine, recordings, held_out, limits).notes
    if healthy:
        remarks += admit(machine, healthy, (), limits).notes
    progress("verdict")
    outcome = _judged(found, judged(Sets(found.found)))
    if outcome.judged.verdict == "nothing_missing":
        if not _clear_elsewhere(found):
            outcome = replace(outcome, judged=replace(outcome.judged, verdict="unexplained"))
    elif _lacks_nothing(outcome):
        nothing = replace(outcome.judged, verdict="nothing_missing", named=(), confusion=())
        outcome = _judged(found, nothing)
    result = assemble(outcome, seconds=perf_counter() - began)
    result = replace(result, notes=(*remarks, *result.notes))
    object.__setattr__(outcome, "result", result)
    return result, outcome


def _lacks_nothing(outcome: Outcome) -> bool:
    """Whether noise is left without what is told, which hardly lessens it where nobody fitted."""
    problem = outcome.about
    if not problem.held.any():
        return False
    less = outcome.final.without(*outcome.named) if outcome.named else Hypothesis()
    with_it, without = (problem.noise_levels(h) for h in (outcome.final, less))
    after, before = (rms(squares[problem.held]) for squares in (with_it, without))
    lessens = before - after >= problem.thresholds.explanation_share * max(before - 1.0, ROOM)
    return not lessens and noise_alone(without, problem.replay.recording)


def _clear_elsewhere(found: Searched) -> bool:
    """Whether the model errs as little as it may where nobody fitted."""
    problem, recording = found.problem, found.problem.replay.recording
    levels = np.sqrt(problem.noise_levels(Hypothesis()) / _floors(found))
    each = [np.median(levels[recording == r]) for r in np.unique(recording[problem.held])]
    if not each:
        return True
    middle = float(np.median(levels[problem.held]))
    return as_before(middle, float(max(each)), healthy=found.specimen is not None)


def _judged(found: Searched, judgement: Judgement) -> Outcome:
    """The search with its verdict, and the hypotheses that are told."""
    told = set(judgement.named or judgement.confusion[:1])
    rows = judgement.rows
    row = next((r for r in rows if told <= r.keys and not r.renamed), rows[0])
    nothing = next((r for r in rows if not r.keys), None)
    if judgement.verdict == "nothing_missing" and nothing is not None:
        row = nothing
    u, fitter = row.evidence.unknowns, found.found.fitter

    def hypothesis(of: Row) -> Hypothesis:
        both = (of.hypothesis, of.evidence.columns.base) if of.fitted else (of.hypothesis,)
        return min(both, key=lambda h: fitter.level(fitter.at.at(h)))

    final, spread = hypothesis(row), _scatter(row.evidence, row.score)
    about = found.problem.about(final)
    named = tuple(
        key
        for name, element in (judgement.named or judgement.confusion[:1])
        for key in sorted(found.problem.library.sites)
        if key[0] == name and element in (key[1], EVERY)
    )
    if found.specimen is not None:
        written = final.only(named)
        final = final if named or judgement.verdict != "nothing_missing" else written
    else:
        values = zip(row.score.unknowns, row.score.values, strict=True)
        kept = {q: float(v) for q, v in values if u.library_keys(q) <= set(named)}
        lean, scatter = _lean(Errors(about, u, fitter.at.chosen), fitter, row, kept)
        written = lean.columns.base
        if lean.level <= (1.0 + found.problem.thresholds.smaller_share) * row.level:
            final, spread = written, scatter
    between: dict[Key, np.ndarray] = {}
    if found.onsets is not None:
        final, between = begun(found.problem, final, named, found.onsets)
    return Outcome(
        onsets=between,
        searched=found,
        judged=judgement,
        row=row,
        spread=spread,
        baseline=hypothesis(nothing) if nothing is not None else Hypothesis(),
        final=final,
        written=written,
        about=about,
        named=named,
    )


def _lean(
    at: Errors, fitter: Fitter, row: Row, values: Mapping[int, float]
) -> tuple[Fit, np.ndarray]:
    """Some members where the rest of the machine is as its model, but for tolerances.

    What else departs a little takes a part of each effect's size with it.

    Args:
        at: Windows, with the noise model about the told set.
        fitter: Of the search.
        row: The told set.
        values: Departures of the members that are told.

    Returns:
        The fit, and the covariance of all single unknowns there.
    """
    u, old = at.unknowns, row.evidence.columns
    columns = replace(old, errors=at.at(old.base))
    goal = np.zeros(u.single)
    for q, value in values.items():
        goal[list(u.singles(q))] += value
    # Shapes stay as they were found.
    shape = u.shape[: u.single]
    goal[shape] = old.x[: u.single][shape]
    start = {i: float(d) for i, d in enumerate(goal - old.x[: u.single])}
    lean = Fitter(at, replace(fitter.priors, spreads=(ABSENT,)))
    weight, kappa = row.evidence.weight, row.evidence.kappa
    fit = lean.fit(
        columns,
        start,
        tuple(values),
        row.evidence.spread,
        weight,
        kappa,
        renewals=RENEWALS if values else 0,
        beside=True,
    )
    evidence = lean.evidence(fit.columns, fit.spread, fit.weight, kappa)
    return fit, _scatter(evidence, evidence.score([(q, None) for q in values]))


def _scatter(evidence: Evidence, score: Score) -> np.ndarray:
    """Covariance of all single unknowns, (single, single): posterior, or between parts.

    What all windows of a recording share no posterior sees: of the members the larger of it and a
    jackknife over parts of the recordings.
    """
    spread, u = evidence.posterior(score), evidence.unknowns
    parts = int(evidence.part.max()) + 1
    if not score.members or parts < 2:
        return spread
    without = [one.values for one in evidence.apart(score.members)]
    away = np.array(without) - np.mean(without, axis=0)
    for i, q in enumerate(score.unknowns):
        jack = (parts - 1) / parts * float(away[:, i] @ away[:, i])
        for k in u.singles(q):
            widened = np.sqrt(max(1.0, jack / max(spread[k, k], 1e-300)))
            spread[k] *= widened
            spread[:, k] *= widened
    return spread


def assemble(outcome: Outcome, *, seconds: float) -> Diagnosis:
    """Builds the verdict of a judged search."""
    found, judged, final = outcome.searched, outcome.judged, outcome.final
    problem = outcome.about
    models = {"before": Hypothesis(), "baseline": outcome.baseline, "after": final}
    if outcome.named:
        models["unnamed"] = final.without(*outcome.named)
    squares = {k: problem.noise_levels(h) for k, h in models.items()}
    windows = [problem.replay.recording == i for i in range(len(problem.series))]
    held = problem.judged
    names = [s.name for s in problem.series]
    told = [bool(problem.held[own].any()) for own in windows]
    levels = {k: rms(squares[k][held]) for k in squares}
    floors = _floors(found)
    gap = Gap(
        held_out=tuple(name for name, held_out in zip(names, told, strict=True) if held_out),
        before=levels["before"],
        baseline=levels["baseline"],
        after=levels["after"],
        unnamed=levels.get("unnamed", math.nan),
        healthy=rms(floors[held]) if found.specimen else None,
    )
    shown = held
    if outcome.named:
        if _hardly_shows(problem, held, models["unnamed"], final):
            # A slow motion that nobody fitted cannot tell what a fast one would show.
            shown = np.ones_like(held)
        before, after = (rms(squares[k][shown]) for k in ("unnamed", "after"))
        gap = replace(gap, compared=(before, after, rms(floors[shown])))
    verdict, effects, smaller = _effects(outcome, problem, gap, shown)
    return Diagnosis(
        verdict=verdict,
        effects=effects,
        smaller=smaller,
        where=isolate(problem),
        not_testable=_not_testable(outcome),
        gap=gap,
        recordings=tuple(
            RecordingGap(
                name=name,
                held_out=held_out,
                **{k: rms(squares[k][own]) for k in ("before", "baseline", "after")},
            )
            for name, held_out, own in zip(names, told, windows, strict=True)
        ),
        remaining=_remaining(problem, final, held),
        whole=whole_recording(problem, final),
        calibration=_calibration(found) if found.specimen else None,
        ranking=_ranking(found),
        rivals=_rivals(judged),
        traces=traces(problem, final),
        nuisances=nuisance_estimates(problem, final, outcome.named),
        next_experiment=_next_experiment(outcome),
        notes=(
            *notes(problem),
            *at_limits(problem.library, {k: final[k] for k in outcome.named}),
            *([_HARDLY_SHOWN] if shown is not held else ()),
        ),
        rollouts=problem.replay.rollouts,
        seconds=seconds,
    )


def _floors(found: Searched) -> np.ndarray:
    """Mean square that noise, or the healthy specimen, gives in each window, (windows,)."""
    problem = found.problem
    if found.specimen is None or found.healthy is None:
        return np.ones(problem.replay.windows)
    levels = np.array([after for _, after in found.specimen.levels])
    nearest = found.specimen.nearest(problem)
    return levels[np.array(nearest)[problem.replay.recording]] ** 2


def _hardly_shows(
    problem: Problem, windows: np.ndarray, without: Hypothesis, final: Hypothesis
) -> bool:
    """Whether effects move the predictions in a mask of windows far less than in all."""
    change = problem.raw_errors(without) - problem.raw_errors(final)
    square = np.mean(whitened(problem.noise.whitening, change) ** 2, axis=1)
    shows = square > max(1.0, problem.thresholds.shown_share * float(np.median(square)))
    return bool(shows[windows].mean() < problem.thresholds.shown_share * shows.mean())


def _effects(
    outcome: Outcome, problem: Problem, gap: Gap, shown: np.ndarray
) -> tuple[Verdict, tuple[NamedEffect, ...], tuple[NamedEffect, ...]]:
    """Verdict, named effects and smaller differences, the largest contribution first."""
    judged, final = outcome.judged, outcome.final
    limits = problem.thresholds
    unnamed, after, floor = gap.shown
    explained = gap.explained or 0.0
    half = _intervals(outcome)
    causes: list[NamedEffect] = []
    smaller: list[NamedEffect] = []
    for key in outcome.named:
        site = problem.library.sites[key]
        told = key if key in (*judged.named, *judged.confusion) else (key[0], EVERY)
        one = judged.effects[told]
        without = problem.noise_levels(final.without(key))
        contribution = (rms(without[shown]) - after) / max(unnamed - floor, 1e-9)
        tied = () if judged.named else tuple(k[0] for k in judged.confusion if k != key)
        # Of a set that is not told apart none is surer than not.
        confidence = one.confidence if judged.named else min(one.possible, one.evidence, NAMED)
        if explained < limits.explanation_share:
            # A name does not stand while most of the error is left.
            confidence = min(confidence, explained)
        effect = NamedEffect(
            name=key[0],
            element=key[1],
            group=site.effect.group,
            physics=site.effect.physics,
            onset=tuple(
                (series.name, float(time - series.time[0]))
                for series, time in zip(problem.series, final.onsets.get(key, ()), strict=False)
                if np.isfinite(time)
            ),
            onset_interval=tuple(
                (series.name, *(both - series.time[0]).tolist())
                for series, both in zip(problem.series, outcome.onsets.get(key, ()), strict=False)
                if np.isfinite(both).all()
            ),
            confidence=float(confidence),
            contribution=float(np.clip(contribution, 0.0, 1.0)),
            parameters=tuple(
                estimate(p, n, float(v), max(p.lower, float(v - h)), min(p.upper, float(v + h)))
                for p, n, v, h in zip(
                    site.parameters,
                    site.nominal,
                    final[key],
                    half[key][: len(site.parameters)],
                    strict=True,
                )
            ),
            differences=_differences(site, final[key], half[key][len(site.parameters) :]),
            indistinguishable_from=tied,
            without=rms(without[problem.judged]),
        )
        small = judged.named and contribution < limits.smaller_share and len(outcome.named) > 1
        (smaller if small else causes).append(effect)
    verdict = judged.verdict
    if verdict in ("named", "confusion_set") and explained < limits.explanation_share:
        verdict = "unexplained"
    causes.sort(key=lambda e: -e.contribution)
    return verdict, tuple(causes), tuple(sorted(smaller, key=lambda e: -e.contribution))


def _intervals(outcome: Outcome) -> dict[Key, np.ndarray]:
    """Half the width of the 95 % intervals of told effects: parameters, then differences.

    A parameter of another law than the machine's is one thing in a slow motion and another in a
    fast one: on a rough machine by a share of the change, which no spread of errors shows.
    """
    problem, evidence = outcome.problem, outcome.row.evidence
    u, rough = evidence.unknowns, outcome.row.level > DEFAULT.explained
    # Few parts say how errors scatter.
    width = float(student.ppf(0.975, max(int(evidence.part.max()), 1)))
    half = {}
    for key in outcome.named:
        site = problem.library.sites[key]
        scale = np.array([p.scale for p in site.parameters])
        own = [u.places.index(((key, i),)) for i in range(scale.size)]
        told = np.concatenate([np.eye(scale.size), site.differences]) * scale
        spread = np.diag(told @ outcome.spread[np.ix_(own, own)] @ told.T)
        strength = np.array([p.role == "strength" for p in site.parameters])
        moved = (outcome.final.get(key, site.nominal) - site.nominal) * strength
        change = np.concatenate([moved, site.differences @ moved])
        law = LAW * change if rough else 0.0 * change
        half[key] = np.hypot(width * np.sqrt(spread), 1.96 * law)
    return half


def _differences(site: Site, values: np.ndarray, half: np.ndarray) -> tuple[Estimate, ...]:
    """By how much directions differ that an effect says differ."""
    units = {p.name: p.unit for p in site.parameters}
    rows = zip(
        site.effect.by_direction,
        site.differences @ values,
        site.differences @ site.nominal,
        half,
        strict=True,
    )
    return tuple(
        Estimate(
            name=f"{first}_less_{second.rpartition('_')[2]}",
            unit=units[first],
            value=float(value),
            nominal=float(nominal),
            interval=(float(value - h), float(value + h)),
        )
        for (first, second), value, nominal, h in rows
    )


def _ranking(found: Searched) -> tuple[Rank, ...]:
    """What each effect would explain alone at the first linearisation, in nats."""
    first, u = found.found.first, found.found.fitter.at.unknowns
    best = found.found.ranks[0].evidence
    evidence = found.found.fitter.evidence(first, best.spread, best.weight, best.kappa)
    gains: dict[Key, float] = dict.fromkeys(found.problem.library.searched, 0.0)
    nothing = evidence.score(())
    for _, member in evidence.additions(nothing):
        key = u.keys[member[0]]
        if key in gains:
            gains[key] = max(gains[key], evidence.score((member,)).log - nothing.log)
    rows = sorted(gains.items(), key=lambda row: -row[1])
    return tuple(Rank(name=k[0], element=k[1], gain=g) for k, g in rows)


def _rivals(judged: Judgement) -> tuple[Rivals, ...]:
    """The most probable sets, and how much each is preferred to another."""
    rows = judged.rows[:BEST_SETS]
    names = tuple(" + ".join(sorted(k[0] for k in row.keys)) or "nothing" for row in rows)
    logs = np.array([row.score.log for row in rows])
    preference = 1.0 / (1.0 + np.exp(np.clip(logs[None, :] - logs[:, None], -500, 500)))
    cost = tuple(row.level**2 for row in rows)
    return (Rivals(names=names, cost=cost, preference=preference),)


def _remaining(problem: Problem, final: Hypothesis, held: np.ndarray) -> tuple[Remaining, ...]:
    """Errors at the end of held-out windows before and after."""
    before, after = (problem.raw_errors(h)[held][:, :, -1] for h in (Hypothesis(), final))
    noise = np.median(problem.sensor_noise, axis=0)
    return tuple(
        Remaining(
            channel=channel.column,
            unit="Pa" if channel.chamber else problem.machine.unit(channel.joint),
            horizon=problem.replay.window,
            before=rms(before[:, k] ** 2),
            after=rms(after[:, k] ** 2),
            noise=float(noise[k]),
        )
        for k, channel in enumerate(problem.channels)
    )


def _calibration(found: Searched) -> Calibration:
    """The calibration for the page: what departed most."""
    specimen, problem = found.specimen, found.healthy
    assert specimen is not None
    assert problem is not None
    rows = []
    for key, site in problem.library.sites.items():
        for p, nominal, value in zip(
            site.parameters, site.model, specimen.values[key], strict=True
        ):
            away = p.departure(float(value), float(nominal))
            if p.role == "strength" and away >= problem.thresholds.calibration_share:
                rows.append((away, (*key, estimate(p, nominal, float(value), value, value))))
    rows.sort(key=lambda row: -row[0])
    names = (series.name for series in problem.series)
    return Calibration(
        recordings=tuple(
            (name, before, after)
            for name, (before, after) in zip(names, specimen.levels, strict=True)
        ),
        estimates=tuple(row for _, row in rows),
    )


def _next_experiment(outcome: Outcome) -> Proposal | None:
    """Experiment that would tell the first effect of a confusion set from its rival."""
    judged = outcome.judged
    if judged.named or len(judged.confusion) < 2:
        return None
    rivals: dict[str, Hypothesis] = {}
    for key in judged.confusion:
        row = next(r for r in judged.rows if key in r.keys)
        if key[0] not in rivals:
            columns, u = row.evidence.columns, row.evidence.unknowns
            rivals[key[0]] = u.moved(columns.base, row.evidence.departures(row.score))
    if len(rivals) < 2:
        return None
    return propose(outcome.problem, dict(list(rivals.items())[:2]))


def _not_testable(outcome: Outcome) -> tuple[NotTestable, ...]:
    """Effects that the recordings do not show, or that are over between two samples."""
    found = outcome.searched.found
    first, u = found.first, found.fitter.at.unknowns
    evidence = found.fitter.evidence(
        first, found.ranks[0].evidence.spread, np.ones(len(first.errors)), 1.0, places=[0]
    )
    inner = evidence.whole.inner[0, 0]
    sites = outcome.problem.library.sites
    seen: dict[Key, float] = {}
    for q in range(u.single):
        if u.nameable[q]:
            seen[u.keys[q]] = max(seen.get(u.keys[q], 0.0), float(inner[1 + q, 1 + q]))
    for j, (q, _) in enumerate(first.jumps):
        if q < u.single:
            jump = 1 + len(u) + j
            seen[u.keys[q]] = max(seen.get(u.keys[q], 0.0), float(inner[jump, jump]))
    problem = outcome.problem
    rate = f"needs more than {1.0 / problem.series[0].period:.3g} samples a second"
    reasons = dict.fromkeys(sorted(problem.library.too_fast), rate)
    reasons |= {
        key: f"needs {sites[key].effect.excitation}"
        for key, visible in sorted(seen.items())
        if visible < VISIBLE and key not in outcome.named and key[1] != EVERY
    }
    return tuple(NotTestable(name=n, element=e, reason=r) for (n, e), r in reasons.items())


def nuisance_estimates(
    problem: Problem, final: Hypothesis, named: Sequence[Key]
) -> tuple[Estimate, ...]:
    """Refitted parameters that have a tolerance, with the range of it."""
    found = []
    for key, site in problem.library.sites.items():
        if key in named:
            continue
        values = final.get(key, site.nominal)
        for p, nominal, value in zip(site.parameters, site.nominal, values, strict=True):
            if p.tolerance > 0.0:
                room = 1.96 * p.tolerance
                found.append(
                    estimate(p, nominal, float(value), float(nominal - room), float(nominal + room))
                )
    return tuple(found)


def estimate(p: EffectParameter, nominal: float, value: float, low: float, high: float) -> Estimate:
    """A fitted parameter with its interval, beside its value in the model or specimen."""
    return Estimate(
        name=p.name, unit=p.unit, value=value, nominal=float(nominal), interval=(low, high)
    )


def rms(squares: np.ndarray) -> float:
    """Root of the mean of squares; NaN of none."""
    return float(np.sqrt(squares.mean())) if squares.size else float("nan")


def notes(problem: Problem) -> tuple[str, ...]:
    """Remarks on missing pressures and samples, and on contacts."""
    found = []
    touching = touching_share(problem.machine, problem.series)
    if touching:
        found.append(
            f"the machine touches something {100 * touching:.0f} % of the time and no sensor tells "
            "with what force: a friction or a force that is named may be the contact's"
        )
    hydraulic = problem.machine.instances(CYLINDER)
    if hydraulic and not any(c.chamber for c in problem.channels):
        found.append(
            "no chamber pressures: they were replayed from the commands; faults of mechanism and "
            "hydraulics are told apart by the motion alone, with wider intervals"
        )
    text = "windows over gaps are skipped"
    lost = {series.name: int((~series.valid).sum()) for series in problem.series}
    gaps = [
        Remark(text=text, recording=name, place=f"{count} samples")
        for name, count in lost.items()
        if count
    ]
    return (*found, *merged(gaps, lost))


def at_limits(library: Library, values: Mapping[Key, np.ndarray]) -> tuple[str, ...]:
    """A line for every parameter whose fit ended at the smallest or largest value of its effect.

    Args:
        library: Effects.
        values: Of the effects that were fitted, each (parameters,).
    """
    lines = []
    for key, fitted in values.items():
        site = library.sites[key]
        for p, value, nominal in zip(site.parameters, fitted, site.nominal, strict=True):
            room = DEFAULT.negligible * (p.upper - p.lower)
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
    """Share of the measured poses in which bodies of the model touch."""
    model = machine.base.model
    data = mujoco.MjData(model)
    places = {f"{joint}_position": int(model.joint(joint).qposadr[0]) for joint in machine.joints}
    touched = []
    for one in series:
        # So many poses tell a share.
        rows = np.linspace(0, one.time.size - 1, 50).astype(int)
        for row in rows:
            for column, place in places.items():
                data.qpos[place] = one.columns[column][row]
            mujoco.mj_fwdPosition(model, data)
            touched.append(data.ncon > 0)
    return float(np.mean(touched))


def traces(problem: Problem, final: Hypothesis) -> tuple[ResidualTrace, ...]:
    """Replay errors before and after, of every recording and channel."""
    replay = problem.replay
    before = problem.raw_errors(Hypothesis())
    after = problem.raw_errors(final)
    # A channel's sample after the step is what a replay predicts.
    measured = replay.measured()[:, :, 1:]
    measured = measured.reshape((*before.shape, -1)).mean(axis=3)
    rows = []
    for i, (series, index) in enumerate(zip(problem.series, sample_places(problem), strict=True)):
        own, period = replay.recording == i, series.period
        for k, channel in enumerate(problem.channels):
            q = series.columns[f"{channel.joint}_position"]
            a, b = (series.columns.get(f"{channel.joint}_pressure_{c}") for c in "ab")
            rows.append(
                ResidualTrace(
                    recording=series.name,
                    channel=channel.column,
                    unit="Pa" if channel.chamber else problem.machine.unit(channel.joint),
                    time=series.time[index],
                    position=q[index],
                    velocity=np.gradient(q, period)[index],
                    pressure=None if a is None or b is None else (a - b)[index],
                    before=before[own, k].ravel(),
                    after=after[own, k].ravel(),
                    measured=measured[own, k].ravel(),
                    bins=replay.bins,
                )
            )
    return tuple(rows)
