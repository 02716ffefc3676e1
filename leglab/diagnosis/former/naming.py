"""Which effects are named, how sure each name is, and what is not told apart from it."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import mujoco
import numpy as np

from leglab.diagnosis.effects.base import EffectParameter
from leglab.diagnosis.effects.hypothesis import Hypothesis, Key, Site
from leglab.diagnosis.former.directions import pushed_instead
from leglab.diagnosis.former.evidence import within_library
from leglab.diagnosis.former.heavier import resisted_instead
from leglab.diagnosis.former.judging import (
    earns,
    fault_probability,
    intervals,
    nothing_more,
    preferences,
    probabilities,
)
from leglab.diagnosis.former.nuisances import Nuisance, all_strengths
from leglab.diagnosis.former.rough import cost_under
from leglab.diagnosis.former.search import Contender, total_cost
from leglab.diagnosis.former.workflow import Search
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.replay.residual import Problem
from leglab.diagnosis.replay.windows import Channel
from leglab.diagnosis.result import Estimate, Gap, NamedEffect, Verdict

_DELAYS = frozenset({"command_delay", "sensor_delay"})
# Correlation in the mass matrix below which two joints do not feel each other: rounding.
_COUPLED = 1e-9

# Verdict, named effects and smaller differences.
Judged = tuple[Verdict, tuple[NamedEffect, ...], tuple[NamedEffect, ...]]


def judge_exact(found: Search, rng: np.random.Generator) -> Judged:
    """The verdict on a model that is taken for exact: the right effects leave noise."""
    problem, limits = found.problem, found.problem.thresholds
    start = float(problem.window_cost(found.baseline.hypothesis).mean())
    end = float(problem.window_cost(found.fit.hypothesis).mean())
    # Share of the robust misfit of the baseline that the final fit takes away.
    share = (start - end) / max(start - 1.0, 1e-3)
    quality = 1.0
    if end > limits.explained:
        quality = limits.explained / end * float(np.clip(share, 0.0, 1.0))

    def contribution(without: Hypothesis) -> float:
        lost = float(problem.window_cost(without).mean())
        return (lost - end) / max(lost - 1.0, 1e-3)

    def weigh(own: Contender, rivals: Sequence[Contender]) -> Ties:
        return _by_resampling(found, own, rivals, rng)

    effects = _effects(found, contribution, weigh, quality)
    if not effects:
        return ("nothing_missing" if start <= limits.explained else "unexplained"), (), ()
    if end > limits.explained:
        sure = max(e.confidence for e in effects)
        partial = share >= limits.explanation_share and sure >= limits.partly
        return ("partial" if partial else "unexplained"), effects, ()
    tied = any(e.indistinguishable_from for e in effects)
    return ("confusion_set" if tied else "named"), effects, ()


def judge_rough(found: Search, gap: Gap, level: Callable[[Hypothesis], float]) -> Judged:
    """The verdict on a machine that differs from its model everywhere a little.

    An effect is named as the probable cause, whatever the model's own error leaves; how much it
    explains is another number. `level` is the error of a hypothesis as `gap.shown` has it.
    Effects that are probable and explain less than half are a part of what is missing.
    """
    limits = found.problem.thresholds
    unnamed, after, floor = gap.shown

    def contribution(without: Hypothesis) -> float:
        return (level(without) - after) / max(unnamed - floor, 1e-9)

    def weigh(own: Contender, rivals: Sequence[Contender]) -> Ties:
        ties = _by_posterior(found.problem, own, rivals)
        return _or_several(found, own.key, ties)

    explained, final = gap.explained or 0.0, found.fit.hypothesis
    known = found.specimen is not None
    beside = all_strengths(found.problem.library, limits.rough_share, 1.0)
    causes: list[NamedEffect] = []
    smaller: list[NamedEffect] = []
    quality = _in_library(found, gap.explained_everywhere or 0.0)
    for e in _effects(found, contribution, weigh, quality, beside):
        key = (e.name, e.element)
        # What takes back a part of the calibration does so beside a larger change only.
        own = fault_probability(found.problem, key, final, calibrated=known, beside=bool(causes))
        share = e.contribution if known else _share_of_saved(found, key)
        fault = share >= limits.smaller_share and own >= limits.fault
        if key == found.suspect:
            if not fault:
                continue
            own *= 1.0 - nothing_more(found.problem, found.rounds[-1])
        (causes if fault else smaller).append(replace(e, confidence=e.confidence * own))
    sure = max((e.confidence for e in causes), default=0.0)
    if not causes:
        verdict: Verdict = "nothing_missing" if _as_healthy(found) else "unexplained"
    elif found.suspect is not None:
        verdict = "unexplained"
    elif explained < limits.explanation_share:
        verdict = "partial" if sure >= limits.partly else "unexplained"
    else:
        tied = any(e.indistinguishable_from for e in causes)
        verdict = "confusion_set" if tied else "named"
    return verdict, tuple(causes), tuple(smaller)


def _in_library(found: Search, explained: float) -> float:
    """Probability that the cause is among the effects that were tried.

    With healthy recordings it follows from the share of the gap over all recordings that is
    explained: few numbers were fitted, and a recording that was held out may hardly show the cause.
    Without healthy recordings nobody knows which part of the error is the model's own: it may be
    most of it, and a right cause then closes little of the gap. By how much the error gets smaller,
    weighed as the search did, still tells right causes from wrong ones.
    """
    limits = found.problem.thresholds
    if found.specimen is not None:
        return within_library(explained, limits.library_odds)
    before, after = (total_cost(found.problem, fit).mean() for fit in (found.baseline, found.fit))
    return within_library(1.0 - float(after / before), limits.uncalibrated_odds)


def _share_of_saved(found: Search, key: Key) -> float:
    """Share of an effect in what all that were found save, from the final fit without it."""
    problem, final = found.problem, found.fit.hypothesis
    left = float(problem.window_cost(final).mean())
    own, all_of_them = (
        float(problem.window_cost(without).mean()) - left
        for without in (final.without(key), final.without(*found.named))
    )
    return own / max(all_of_them, 1e-9)


def _as_healthy(found: Search) -> bool:
    """Whether a specimen, known from healthy recordings, errs as it did in them."""
    if found.specimen is None:
        return False
    problem = found.problem
    floor = found.specimen.discrepancy_of(problem.series)
    return cost_under(problem, found.baseline, floor) <= problem.thresholds.explained


# Names that are not told apart from an effect, and its probability.
Ties = tuple[tuple[str, ...], float]


def _effects(
    found: Search,
    contribution: Callable[[Hypothesis], float],
    weigh: Callable[[Contender, Sequence[Contender]], Ties],
    quality: float,
    beside: Sequence[Nuisance] | None = None,
) -> tuple[NamedEffect, ...]:
    """Named effects, the largest contribution first.

    Args:
        found: The search.
        contribution: Share of the gap that an effect closes, from the final fit without it.
        weigh: Rivals that are not told apart from a contender, and its probability among them.
        quality: Factor of all confidences.
        beside: What else may be off a little, as for `intervals`.
    """
    problem, final = found.problem, found.fit.hypothesis
    half = intervals(problem, found.fit, beside) if found.named else {}
    if beside is not None:
        half = {k: _allowing_for_structure(problem, k, final[k], half[k]) for k in found.named}
    effects = []
    for key in found.named:
        site = problem.library.sites[key]
        without = final.without(key)
        tied, probability = _ties(found, key, weigh)
        onsets = zip(problem.series, final.onsets.get(key, ()), strict=False)
        between = zip(problem.series, found.onsets.get(key, ()), strict=False)
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
                onset_interval=tuple(
                    (series.name, *(both - series.time[0]).tolist())
                    for series, both in between
                    if np.isfinite(both).all()
                ),
                confidence=probability * quality,
                contribution=float(np.clip(contribution(without), 0.0, 1.0)),
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
                without=rms(problem.noise_levels(without)[problem.judged]),
            )
        )
    return tuple(sorted(effects, key=lambda e: -e.contribution))


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


def _allowing_for_structure(
    problem: Problem, key: Key, values: np.ndarray, half: np.ndarray
) -> np.ndarray:
    """Half widths, as `intervals` has them, where the machine's laws are not the model's.

    A parameter of another law than the machine's is one thing in a slow motion and another in a
    fast one: by how much scales with the change, which no spread of errors shows.
    """
    site = problem.library.sites[key]
    strength = np.array([p.role == "strength" for p in site.parameters])
    moved = (values - site.nominal) * strength
    change = np.abs(np.concatenate([moved, site.differences @ moved]))
    return np.hypot(half, 1.96 * problem.thresholds.rough_size * change)


def _ties(found: Search, key: Key, weigh: Callable[[Contender, Sequence[Contender]], Ties]) -> Ties:
    """Rivals that explain the recordings as well as a named effect, and the name's probability.

    Rivals of an early round that lacked the other effects say little: where an effect was checked
    beside all others, that counts.
    """
    library = found.problem.library
    alike = tuple(t for t in twins(found.problem, key) if t in library.names)
    if alike:
        return alike, 1.0 / (1 + len(alike))
    sets = [found.checks[key]] if key in found.checks else [r.contenders for r in found.rounds]
    fits = [(c, tried) for tried in sets for c in tried if c.key == key]
    if not fits:
        return (), 1.0
    own, tried = min(fits, key=lambda entry: entry[0].cost.mean())
    # What was fitted together with it is none.
    others = [c for c in tried if c.key not in {key, *found.named} and c.fit is not own.fit]
    # A rival that says the same with more parameters is none, unless those pay.
    rivals = [c for c in others if not library.contains(c.key, key) or earns(found.problem, c, own)]
    return weigh(own, rivals)


def _by_resampling(
    found: Search, own: Contender, rivals: Sequence[Contender], rng: np.random.Generator
) -> Ties:
    """Ties of an exact model: the share of resampled windows that prefer the name to a rival."""
    limits = found.problem.thresholds
    tied, confidence = [], 1.0
    for rival in rivals:
        preferred = preferences([own.cost, rival.cost], rng, limits.resamples)[0, 1]
        near = rival.cost.mean() - own.cost.mean() < limits.distance
        if preferred < limits.preference or near:
            tied.append(rival.key[0])
        confidence = min(confidence, 0.5 if near else preferred)
    return tuple(tied), float(confidence)


def _by_posterior(problem: Problem, own: Contender, rivals: Sequence[Contender]) -> Ties:
    """Ties of a rough machine, whose errors are mostly the model's own."""
    share = probabilities(problem, (own, *rivals))
    tie = problem.thresholds.rough_tie
    tied = [c.key[0] for c, p in zip(rivals, share[1:], strict=True) if p * tie > share[0]]
    return tuple(tied), float(share[0])


def _or_several(found: Search, key: Key, ties: Ties) -> Ties:
    """Ties of an effect with several that move the machine as it does.

    They are told by their error alone. Friction with a constant force is two causes, and as much
    less probable as there are effects; inertia with friction is one, for a load brings both.
    """
    problem, (tied, probability) = found.problem, ties
    several = (
        (pushed_instead, 1.0 / len(problem.library.searched)),
        (resisted_instead, 1.0),
    )
    for stand_ins, prior in several:
        names, ratio = stand_ins(problem, found.fit, key)
        if ratio * problem.thresholds.rough_tie > 1.0:
            tied = (*tied, *(name for name in names if name not in tied))
        probability /= 1.0 + probability * ratio * prior
    return tied, probability


def twins(problem: Problem, key: Key) -> tuple[str, ...]:
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


def estimate(p: EffectParameter, nominal: float, value: float, low: float, high: float) -> Estimate:
    """A fitted parameter with its interval, beside its value in the model or specimen."""
    return Estimate(
        name=p.name, unit=p.unit, value=value, nominal=float(nominal), interval=(low, high)
    )


def rms(squares: np.ndarray) -> float:
    """Root of the mean of squares; NaN of none."""
    return float(np.sqrt(squares.mean())) if squares.size else float("nan")
