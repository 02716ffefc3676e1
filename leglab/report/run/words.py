"""Texts about runs: what was tested, what happened, what it shows and what it does not."""

import math
from collections.abc import Sequence
from operator import attrgetter

import numpy as np

from leglab.machine.changes import parameter_units
from leglab.report.page.outcome import milli, sentence, share
from leglab.report.page.shell import Section
from leglab.report.page.wording import capital, listed, number, readable, readable_unit
from leglab.runs.folder import ReportedRun
from leglab.runs.record import ChangeRecord as Change

# Settings that runs must share for their errors to be compared.
_DECISIVE = (
    *("scenario", "model", "duration", "severity", "ramp_duration", "element", "reference"),
    *("reference_config", "seed", "sensors", "timestep", "tolerance", "vary"),
)
# Errors whose relative difference is at most this count as equal.
_ALIKE = 0.05
_TIMES = "\u00d7"
# If the best run has more rivals than this, the headline names one rival only.
_MOST_TOLD = 3
# Texts give the ratio of two errors if it is at least this; otherwise the difference in percent.
_CLEARLY = 1.5
# Controllers that know the changed machine, as no real controller can.
_BOUNDS = ("oracle", "exact_inverse")
# A command of at least this magnitude is at its limit, 1; rounding may make it slightly smaller.
_LIMIT = 1.0 - 1e-9

# Below this share of the time, a fallback or a saturated valve is not worth a sentence.
_RARE = 0.001


def title(runs: Sequence[ReportedRun]) -> str:
    """Returns the title: scenario, model and controllers."""
    scenarios = tuple(dict.fromkeys(run.metrics.scenario for run in runs))
    models = tuple(dict.fromkeys(run.metrics.model for run in runs))
    labels = tuple(run.label for run in runs)
    return f"{listed(scenarios)} on {listed(models)}: {listed(labels)}"


def headline(runs: Sequence[ReportedRun]) -> str:
    """Returns the outcome in one sentence."""
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
        text = f"only {best.label} came to the end: {milli(best.error, best.unit)} RMS error"
    elif max(run.error for run in whole) <= (1 + _ALIKE) * best.error:
        text = f"no controller is clearly better: all within {100 * _ALIKE:.0f} % in RMS error"
    else:
        others = sorted((run for run in whole if run is not best), key=attrgetter("error"))
        if len(others) > _MOST_TOLD:
            others = [runs[0] if runs[0] in others else others[0]]
        told = listed(tuple(f"{run.label} {milli(run.error, run.unit)}" for run in others))
        text = f"{best.label} tracked best: {milli(best.error, best.unit)} RMS error; {told}"
    return f"{capital(best.judged_over)}, {text}{ending}."


def sections(runs: Sequence[ReportedRun]) -> tuple[Section, ...]:
    """Returns the sections of the page, in the order of readers' questions."""
    names = tuple(f"{run.label}:" for run in runs) if len(runs) > 1 else ()
    happened = tuple(_happened(run) for run in runs)
    parts = (
        Section(title="What was tested", lines=_tested(runs)),
        _controllers(runs),
        Section(title="What happened", lines=happened, names=names),
        _noticed(runs),
        Section(title="Verdict", lines=_verdict(runs)),
        Section(title="What this does not show", lines=_limits(runs)),
    )
    return tuple(part for part in parts if part.lines)


def _noticed(runs: Sequence[ReportedRun]) -> Section:
    """Returns a section on the machine's changes that controllers reported; it may be empty."""
    told = [(run.label, event.told()) for run in runs for event in run.metrics.events]
    told += [(run.label, trend.told()) for run in runs for trend in run.metrics.health]
    names = tuple(f"{label}:" for label, _ in told) if len(runs) > 1 else ()
    lines = tuple(f"{line}." for _, line in told)
    return Section(title="What was named while it ran", lines=lines, names=names)


def different(runs: Sequence[ReportedRun]) -> tuple[str, ...]:
    """Returns the decisive settings in which the runs differ, the controller excepted."""
    return tuple(n for n in _DECISIVE if any(run.setting(n) != runs[0].setting(n) for run in runs))


def change_words(change: Change) -> str:
    """Describes a change: "internal leakage of all elements = 2", or with a factor."""
    where = change.place
    if change.kind == "scale":
        return f"{readable(change.parameter)} of {where} {_TIMES} {change.value:g}"
    unit = readable_unit(parameter_units().get(change.parameter, ""))
    return f"{readable(change.parameter)} of {where} = {change.value:g} {unit}".rstrip()


def _single(run: ReportedRun) -> str:
    if not run.metrics.completed:
        return f"{run.label} stopped at {run.metrics.duration:.2f} s of {run.planned:g} s."
    found = run.metrics.adaptation
    if found.before_rad is not None:
        return (
            f"{run.label}: {milli(found.before_rad['all'], run.unit)} RMS error in the "
            f"{found.span_s:g} s before the change, {milli(run.error, run.unit)} {run.judged_over}."
        )
    return f"{run.label} tracked to {milli(run.error, run.unit)} RMS {run.judged_over}."


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
    return (
        f"Scenario {run.metrics.scenario} on the model {run.metrics.model} with {joints}; "
        f"reference {run.setting('reference')}, {run.planned:g} s, seed {run.metrics.seed}.",
        *(_change(change) for change in run.configuration.changes),
    )


def _controllers(runs: Sequence[ReportedRun]) -> Section:
    """Returns the summary of each controller that is installed."""
    import leglab.controllers  # noqa: F401  registers the controllers
    from leglab.control import controller_names, controller_summary

    used = dict.fromkeys(run.metrics.controller for run in runs)
    names = tuple(name for name in used if name in controller_names())
    return Section(
        title="The controllers",
        lines=tuple(f"{capital(controller_summary(name))}." for name in names),
        names=tuple(f"{name}:" for name in names),
    )


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
    peak = f"at most {milli(last.peak_rad[joint], run.metrics.error_unit(joint))} (at {joint})"
    if run.before is not None and last is not run.before:
        found, told = run.metrics.adaptation, []
        if found.before_rad is not None:
            before = found.before_rad["all"]
            told.append(f"{milli(before, run.unit)} in the {found.span_s:g} s before the change")
        after = number(last.end - last.start)
        told.append(f"{milli(last.rms_rad['all'], run.unit)} in the {after} s after it")
        if found.end_rad is not None:
            told.append(f"{milli(run.error, run.unit)} {run.judged_over}")
        parts.append(f"RMS error {', '.join(told)}, {peak}.")
        parts.append(sentence(found, run.unit))
    else:
        parts.append(f"RMS error {milli(run.error, run.unit)} {run.judged_over}, {peak}.")
    parts += _fallback(run)
    saturated = _saturation(run)
    if saturated > _RARE:
        what = "A valve" if run.recording.actuators_are_valves else "A drive"
        parts.append(f"{what} was at its limit {number(100 * saturated, 2)} % of the time.")
    if run.power is not None:
        span = f"{number(last.end - last.start)} s" + " after the change" * (run.before is not None)
        energy = number(last.energy_j["all"])
        parts.append(f"The supply gave {energy} J in the {span}, {number(run.power)} W on average.")
    return " ".join(parts)


def _fallback(run: ReportedRun) -> list[str]:
    """Describes in each phase how long the calibrated valve map replaced the adapted map."""
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
        return ["What it had learned was in use all the time."]
    return [
        "The calibrated valve map stood in for what it had learned "
        f"{listed(tuple(told))}: it falls back where its own prediction is off."
    ]


def _verdict(runs: Sequence[ReportedRun]) -> tuple[str, ...]:
    if different(runs):
        return ()
    whole = [run for run in runs if run.metrics.completed]
    lines = [f"{run.label} stopped early: it is not judged." for run in runs if run not in whole]
    lines += [_against(run, whole[0]) for run in whole[1:]]
    lines += _won_back(whole)
    return (*lines, *_choice(whole))


def _against(run: ReportedRun, first: ReportedRun) -> str:
    """Compares the tracking errors of a run and of the first run."""
    ratio = first.error / run.error if run.error > 0 else math.inf
    if abs(ratio - 1.0) < _ALIKE:
        how = "about as closely as"
    elif ratio >= _CLEARLY:
        how = f"{number(ratio, 2)} times as closely as"
    elif ratio > 1:
        how = f"{number(100.0 * (ratio - 1.0), 2)} % more closely than"
    else:
        how = "less closely than"
    both = f"{milli(run.error, run.unit)} against {milli(first.error, first.unit)}"
    text = f"{run.label} follows the reference {how} {first.label}"
    return f"{text}: {both} RMS error {run.judged_over}."


def _won_back(runs: Sequence[ReportedRun]) -> list[str]:
    """Describes the share of the damage that each run undoes; runs of equal share are together."""
    told: dict[str, list[str]] = {}
    judged = [run for run in runs if run.metrics.adaptation.recovered is not None]
    for run in sorted(judged, key=lambda run: -(run.metrics.adaptation.recovered or 0.0)):
        told.setdefault(share(run.metrics.adaptation), []).append(run.label)
    phrases = tuple(
        f"{listed(tuple(who))} {'win' if len(who) > 1 else 'wins'} back {much}"
        for much, who in told.items()
    )
    return [f"Of the accuracy that the change costs, {listed(phrases)}."] if told else []


def _choice(runs: Sequence[ReportedRun]) -> list[str]:
    """Recommends a controller if one is clearly better than all others."""
    rivals = sorted(
        (run for run in runs if run.metrics.controller not in _BOUNDS), key=attrgetter("error")
    )
    if len(rivals) < 2 or rivals[1].error <= (1 + _ALIKE) * rivals[0].error:
        return []
    change = " that changes like this" if rivals[0].before is not None else ""
    return [f"Of these, {rivals[0].label} is the one for a machine{change}."]


def _limits(runs: Sequence[ReportedRun]) -> tuple[str, ...]:
    lines = [
        "These are simulations. One run a controller says nothing about the scatter over seeds; "
        "leglab compare gives intervals."
    ]
    if any(not run.metrics.completed for run in runs):
        lines.append("Figures of a run that stopped early cover another time than the others'.")
    for name in _BOUNDS:
        if any(run.metrics.controller == name for run in runs):
            lines.append(f"{name} knows the changed machine beforehand: it is a bound, no rival.")
    return tuple(lines)


def _saturation(run: ReportedRun) -> float:
    """Returns the share of the time at which at least one command was at its limit."""
    found = [run.recording.command_of(joint) for joint in run.joints]
    commands = [values for values in found if values is not None]
    return float(np.mean((np.abs(commands) >= _LIMIT).any(axis=0))) if commands else 0.0
