"""Runs in words: what was tested, what happened, what it shows and what not."""

import math
from collections.abc import Sequence
from operator import attrgetter

import numpy as np

from leglab.report.page.outcome import NOTHING, mrad, sentence, share
from leglab.report.page.shell import Section
from leglab.report.page.wording import capital, listed, number, readable
from leglab.runs.folder import ReportedRun
from leglab.runs.record import ChangeRecord as Change

# Settings that runs must share for their errors to be compared.
_DECISIVE = (
    "scenario",
    "model",
    "duration",
    "severity",
    "ramp_duration",
    "reference",
    "reference_config",
    "seed",
    "sensors",
    "timestep",
    "tolerance",
    "vary",
)
# Differences below this share are none that one would speak of.
_ALIKE = 0.05
_TIMES = "\u00d7"
# More rivals than this make no headline.
_MOST_TOLD = 3
# Below this share of the time, a fallback or a saturated valve is not worth a sentence.
_RARE = 0.001


def relative(value: float, base: float) -> str:
    """A change against a base: "38 % less", "2.5 times as much"."""
    if not base > 0:
        return "no ratio"
    ratio = value / base
    if abs(ratio - 1.0) < 0.005:
        return "the same"
    if ratio >= 2.0:
        return f"{number(ratio)} times as much"
    return f"{number(100.0 * abs(ratio - 1.0), 2)} % {'more' if ratio > 1 else 'less'}"


def title(runs: Sequence[ReportedRun]) -> str:
    """Returns the title: scenario, model and controllers."""
    scenarios = tuple(dict.fromkeys(run.metrics.scenario for run in runs))
    models = tuple(dict.fromkeys(run.metrics.model for run in runs))
    labels = tuple(run.label for run in runs)
    return f"{listed(scenarios)} on {listed(models)}: {listed(labels)}"


def headline(runs: Sequence[ReportedRun]) -> str:
    """The outcome in one sentence."""
    if len(runs) == 1:
        return _single(runs[0])
    whole = [run for run in runs if run.metrics.completed]
    stopped = tuple(run.label for run in runs if not run.metrics.completed)
    ending = f"; {listed(stopped)} stopped early" if stopped else ""
    if not whole:
        return "All runs stopped early."
    if different(runs):
        return f"{len(runs)} runs that differ in more than their controllers{ending}."
    best = min(whole, key=attrgetter("error"))
    if len(whole) == 1:
        text = f"only {best.label} came to the end: {mrad(best.error)} RMS error"
    elif max(run.error for run in whole) <= (1 + _ALIKE) * best.error:
        text = f"no controller is clearly better: all within {100 * _ALIKE:.0f} % in RMS error"
    else:
        others = sorted((run for run in whole if run is not best), key=attrgetter("error"))
        if len(others) > _MOST_TOLD:
            others = [runs[0] if runs[0] in others else others[0]]
        told = listed(tuple(f"{run.label} {mrad(run.error)}" for run in others))
        text = f"{best.label} tracked best: {mrad(best.error)} RMS error; {told}"
    return f"{capital(best.judged_over)}, {text}{ending}."


def sections(runs: Sequence[ReportedRun]) -> tuple[Section, ...]:
    """Questions a reader has, in the order in which they are asked."""
    names = tuple(f"{run.label}:" for run in runs) if len(runs) > 1 else ()
    happened = tuple(_happened(run) for run in runs)
    parts = (
        Section(title="What was tested", lines=_tested(runs)),
        Section(title="What happened", lines=happened, names=names),
        Section(title="Verdict", lines=_verdict(runs)),
        Section(title="What this does not show", lines=_limits(runs)),
    )
    return tuple(part for part in parts if part.lines)


def different(runs: Sequence[ReportedRun]) -> tuple[str, ...]:
    """Settings other than the controller in which the runs differ."""
    return tuple(n for n in _DECISIVE if any(run.setting(n) != runs[0].setting(n) for run in runs))


def change_words(change: Change) -> str:
    """One change, for instance "internal leakage of all elements = 2" or with a factor."""
    where = "all elements" if change.element == "*" else change.element
    sign = _TIMES if change.kind == "scale" else "="
    return f"{readable(change.parameter)} of {where} {sign} {change.value:g}"


def _single(run: ReportedRun) -> str:
    if not run.metrics.completed:
        return f"{run.label} stopped at {run.metrics.duration:.2f} s of {run.planned:g} s."
    found = run.metrics.adaptation
    if found.before_rad is not None:
        return (
            f"{run.label}: {mrad(found.before_rad['all'])} RMS error in the {found.span_s:g} s "
            f"before the change, {mrad(run.error)} {run.judged_over}."
        )
    return f"{run.label} tracked to {mrad(run.error)} RMS {run.judged_over}."


def _tested(runs: Sequence[ReportedRun]) -> tuple[str, ...]:
    differing = different(runs)
    if differing:
        told = listed(tuple(readable(name) for name in differing))
        return (
            f"{len(runs)} runs that differ in {told}; the settings below tell each of them.",
            "Their errors stand side by side, but no ratio between them says which controller is "
            "better.",
        )
    run = runs[0]
    joints = f"{len(run.joints)} driven joint{'s' * (len(run.joints) != 1)}"
    text = (
        f"Scenario {run.metrics.scenario} on the model {run.metrics.model} with {joints}; "
        f"reference {run.setting('reference')}, {run.planned:g} s, seed {run.metrics.seed}."
    )
    return (text, *(_change(change) for change in run.configuration.changes))


def _change(change: Change) -> str:
    over = f", over {change.ramp_duration:g} s" if change.ramp_duration else ", at once"
    if change.start <= 0:
        return f"From the start: {change_words(change)}."
    return f"At {change.start:g} s: {change_words(change)}{over}."


def _happened(run: ReportedRun) -> str:
    parts = []
    if not run.metrics.completed:
        reason = (run.metrics.failure or "no reason was stored").rstrip(".")
        parts.append(
            f"Stopped at {run.metrics.duration:.2f} s of {run.planned:g} s: {reason}. What follows "
            "holds as far as it came."
        )
    last, joint = run.last, max(run.joints, key=lambda name: run.last.peak_rad[name])
    peak = f"at most {mrad(last.peak_rad[joint])} (at {joint})"
    if run.before is not None and last is not run.before:
        found, told = run.metrics.adaptation, []
        if found.before_rad is not None:
            before = found.before_rad["all"]
            told.append(f"{mrad(before)} in the {found.span_s:g} s before the change")
        told.append(
            f"{mrad(last.rms_rad['all'])} in the {number(last.end - last.start)} s after it"
        )
        if found.end_rad is not None:
            told.append(f"{mrad(run.error)} {run.judged_over}")
        parts.append(f"RMS error {', '.join(told)}, {peak}.")
        parts.append(sentence(found))
    else:
        parts.append(f"RMS error {mrad(run.error)} {run.judged_over}, {peak}.")
    parts += _fallback(run)
    saturated = _saturation(run)
    if saturated > _RARE:
        parts.append(f"A valve was at its limit {number(100 * saturated, 2)} % of the time.")
    energy, seconds = last.energy_j.get("all"), min(last.end, run.metrics.duration) - last.start
    if energy is not None and seconds > 0:
        parts.append(f"Hydraulic power drawn: {number(energy / seconds)} W.")
    return " ".join(parts)


def _fallback(run: ReportedRun) -> list[str]:
    """Tells which share of the time the nominal map stood in for the adapted, by phase."""
    if not all(f"{joint}_fallback" in run.recording for joint in run.joints):
        return []
    values = run.recording.stack(run.joints, "fallback")
    time, told = run.recording.time, []
    for phase in run.metrics.phases:
        part = (time >= phase.start) & (time <= phase.end)
        if not part.any():
            continue
        shares = np.nanmean(values[part] > 0.5, axis=0).tolist()
        mean = math.fsum(shares) / len(shares)
        if mean > _RARE:
            place = "in all" if phase.name == "whole" else f"{phase.name} the change"
            text = f"{100 * mean:.1f} % of the time {place}"
            if len(shares) > 1:
                worst = run.joints[int(np.argmax(shares))]
                text += f" (most at {worst}: {100 * max(shares):.0f} %)"
            told.append(text)
    if not told:
        return ["It never fell back to the static feed-forward."]
    return [f"It fell back to the static feed-forward {listed(tuple(told))}."]


def _verdict(runs: Sequence[ReportedRun]) -> tuple[str, ...]:
    if len(runs) < 2 or different(runs):
        return ()
    first, lines = runs[0], []
    if not first.metrics.completed:
        return (f"{first.label}, the first, stopped early: nothing is compared with it.",)
    for run in runs[1:]:
        if not run.metrics.completed:
            lines.append(f"{run.label} stopped early, so it is not compared.")
            continue
        ratio = run.error / first.error if first.error > 0 else math.nan
        if abs(ratio - 1.0) < _ALIKE:
            word = "is about as good as"
        else:
            word = "tracks better than" if ratio < 1 else "tracks worse than"
        text = (
            f"{run.label} {word} {first.label}: {relative(run.error, first.error)} RMS "
            f"error {run.judged_over}."
        )
        ours, theirs = run.metrics.adaptation, first.metrics.adaptation
        if ours.recovered is not None and theirs.recovered is not None:
            undone = (
                f"Of what the change did it undoes {share(ours)}, {first.label} {share(theirs)}"
            )
            if share(ours) == share(theirs) == NOTHING:
                undone = "Neither undoes anything of what the change did"
            text += f" {undone}."
        lines.append(text)
    return tuple(lines)


def _limits(runs: Sequence[ReportedRun]) -> tuple[str, ...]:
    lines = [
        "These are simulations. One run a controller says nothing about the scatter over seeds; "
        "leglab compare gives intervals."
    ]
    if any(not run.metrics.completed for run in runs):
        lines.append("Figures of a run that stopped early cover another time than the others'.")
    if any(run.label and run.metrics.controller == "oracle" for run in runs):
        lines.append("oracle knows the changed machine beforehand: it is a bound, no rival.")
    return tuple(lines)


def _saturation(run: ReportedRun) -> float:
    """Share of the time that at least one valve command was at its limit."""
    actuators = run.recording.actuators
    if not actuators:
        return 0.0
    commands = run.recording.stack(actuators, "command")
    return float(np.mean((np.abs(commands) >= 1.0).any(axis=1)))
