"""From recordings to the verdict: names, confusion sets, confidence, gaps."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import mujoco
import numpy as np

from leglab.base.recording import Recording
from leglab.diagnosis.admission import admit
from leglab.diagnosis.effects.base import EffectParameter
from leglab.diagnosis.effects.joints import unit
from leglab.diagnosis.experiment import propose
from leglab.diagnosis.fitting import Fit
from leglab.diagnosis.hypothesis import Hypothesis, Key
from leglab.diagnosis.isolation import isolate, sample_places
from leglab.diagnosis.judging import earns, intervals, posterior, preferences, within_library
from leglab.diagnosis.model import CYLINDER, Machine
from leglab.diagnosis.remarks import Remark, merged
from leglab.diagnosis.residual import Problem
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
from leglab.diagnosis.search import Contender
from leglab.diagnosis.specimen import Specimen, calibrate
from leglab.diagnosis.windows import Channel, UniformSeries
from leglab.diagnosis.workflow import DiagnosisSettings, Search, search, set_up

_DELAYS = frozenset({"command_delay", "sensor_delay"})
_HARDLY_SHOWN = (
    "the held-out recordings hardly show what is named: the share explained is that over all "
    "recordings",
)
# Poses of a recording that are looked at for contacts.
_POSES = 50
# Correlation in the mass matrix below which two joints do not feel each other: rounding.
_COUPLED = 1e-9


def diagnose(
    model: str | Path,
    recordings: Mapping[str, Recording],
    *,
    held_out: Iterable[str],
    healthy: Mapping[str, Recording] | None = None,
    settings: DiagnosisSettings | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Diagnosis, Search]:
    """Diagnoses a model on recordings.

    Args:
        model: MJCF file, or the name of a model that ships with leglab.
        recordings: By name.
        held_out: Names of the recordings on which the verdict is judged.
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
    held_out = tuple(held_out)
    specimen = None
    if healthy:
        every = replace(settings, effects=None, excluded=())
        specimen = calibrate(set_up(model, healthy, (), every, beside=recordings), progress)
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
    held = problem.held if problem.held.any() else np.ones_like(problem.held)
    names = [s.name for s in problem.series]
    judged = [bool(problem.held[own].any()) for own in windows]
    specimen = found.specimen
    levels = {k: _rms(squares[k][held]) for k in squares}
    gap = Gap(
        held_out=tuple(name for name, held_out in zip(names, judged, strict=True) if held_out),
        before=levels["before"],
        baseline=levels["baseline"],
        after=levels["after"],
        unnamed=levels.get("unnamed", math.nan),
        healthy=_healthy_level(found, held) if specimen else None,
    )
    judged_on = held
    if found.named:
        every = np.ones_like(held)
        floors = [_healthy_level(found, mask) for mask in (held, every)]
        unnamed = _rms(squares["unnamed"])
        if gap.unnamed - floors[0] < limits.shown_share * (unnamed - floors[1]):
            # A slow motion that nobody fitted cannot tell what a fast one would show.
            gap = replace(gap, overall=(unnamed, _rms(squares["after"]), floors[1]))
            judged_on = every
    rivals = tuple(
        Rivals(
            round=i,
            names=tuple(c.key[0] for c in one.contenders),
            cost=tuple(float(c.cost.mean()) for c in one.contenders),
            preference=preferences([c.cost for c in one.contenders], rng, limits.resamples),
        )
        for i, one in enumerate(found.rounds, 1)
        if one.contenders
    )
    judge = _judge_rough if found.rough else _judge_exact
    verdict, effects, smaller = judge(found, gap, judged_on, rng)
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
                **{k: _rms(squares[k][own]) for k in ("before", "baseline", "after")},
            )
            for name, held_out, own in zip(names, judged, windows, strict=True)
        ),
        remaining=_remaining(problem, final, held),
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
        notes=notes(problem) + (_HARDLY_SHOWN if gap.overall else ()),
        rollouts=problem.replay.rollouts,
        seconds=seconds,
    )


# Verdict, named effects and smaller differences.
Judged = tuple[Verdict, tuple[NamedEffect, ...], tuple[NamedEffect, ...]]


def _judge_exact(found: Search, gap: Gap, held: np.ndarray, rng: np.random.Generator) -> Judged:
    """The verdict on a model that is taken for exact: the right effects leave noise."""
    problem, limits = found.problem, found.problem.thresholds
    start = float(problem.window_cost(found.baseline.hypothesis).mean())
    end = float(problem.window_cost(found.fit.hypothesis).mean())
    # Share of the robust misfit of the baseline that the final fit takes away.
    share = (start - end) / max(start - 1.0, 1e-3)
    quality = 1.0
    if end > limits.explained:
        quality = limits.explained / end * float(np.clip(share, 0.0, 1.0))

    def contribution(key: Key) -> float:
        lost = float(problem.window_cost(found.fit.hypothesis.without(key)).mean())
        return (lost - end) / max(lost - 1.0, 1e-3)

    def ties(key: Key) -> tuple[tuple[str, ...], float]:
        tied, certainty = _ties(found, key, rng)
        return tied, certainty * quality

    effects = _effects(found, contribution, ties)
    if not effects:
        return ("nothing_missing" if start <= limits.explained else "unexplained"), (), ()
    if end > limits.explained:
        partial = share >= limits.explanation_share
        return ("partial" if partial else "unexplained"), effects, ()
    tied = any(e.indistinguishable_from for e in effects)
    return ("confusion_set" if tied else "named"), effects, ()


def _judge_rough(found: Search, gap: Gap, held: np.ndarray, rng: np.random.Generator) -> Judged:
    """The verdict on a machine that differs from its model everywhere a little.

    An effect is named as the probable cause, whatever the model's own error leaves; how much it
    explains is another number.
    """
    del rng
    problem, limits = found.problem, found.problem.thresholds
    final = found.fit.hypothesis
    unnamed, after, floor = gap.overall or (gap.unnamed, gap.after, gap.healthy or gap.noise_floor)

    def contribution(key: Key) -> float:
        lost = _rms(problem.noise_levels(final.without(key))[held]) - after
        return lost / max(unnamed - floor, 1e-9)

    listed = within_library(gap.explained or 0.0)

    def ties(key: Key) -> tuple[tuple[str, ...], float]:
        tied, share = _rough_ties(found, key)
        return tied, share * listed

    effects = _effects(found, contribution, ties)
    causes = tuple(e for e in effects if e.contribution >= limits.smaller_share)
    smaller = tuple(e for e in effects if e.contribution < limits.smaller_share)
    if not causes:
        healthy = found.specimen is not None
        return ("nothing_missing" if healthy and _as_healthy(found) else "unexplained"), (), smaller
    if (gap.explained or 0.0) < limits.explanation_share:
        return "unexplained", causes, smaller
    tied = any(e.indistinguishable_from for e in causes)
    return ("confusion_set" if tied else "named"), causes, smaller


def _as_healthy(found: Search) -> bool:
    """Whether the specimen errs as it did in its healthy recordings."""
    problem, specimen = found.problem, found.specimen
    floor = specimen.discrepancy_of(problem.series) if specimen else None
    cost = problem.trusting(floor).window_cost(found.baseline.hypothesis)
    return float(cost.mean()) <= problem.thresholds.explained


def _healthy_level(found: Search, held: np.ndarray) -> float:
    """Error to expect of the healthy specimen in the held-out recordings, in noise levels."""
    specimen = found.specimen
    if specimen is None:
        return 1.0
    nearest = specimen.nearest(found.problem.series)
    levels = np.array([specimen.after[i] for i in nearest])
    return _rms(levels[found.problem.replay.recording[held]] ** 2)


def _remaining(problem: Problem, final: Hypothesis, held: np.ndarray) -> tuple[Remaining, ...]:
    """Errors at the end of held-out windows before and after."""
    before, after = (problem.raw_errors(h)[held][:, :, -1] for h in (Hypothesis(), final))
    noise = np.median(problem.sensor_noise, axis=0)
    return tuple(
        Remaining(
            channel=channel.column,
            unit="Pa" if channel.chamber else unit(problem.machine, channel.joint),
            horizon=problem.thresholds.window,
            before=_rms(before[:, k] ** 2),
            after=_rms(after[:, k] ** 2),
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
            estimate = _estimate(p, n.nominal, value, value, value)
            rows.append((away, (*n.key, estimate)))
    rows.sort(key=lambda row: -row[0])
    names = (series.name for series in problem.series)
    return Calibration(
        recordings=tuple(zip(names, specimen.before, specimen.after, strict=True)),
        estimates=tuple(row for _, row in rows),
    )


def _effects(
    found: Search,
    contribution: Callable[[Key], float],
    ties: Callable[[Key], tuple[tuple[str, ...], float]],
) -> tuple[NamedEffect, ...]:
    """Named effects, the largest contribution first, with their confidence."""
    problem, final = found.problem, found.fit.hypothesis
    held = problem.held if problem.held.any() else np.ones_like(problem.held)
    half = intervals(problem, found.fit) if found.named else {}
    effects = []
    for key in found.named:
        site = problem.library.sites[key]
        tied, confidence = ties(key)
        onsets = zip(problem.series, final.onsets.get(key, ()), strict=False)
        effects.append(
            NamedEffect(
                name=key[0],
                element=key[1],
                group=site.effect.group,
                physics=site.effect.physics,
                onset=tuple(
                    (series.name, float(time - series.time[0]))
                    for series, time in onsets
                    if np.isfinite(time)
                ),
                confidence=confidence,
                contribution=float(np.clip(contribution(key), 0.0, 1.0)),
                parameters=tuple(
                    _estimate(
                        p, n, float(v), max(p.lower, float(v - h)), min(p.upper, float(v + h))
                    )
                    for p, n, v, h in zip(
                        site.parameters, site.nominal, final[key], half[key], strict=True
                    )
                ),
                indistinguishable_from=tied,
                without=_rms(problem.noise_levels(final.without(key))[held]),
            )
        )
    return tuple(sorted(effects, key=lambda e: -e.contribution))


def _rough_ties(found: Search, key: Key) -> tuple[tuple[str, ...], float]:
    """Rivals on a rough machine that are hardly less probable, and the name's probability."""
    limits = found.problem.thresholds
    names = found.problem.library.names
    twins = tuple(t for t in _twins(found.problem, key) if t in names)
    if twins:
        return twins, 1.0 / (1 + len(twins))
    own, tried = _contest(found, key)
    if own is None:
        return (), 1.0
    rivals = [c for c in tried if c.key != key and c.key not in found.named]
    rivals = [
        c
        for c in rivals
        if not found.problem.library.contains(c.key, key) or earns(found.problem, c, own)
    ]
    costs = [float(c.cost.mean()) for c in (own, *rivals)]
    share = posterior(costs, limits.rough_numbers)
    tied = [
        c.key[0] for c, p in zip(rivals, share[1:], strict=True) if p * limits.rough_tie > share[0]
    ]
    return tuple(tied), float(share[0])


def _contest(found: Search, key: Key) -> tuple[Contender | None, tuple[Contender, ...]]:
    """The fit that an effect was named for, and all that were tried in its place.

    Rivals of an early round that lacked the other effects say little: where an effect was checked
    beside all others, that counts.
    """
    sets = [found.checks[key]] if key in found.checks else [r.contenders for r in found.rounds]
    fits = [(c, tried) for tried in sets for c in tried if c.key == key]
    return min(fits, key=lambda entry: entry[0].cost.mean()) if fits else (None, ())


def _ties(found: Search, key: Key, rng: np.random.Generator) -> tuple[tuple[str, ...], float]:
    """Rivals that explain the recordings as well, and the name's confidence against all."""
    limits = found.problem.thresholds
    names = found.problem.library.names
    twins = tuple(t for t in _twins(found.problem, key) if t in names)
    if twins:
        return twins, 1.0 / (1 + len(twins))
    own, tried = _contest(found, key)
    if own is None:
        return (), 1.0
    tied, confidence = [], 1.0
    for rival in tried:
        if rival.key == key or rival.key in found.named:
            continue
        if found.problem.library.contains(rival.key, key) and not earns(found.problem, rival, own):
            continue  # The rival says the same with more parameters.
        preferred = preferences([own.cost, rival.cost], rng, limits.resamples)[0, 1]
        near = rival.cost.mean() - own.cost.mean() < limits.distance
        if preferred < limits.preference or near:
            tied.append(rival.key[0])
        confidence = min(confidence, 0.5 if near else preferred)
    return tuple(tied), float(confidence)


def _twins(problem: Problem, key: Key) -> tuple[str, ...]:
    """Exact twins of an effect on an element of this machine."""
    machine = problem.machine
    joints = machine.driven.get(key[1], (key[1],))
    if set(joints) & set(coupled_joints(machine)):
        return ()  # Another joint feels when this one moves, and its position is the third signal.
    return exact_twins(problem.channels, key[0])


def coupled_joints(machine: Machine) -> tuple[str, ...]:
    """Joints whose acceleration acts on another joint, by the mass matrix at some poses."""
    model = machine.base.model
    data = mujoco.MjData(model)
    found: set[int] = set()
    for shift in (0.0, 0.4, -0.7):
        data.qpos[:] = model.qpos0 + shift
        mujoco.mj_forward(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        own = np.sqrt(np.diag(mass))
        share = np.abs(mass) / np.outer(own, own) - np.eye(model.nv)
        found |= set(np.flatnonzero((share > _COUPLED).any(axis=1)).tolist())
    return tuple(machine.joints[int(model.dof_jntid[k])] for k in sorted(found))


def exact_twins(channels: Sequence[Channel], name: str) -> tuple[str, ...]:
    """Effects that no recording of these channels can tell from one, whatever the excitation.

    A late command and a late position sensor shift the same motion against the same command. Only
    a third signal says which, and fits differ merely in where their windows start.
    """
    if name in _DELAYS and not any(c.chamber for c in channels):
        return tuple(sorted(_DELAYS - {name}))
    return ()


def _next_experiment(found: Search, effects: Sequence[NamedEffect]) -> Proposal | None:
    """Experiment that would tell the first effect that is tied from its rival."""
    for effect in effects:
        if _twins(found.problem, (effect.name, effect.element)):
            continue  # No excitation tells them apart, only a further sensor.
        for tried in (*found.checks.values(), *(one.contenders for one in found.rounds)):
            fits = {c.key[0]: c.fit.hypothesis for c in tried}
            tied = [name for name in effect.indistinguishable_from if name in fits]
            if effect.name in fits and tied:
                rivals = {effect.name: fits[effect.name], tied[0]: fits[tied[0]]}
                return propose(found.problem, rivals)
    return None


def _not_testable(found: Search) -> tuple[NotTestable, ...]:
    """Effects that the recordings did not excite."""
    problem = found.problem
    return tuple(
        NotTestable(
            name=c.key[0],
            element=c.key[1],
            reason=f"needs {problem.library.sites[c.key].effect.excitation}",
        )
        for one in found.rounds[:1]
        for c in one.candidates
        if c.detectable < problem.thresholds.detectable and c.key not in found.named
    )


def nuisance_estimates(problem: Problem, fit: Fit) -> tuple[Estimate, ...]:
    """Refitted nuisance parameters, with the range of their tolerance."""
    return tuple(
        _estimate(
            problem.library.sites[n.key].parameters[n.index],
            n.nominal,
            float(n.value(fit.hypothesis)),
            n.nominal - 1.96 * n.tolerance,
            n.nominal + 1.96 * n.tolerance,
        )
        for n in problem.active_nuisances(fit.free)
    )


def _estimate(
    p: EffectParameter, nominal: float, value: float, low: float, high: float
) -> Estimate:
    return Estimate(
        name=p.name, unit=p.unit, value=value, nominal=float(nominal), interval=(low, high)
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


def _rms(squares: np.ndarray) -> float:
    return float(np.sqrt(squares.mean())) if squares.size else float("nan")
