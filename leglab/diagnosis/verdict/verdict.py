"""From recordings to the verdict: named effects, confusion sets, confidence, remaining errors."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from scipy.stats import t as student

from leglab.base.recording import Recording
from leglab.base.scale import rms
from leglab.base.threads import one_blas_thread
from leglab.diagnosis import result
from leglab.diagnosis.balance.isolation import bin_motion, isolate
from leglab.diagnosis.effects.hypothesis import Hypothesis, Key
from leglab.diagnosis.intake.recordings import split_held_out
from leglab.diagnosis.likelihood.unknowns import EVERY
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.replay.residual import Problem, lessens, noise_alone, whitened
from leglab.diagnosis.search.healthy import Specimen
from leglab.diagnosis.search.pipeline import DiagnosisSettings, searched
from leglab.diagnosis.thresholds import (
    BEST_SETS,
    DAY_FACTOR,
    EXPLAINED,
    EXPLANATION,
    LAW,
    NAMED,
    SMALL,
    VISIBLE,
)
from leglab.diagnosis.verdict.confidence import judge
from leglab.diagnosis.verdict.experiment import propose
from leglab.diagnosis.verdict.notes import at_limits, by_states, notes
from leglab.diagnosis.verdict.outcome import Outcome
from leglab.diagnosis.verdict.sets import Row, Sets
from leglab.diagnosis.verdict.tabulation import tabulated
from leglab.diagnosis.verdict.tried import certainties, ranking, tried
from leglab.diagnosis.verdict.whole import whole_recording


@one_blas_thread()
def diagnose(
    model: str | Path | Machine,
    recordings: Mapping[str, Recording],
    *,
    held_out: Iterable[str] | None = None,
    healthy: Mapping[str, Recording] | None = None,
    settings: DiagnosisSettings | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[result.Diagnosis, Outcome]:
    """Diagnoses a model on recordings.

    Args:
        model: MJCF file, the name of a model that ships with leglab, or its machine.
        recordings: Recordings by name.
        held_out: Names of the recordings on which the verdict is judged; None for the choice of
            `split_held_out`, which cuts the end off a single recording.
        healthy: Recordings of the same specimen before it changed, by name. If present, the
            diagnosis names changes since the healthy recordings.
        settings: Settings of the diagnosis; None for defaults.
        progress: Called with a line on what is being done.

    Returns:
        The diagnosis, and the judged search from which it follows.

    Raises:
        LeglabError: Model or recordings cannot be used.
    """
    began = perf_counter()
    settings = settings or DiagnosisSettings()
    progress("reading the machine")
    if held_out is None:
        recordings, held_out = split_held_out(model, recordings, (), settings.thresholds)
    held_out = tuple(held_out)
    found, specimen, remarks = searched(model, recordings, held_out, healthy, settings, progress)
    progress("verdict")
    sets = Sets(found, specimen)
    table = tabulated(sets, specimen)
    judged = judge(table)
    outcome = Outcome(sets, table, judged, specimen)
    if judged.verdict != "nothing_missing" and _lacks_nothing(outcome):
        outcome = Outcome(sets, table, judged.cleared(), specimen)
    outcome.result = _told(outcome, recordings, remarks, began)
    if outcome.result.verdict == "unexplained" and judged.as_it_was:
        # The effects explain less than half of the errors, which are as small as in healthy data.
        outcome = Outcome(sets, table, judged.cleared(), specimen)
        outcome.result = _told(outcome, recordings, remarks, began)
    return outcome.result, outcome


def _lacks_nothing(outcome: Outcome) -> bool:
    """Tests whether errors without the reported effects are noise and hardly larger than with."""
    problem = outcome.about
    if not problem.held.any():
        return False
    with_it, without = (problem.noise_levels(h) for h in (outcome.final, outcome.unnamed))
    after, before = (result.root_mean(squares[problem.held]) for squares in (with_it, without))
    return not lessens(before, after) and noise_alone(without, problem.replay.recording)


def _told(
    outcome: Outcome, logged: Mapping[str, Recording], remarks: Sequence[str], began: float
) -> result.Diagnosis:
    """Builds the diagnosis of a judged search; `remarks` are notes on the recordings."""
    final, problem, floors = outcome.final, outcome.about, outcome.floors()
    errors = errors_of(problem, outcome.baseline, final)
    remarks = [*remarks, *notes(problem), *by_states(problem, logged, problem.noise_levels(final))]
    remarks += at_limits(problem.library, {key: final[key] for key in outcome.named})
    held, shown, unnamed, compared = problem.judged, problem.judged, math.nan, None
    if outcome.named:
        unnamed = result.root_mean(problem.noise_levels(outcome.unnamed)[held])
        without, with_it = map(outcome.compared.noise_levels, (outcome.unnamed, final))
        if _hardly_shows(outcome, without):
            # A slow held-out motion hides effects of fast motion, so all windows are compared.
            shown = np.ones_like(held)
            remarks.append(
                "the held-out recordings hardly show what is named: the share explained is that "
                "over all recordings"
            )
        compared = result.root_mean(without[shown]), result.root_mean(with_it[shown]), 1.0
    healthy = result.root_mean(floors[held]) if outcome.specimen else None
    gap = replace(errors["gap"], unnamed=unnamed, compared=compared, healthy=healthy)
    verdict, effects, smaller = _effects(outcome, gap, shown)
    return result.Diagnosis(
        verdict=verdict,
        among=outcome.judged.among if verdict == "confusion_set" else None,
        effects=effects,
        smaller=smaller,
        not_testable=_not_testable(outcome),
        **{**errors, "gap": gap},
        calibration=_calibration(outcome.specimen) if outcome.specimen else None,
        ranking=ranking(outcome.found),
        tried=tried(outcome.found),
        judged=certainties(outcome),
        rivals=(_rivals(outcome.sets.rows[:BEST_SETS]),),
        next_experiment=_next_experiment(outcome),
        notes=tuple(remarks),
        rollouts=problem.replay.rollouts,
        seconds=perf_counter() - began,
    )


def errors_of(problem: Problem, baseline: Hypothesis, final: Hypothesis) -> dict[str, Any]:
    """Computes errors of the nominal, recalibrated and final model, as fields of a `Diagnosis`."""
    models = {"before": Hypothesis(), "baseline": baseline, "after": final}
    squares = {name: problem.noise_levels(h) for name, h in models.items()}

    def levels(windows: np.ndarray) -> dict[str, Any]:
        return {name: result.root_mean(square[windows]) for name, square in squares.items()}

    owners = [problem.replay.recording == i for i in range(len(problem.series))]
    recordings = tuple(
        result.RecordingGap(name=series.name, held_out=bool(problem.held[own].any()), **levels(own))
        for series, own in zip(problem.series, owners, strict=True)
    )
    held_out = tuple(r.name for r in recordings if r.held_out)
    return {
        "where": isolate(problem),
        "gap": result.Gap(held_out=held_out, **levels(problem.judged)),
        "recordings": recordings,
        "remaining": _remaining(problem, final),
        "whole": whole_recording(problem, final),
        "traces": traces(problem, final),
    }


def _hardly_shows(outcome: Outcome, without: np.ndarray) -> bool:
    """Tests whether the named effects hardly change predictions in the judged windows.

    True if the share of windows with a change is far smaller than among all windows, or if the
    errors `without` the effects, (windows,), are no larger than a healthy specimen's.
    """
    problem = outcome.about
    if outcome.specimen and result.root_mean(without[problem.judged]) <= math.exp(DAY_FACTOR):
        return True
    change = problem.raw_errors(outcome.unnamed) - problem.raw_errors(outcome.final)
    square = np.mean(whitened(problem.noise.whitening, change) ** 2, axis=1)
    shows = square > max(1.0, problem.thresholds.shown_share * float(np.median(square)))
    return bool(shows[problem.judged].mean() < problem.thresholds.shown_share * shows.mean())


def _effects(
    outcome: Outcome, gap: result.Gap, shown: np.ndarray
) -> tuple[result.Verdict, tuple[result.NamedEffect, ...], tuple[result.NamedEffect, ...]]:
    """Returns verdict, named effects and smaller differences, the largest contribution first.

    `shown` masks the windows on which the explained share is computed.
    """
    judged, problem, final = outcome.judged, outcome.about, outcome.final
    unnamed, after, floor = gap.shown
    explained = gap.explained or 0.0
    verdict = judged.verdict
    if verdict in ("named", "confusion_set") and explained < EXPLANATION:
        verdict = "unexplained"
    effects = []
    for key in outcome.named:
        site = problem.library.sites[key]
        told = key if key in (*judged.named, *judged.confusion) else (key[0], EVERY)
        one = judged.effects[told]
        gone = final.without(key)
        without = result.root_mean(outcome.compared.noise_levels(gone)[shown])
        contribution = (without - after) / max(unnamed - floor, 1e-9)
        # No effect of a confusion set gets a confidence above one half.
        confidence = one.confidence if judged.named else min(one.possible, one.evidence, NAMED)
        if explained < EXPLANATION:
            # No effect is confidently named while most of the error is left.
            confidence = min(confidence, explained)
        begins = zip(problem.series, outcome.onsets.get(key, ()), strict=False)
        onsets = [(s.name, s.time[0], ends) for s, ends in begins if np.isfinite(ends).all()]
        estimates = _estimates(outcome, key)
        effects.append(
            result.NamedEffect(
                name=key[0],
                element=key[1],
                group=site.effect.group,
                physics=site.effect.physics,
                onset=tuple((name, float(ends.mean() - first)) for name, first, ends in onsets),
                onset_interval=tuple((n, *(ends - first).tolist()) for n, first, ends in onsets),
                confidence=float(confidence),
                contribution=float(np.clip(contribution, 0.0, 1.0)),
                parameters=estimates[: len(site.parameters)],
                differences=estimates[len(site.parameters) :],
                indistinguishable_from=tuple(
                    dict.fromkeys(k[0] for k in judged.confusion if k not in (key, told))
                ),
                without=result.root_mean(problem.noise_levels(gone)[problem.judged]),
            )
        )
    effects.sort(key=lambda e: -e.contribution)
    # Smaller effects are listed separately only if there is a named main cause.
    small = SMALL if judged.named and len(effects) > 1 else 0.0
    smaller = tuple(e for e in effects if e.contribution < small)
    return verdict, tuple(e for e in effects if e not in smaller), smaller


def _estimates(outcome: Outcome, key: Key) -> tuple[result.Estimate, ...]:
    """Returns an effect's parameters, then differences of directions, with 95 % intervals.

    If the machine does not follow an effect's law exactly, the estimate depends on the motion.
    Therefore the interval is widened by the share `LAW` of the change, unless the model is exact.
    """
    evidence, site = outcome.row.evidence, outcome.about.library.sites[key]
    u, parameters = evidence.unknowns, site.parameters
    own = [u.places.index(((key, i),)) for i in range(len(parameters))]
    told = np.concatenate([np.eye(len(parameters)), site.differences])
    values = outcome.final[key].tolist()
    scaled = told * np.array([p.step(v) for p, v in zip(parameters, values, strict=True)])
    spread = np.diag(scaled @ outcome.spread[np.ix_(own, own)] @ scaled.T)
    # The scatter is estimated from few parts of recordings, so Student's distribution applies.
    width = float(student.ppf(0.975, max(int(evidence.part.max()), 1)))
    strength = np.array([p.role == "strength" for p in parameters])
    change = told @ ((outcome.final[key] - site.nominal) * strength)
    law = (LAW if outcome.row.level > EXPLAINED else 0.0) * change
    # A limit's change counts from the largest recorded value; `law` is at most `LAW` of the limit.
    limits = [i for i, p in enumerate(parameters) if p.limit_of]
    law[limits] = np.minimum(np.abs(law[limits]), LAW * np.abs(outcome.final[key][limits]))
    half = np.hypot(width * np.sqrt(spread), 1.96 * law)
    rows = [(p.name, p.unit, p.lower, p.upper) for p in parameters]
    units = {p.name: p.unit for p in parameters}
    for first, second in site.effect.by_direction:
        name = f"{first}_less_{second.rpartition('_')[2]}"
        rows.append((name, units[first], -math.inf, math.inf))
    numbers = np.stack([told @ outcome.final[key], told @ site.nominal, half], axis=1).tolist()
    return tuple(
        _estimate(name, unit, value, nominal, max(lower, value - h), min(upper, value + h))
        for (name, unit, lower, upper), (value, nominal, h) in zip(rows, numbers, strict=True)
    )


def _estimate(
    name: str, unit: str, value: float, nominal: float, low: float, high: float
) -> result.Estimate:
    return result.Estimate(name=name, unit=unit, value=value, nominal=nominal, interval=(low, high))


def _rivals(rows: Sequence[Row]) -> result.Rivals:
    """Computes the probability of each set against each other set; equal sets count once."""
    rows = [row for n, row in enumerate(rows) if all(row.keys != r.keys for r in rows[:n])]
    joined = [" + ".join(sorted(k[0] for k in row.keys)) or "nothing" for row in rows]
    places = [" + ".join(f"{name} at {element}" for name, element in sorted(r.keys)) for r in rows]
    # Sets with the same effects on different elements are named by effects and elements.
    names = tuple(n if joined.count(n) == 1 else p for n, p in zip(joined, places, strict=True))
    logs = np.array([row.score.log for row in rows])
    preference = 1.0 / (1.0 + np.exp(np.clip(logs[None, :] - logs[:, None], -500, 500)))
    return result.Rivals(
        names=names, cost=tuple(row.level**2 for row in rows), preference=preference
    )


def _remaining(problem: Problem, final: Hypothesis) -> tuple[result.Remaining, ...]:
    """Computes RMS errors of the nominal and the final model at the end of the judged windows."""
    before, after = (problem.raw_errors(h)[problem.judged][:, :, -1] for h in (Hypothesis(), final))
    noise = np.median(problem.sensor_noise, axis=0)
    return tuple(
        result.Remaining(
            channel=channel.column,
            unit="Pa" if channel.chamber else problem.machine.unit(channel.joint),
            horizon=problem.replay.window,
            before=float(rms(before[:, k])),
            after=float(rms(after[:, k])),
            noise=float(noise[k]),
        )
        for k, channel in enumerate(problem.channels)
    )


def _calibration(specimen: Specimen) -> result.Calibration:
    """Returns the calibration of a specimen for the page, the largest departures first."""
    problem, rows = specimen.problem, []
    for key, site in problem.library.sites.items():
        values = site.model.tolist(), specimen.values[key].tolist()
        for p, nominal, v in zip(site.parameters, *values, strict=True):
            away = p.departure(v, nominal)
            if p.role == "strength" and away >= problem.thresholds.calibration_share:
                rows.append((away, (*key, _estimate(p.name, p.unit, v, nominal, v, v))))
    rows.sort(key=lambda row: -row[0])
    levels = zip(problem.series, specimen.levels.tolist(), strict=True)
    return result.Calibration(
        recordings=tuple((series.name, before, after) for series, (before, after) in levels),
        estimates=tuple(row for _, row in rows),
    )


def _next_experiment(outcome: Outcome) -> result.Proposal | None:
    """Proposes an experiment that discriminates the first two effects of a confusion set."""
    rivals: dict[str, Hypothesis] = {}
    for key in outcome.judged.confusion:
        if key[0] not in rivals:
            rivals[key[0]] = next(r for r in outcome.sets.rows if key in r.keys).hypothesis
    return propose(outcome.problem, dict([*rivals.items()][:2])) if len(rivals) > 1 else None


def _not_testable(outcome: Outcome) -> tuple[result.NotTestable, ...]:
    """Lists effects that the recordings hardly show, or that are faster than a sampling period."""
    found, problem = outcome.found, outcome.problem
    first, spread, u = found.first, found.ranks[0].evidence.spread, found.fitter.at.unknowns
    evidence = found.fitter.evidence(first, spread, np.ones(len(first.errors)), 1.0, places=[0])
    shown = np.diag(evidence.whole.every(0, 0)).tolist()
    columns = [(q, 1 + q) for q in range(len(u)) if u.nameable[q]]
    columns += [(q, 1 + len(u) + j) for j, (q, _) in enumerate(first.jumps)]
    seen: dict[Key, float] = {}
    for q, column in columns:
        seen[u.keys[q]] = max(seen.get(u.keys[q], 0.0), shown[column])
    rate = f"needs more than {1.0 / problem.series[0].period:.3g} samples a second"
    reasons = dict.fromkeys(sorted(problem.library.too_fast), rate)
    reasons |= {
        key: f"needs {problem.library.sites[key].effect.excitation}"
        for key, visible in sorted(seen.items())
        if visible < VISIBLE and key not in outcome.named and key[1] != EVERY
    }
    return tuple(result.NotTestable(name=n, element=e, reason=r) for (n, e), r in reasons.items())


def traces(problem: Problem, final: Hypothesis) -> tuple[result.ResidualTrace, ...]:
    """Returns replay errors of the nominal and the final model by recording and channel."""
    replay = problem.replay
    before, after = (problem.raw_errors(h) for h in (Hypothesis(), final))
    # A replay predicts the samples after each step, so the first sample is left out.
    measured = replay.measured()[:, :, 1:].reshape((*before.shape, -1)).mean(axis=3)
    rows = []
    for i, series in enumerate(problem.series):
        own = replay.recording == i
        for k, channel in enumerate(problem.channels):
            index, position, velocity = bin_motion(problem, i, channel.joint)
            a, b = (series.columns.get(f"{channel.joint}_pressure_{c}") for c in "ab")
            rows.append(
                result.ResidualTrace(
                    recording=series.name,
                    channel=channel.column,
                    unit="Pa" if channel.chamber else problem.machine.unit(channel.joint),
                    time=series.time[index],
                    position=position,
                    velocity=velocity,
                    pressure=None if a is None or b is None else (a - b)[index],
                    before=before[own, k].ravel(),
                    after=after[own, k].ravel(),
                    measured=measured[own, k].ravel(),
                    bins=replay.bins,
                )
            )
    return tuple(rows)
