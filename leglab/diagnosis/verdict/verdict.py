"""From recordings to the verdict: names, confusion sets, confidence, gaps."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import mujoco
import numpy as np

from leglab.base.recording import Recording
from leglab.diagnosis.balance.isolation import isolate, sample_places
from leglab.diagnosis.effects.hypothesis import Hypothesis, Key, Library
from leglab.diagnosis.effects.joints import unit
from leglab.diagnosis.former.fitting import Fit
from leglab.diagnosis.former.judging import preferences
from leglab.diagnosis.former.naming import estimate, judge_exact, judge_rough, rms, twins
from leglab.diagnosis.former.search import Contender
from leglab.diagnosis.former.specimen import Specimen, calibrate
from leglab.diagnosis.former.workflow import DiagnosisSettings, Search, search, set_up
from leglab.diagnosis.intake.admission import admit
from leglab.diagnosis.intake.recordings import split_held_out
from leglab.diagnosis.intake.remarks import Remark, merged
from leglab.diagnosis.plant.model import CYLINDER, Machine
from leglab.diagnosis.replay.residual import Problem
from leglab.diagnosis.replay.windows import UniformSeries
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
)
from leglab.diagnosis.verdict.experiment import propose
from leglab.diagnosis.verdict.measure import Measure
from leglab.diagnosis.verdict.whole import whole_recording

_HARDLY_SHOWN = (
    "the held-out recordings hardly show what is named: the share explained is that over all "
    "recordings"
)
# Poses of a recording that are looked at for contacts.
_POSES = 50


def diagnose(
    model: str | Path,
    recordings: Mapping[str, Recording],
    *,
    held_out: Iterable[str] | None = None,
    healthy: Mapping[str, Recording] | None = None,
    settings: DiagnosisSettings | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Diagnosis, Search]:
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
        The verdict, and the search that it rests on.

    Raises:
        LeglabError: Model or recordings cannot be used.
    """
    began = perf_counter()
    settings = settings or DiagnosisSettings()
    progress("reading the machine")
    if held_out is None:
        recordings, held_out = split_held_out(model, recordings, (), settings.thresholds)
    held_out = tuple(held_out)
    specimen = None
    if healthy:
        # A specimen differs in more than the effects that the user asks for.
        whole = replace(settings, effects=None, excluded=())
        specimen = calibrate(set_up(model, healthy, (), whole, beside=recordings), progress)
    values = specimen.values if specimen else None
    problem = set_up(model, recordings, held_out, settings, specimen=values, beside=healthy)
    remarks = admit(problem.machine, recordings, held_out, settings.thresholds).notes
    if healthy:
        remarks += admit(problem.machine, healthy, (), settings.thresholds).notes
    found = search(problem, settings, progress, specimen)
    progress("verdict")
    result = assemble(found, settings, seconds=perf_counter() - began)
    return replace(result, notes=(*remarks, *result.notes)), found


def assemble(found: Search, settings: DiagnosisSettings, *, seconds: float) -> Diagnosis:
    """Builds the verdict of a finished search."""
    problem, limits = found.problem, found.problem.thresholds
    rng = np.random.default_rng(settings.seed + 1)
    baseline, final = found.baseline.hypothesis, found.fit.hypothesis
    models = {"before": Hypothesis(), "baseline": baseline, "after": final}
    if found.named:
        models["unnamed"] = final.without(*found.named)
    squares = {k: problem.noise_levels(h) for k, h in models.items()}
    windows = [problem.replay.recording == i for i in range(len(problem.series))]
    held = problem.judged
    names = [s.name for s in problem.series]
    judged = [bool(problem.held[own].any()) for own in windows]
    specimen = found.specimen
    levels = {k: rms(squares[k][held]) for k in squares}
    measure = Measure.of(problem, specimen)
    gap = Gap(
        held_out=tuple(name for name, held_out in zip(names, judged, strict=True) if held_out),
        before=levels["before"],
        baseline=levels["baseline"],
        after=levels["after"],
        unnamed=levels.get("unnamed", math.nan),
        healthy=_healthy_level(specimen, problem, held) if specimen else None,
    )
    shown = held
    if found.named:
        errors = [measure.squares(h) for h in (models["unnamed"], final)]
        every = np.ones_like(held)
        compared, overall = (
            (rms(errors[0][w]), rms(errors[1][w]), measure.floor(w)) for w in (held, every)
        )
        if measure.hardly_shows(held, models["unnamed"], final):
            # A slow motion that nobody fitted cannot tell what a fast one would show.
            compared, shown = overall, every
        gap = replace(gap, compared=compared, everywhere=overall)
    rivals = tuple(
        Rivals(
            round=i,
            names=_labels(one.contenders),
            cost=tuple(float(c.cost.mean()) for c in one.contenders),
            preference=preferences([c.cost for c in one.contenders], rng, limits.resamples),
        )
        for i, one in enumerate(found.rounds, 1)
        if one.contenders and not one.at_once  # two that were fitted together are no rivals
    )
    verdict, effects, smaller = (
        judge_rough(found, gap, lambda h: rms(measure.squares(h)[shown]))
        if found.rough
        else judge_exact(found, rng)
    )
    where, ceiling = isolate(problem)
    return Diagnosis(
        verdict=verdict,
        effects=effects,
        smaller=smaller,
        rough=found.rough,
        where=where,
        not_testable=_not_testable(found),
        gap=gap,
        recordings=tuple(
            RecordingGap(
                name=name,
                held_out=held_out,
                **{k: rms(squares[k][own]) for k in ("before", "baseline", "after")},
            )
            for name, held_out, own in zip(names, judged, windows, strict=True)
        ),
        remaining=_remaining(problem, final, held),
        whole=whole_recording(problem, final),
        calibration=_calibration(specimen) if specimen else None,
        ceiling=ceiling,
        ranking=tuple(
            Rank(name=c.key[0], element=c.key[1], round=i, gain=c.gain, threshold=one.threshold)
            for i, one in enumerate(found.rounds, 1)
            for c in one.candidates
        ),
        rivals=rivals,
        traces=traces(problem, final),
        nuisances=nuisance_estimates(problem, found.fit),
        next_experiment=_next_experiment(found, effects),
        notes=(
            *notes(problem),
            *at_limits(problem.library, {k: found.fit.hypothesis[k] for k in found.named}),
            *([_HARDLY_SHOWN] if shown is not held else ()),
        ),
        rollouts=problem.replay.rollouts,
        seconds=seconds,
    )


def _labels(contenders: Sequence[Contender]) -> tuple[str, ...]:
    """Names of contenders, with the element where two share a name."""
    count = Counter(c.key[0] for c in contenders)
    return tuple(
        name if count[name] == 1 else f"{name} at {element}"
        for name, element in (c.key for c in contenders)
    )


def _healthy_level(specimen: Specimen, problem: Problem, held: np.ndarray) -> float:
    """Error to expect of the healthy specimen in the held-out recordings, in noise levels."""
    nearest = specimen.nearest(problem.series)
    levels = np.array([specimen.after[i] for i in nearest])
    return rms(levels[problem.replay.recording[held]] ** 2)


def _remaining(problem: Problem, final: Hypothesis, held: np.ndarray) -> tuple[Remaining, ...]:
    """Errors at the end of held-out windows before and after."""
    before, after = (problem.raw_errors(h)[held][:, :, -1] for h in (Hypothesis(), final))
    noise = np.median(problem.sensor_noise, axis=0)
    return tuple(
        Remaining(
            channel=channel.column,
            unit="Pa" if channel.chamber else unit(problem.machine, channel.joint),
            horizon=problem.replay.window,
            before=rms(before[:, k] ** 2),
            after=rms(after[:, k] ** 2),
            noise=float(noise[k]),
        )
        for k, channel in enumerate(problem.channels)
    )


def _calibration(specimen: Specimen) -> Calibration:
    """The calibration for the page: what departed most."""
    problem, fit = specimen.problem, specimen.fit
    limits = problem.thresholds
    rows = []
    for n in problem.active_nuisances(fit.free):
        value = n.value(fit.hypothesis)
        away = abs(value - n.nominal) / n.tolerance
        if away >= limits.calibration_share:
            p = problem.library.sites[n.key].parameters[n.index]
            rows.append((away, (*n.key, estimate(p, n.nominal, value, value, value))))
    rows.sort(key=lambda row: -row[0])
    names = (series.name for series in problem.series)
    return Calibration(
        recordings=tuple(zip(names, specimen.before, specimen.after, strict=True)),
        estimates=tuple(row for _, row in rows),
    )


def _next_experiment(found: Search, effects: Sequence[NamedEffect]) -> Proposal | None:
    """Experiment that would tell the first effect that is tied from its rival."""
    for effect in effects:
        if twins(found.problem, (effect.name, effect.element)):
            continue  # No excitation tells them apart, only a further sensor.
        for tried in (*found.checks.values(), *(one.contenders for one in found.rounds)):
            fits = {c.key[0]: c.fit.hypothesis for c in tried}
            tied = [name for name in effect.indistinguishable_from if name in fits]
            if effect.name in fits and tied:
                rivals = {effect.name: fits[effect.name], tied[0]: fits[tied[0]]}
                return propose(found.problem, rivals)
    return None


def _not_testable(found: Search) -> tuple[NotTestable, ...]:
    """Effects that the recordings did not excite, or that are over between two samples."""
    problem = found.problem
    rate = f"needs more than {1.0 / problem.series[0].period:.3g} samples a second"
    reasons = dict.fromkeys(sorted(problem.library.too_fast), rate)
    for one in found.rounds[:1]:
        for c in one.candidates:
            if c.detectable < problem.thresholds.detectable and c.key not in found.named:
                reasons[c.key] = f"needs {problem.library.sites[c.key].effect.excitation}"
    return tuple(NotTestable(name=n, element=e, reason=r) for (n, e), r in reasons.items())


def nuisance_estimates(problem: Problem, fit: Fit) -> tuple[Estimate, ...]:
    """Refitted nuisance parameters, with the range of their tolerance."""
    return tuple(
        estimate(
            problem.library.sites[n.key].parameters[n.index],
            n.nominal,
            float(n.value(fit.hypothesis)),
            n.nominal - 1.96 * n.tolerance,
            n.nominal + 1.96 * n.tolerance,
        )
        for n in problem.active_nuisances(fit.free)
    )


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
            room = 1e-3 * (p.upper - p.lower)
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
        rows = np.linspace(0, one.time.size - 1, _POSES).astype(int)
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
                    unit="Pa" if channel.chamber else unit(problem.machine, channel.joint),
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
