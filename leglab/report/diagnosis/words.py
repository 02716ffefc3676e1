"""Texts of a diagnosis that a reader reads in one minute, before tables and figures.

Texts contain no markup; the page escapes them.
"""

import math
import re
from collections.abc import Mapping, Sequence

import numpy as np

from leglab.base.scale import rms
from leglab.causes.table import live_of
from leglab.diagnosis.result import (
    Calibration,
    Diagnosis,
    Estimate,
    NamedEffect,
    RecordingGap,
    Remaining,
    shown_unit,
)
from leglab.report.page.shell import Section
from leglab.report.page.wording import capital, listed, number, readable

# Explained share of the replay error beyond noise up to which texts say "hardly closes".
_HARDLY = 0.05
# Maximum number of channels that a sentence lists.
_CHANNELS = 6
# Maximum number of recalibrated parameters that a sentence lists.
_RECALIBRATED = 5
# Noise below this value [mrad, mm or bar] is reported as "under" the value.
_UNRESOLVED = 0.001
# Maximum number of hardly visible effects that have a line of their own.
_UNTOLD = 4
# Maximum number of sets of effects that are listed as having come closest.
_CLOSEST = 3
_CONFIDENCE = (
    "Confidence is the probability of the name among all sets of effects that were fitted: the "
    "least that is left without any one part of the recordings, and with errors counted in the "
    "motion or in units of the drive; lowered for causes that no effect here describes."
)
# Customary small units, used if all values are below a limit in SI: name, factor, limit.
_SMALL = {"s": ("ms", 1e3, 1.0), "m": ("mm", 1e3, 1.0), "rad": ("mrad", 1e3, 0.1)}
# Customary units of oil quantities, reported with the SI value in brackets: name, factor.
_OIL = {
    "m^3": ("cm^3", 1e6),
    "m^3/s": ("cm^3/s", 1e6),
    "m^3/s/Pa": ("cm^3/s/bar", 1e11),
    "Pa s/m^3": ("bar s/l", 1e-8),
}


def percent(share: float) -> str:
    """Formats a confidence from "under 1 %" to "over 99 %", because no method gives certainty."""
    if not math.isfinite(share):
        return "unknown"
    if share < 0.01:
        return "under 1 %"
    return "over 99 %" if share > 0.99 else f"{100.0 * share:.0f} %"


def finite_rms(arrays: Sequence[np.ndarray]) -> float:
    """Returns the root mean square of all finite values; NaN if there are none."""
    values = np.concatenate([np.ravel(a) for a in arrays])
    return float(rms(values[np.isfinite(values)]))


def headline(result: Diagnosis) -> str:
    """Returns the verdict in one sentence."""
    found = listed(tuple(_at(e) for e in result.effects))
    since = result.calibration is not None
    if result.verdict == "fitted":
        return f"Parameters of {found} are fitted."
    if result.verdict == "named":
        start = "Changed since the healthy recordings" if since else "The simulation is missing"
        return f"{start}: {found}."
    if result.verdict == "confusion_set":
        return _confused(result.effects, since=since)
    if result.verdict == "unexplained":
        start = "Simulation and recordings disagree"
        if since:
            start = "Something has changed since the healthy recordings"
        ending = f"; nearest comes {found}" if found else ""
        return f"{start}, and no known effect explains it{ending}."
    if since:
        return "Nothing has changed since the healthy recordings that these could show."
    return "Nothing is missing that these recordings could show."


def _confused(effects: Sequence[NamedEffect], *, since: bool) -> str:
    """Returns the verdict in one sentence if some effects are indistinguishable from others."""
    sure = listed(tuple(_at(effect) for effect in effects if not effect.indistinguishable_from))
    sets: dict[tuple[str, ...], list[str]] = {}
    for effect in effects:
        if effect.indistinguishable_from:
            names = (readable(effect.name), *_alternatives(effect))
            sets.setdefault(tuple(dict.fromkeys(names)), []).append(effect.element)
    told = "; and ".join(
        f"{listed(names, 'or')} at {listed(tuple(elements))}" for names, elements in sets.items()
    )
    start = "Something has changed" if since else "Something is missing"
    if not sets:  # effects are possible but not probable
        told = f"perhaps {sure}"
    elif since:
        also = f": {sure}, and one of these" if sure else ", one of these"
        return f"Changed since the healthy recordings{also}: {told}."
    elif sure:
        start = f"The simulation is missing {sure}, and something"
    return f"{start} that these recordings do not pin down: {told}."


def _alternatives(effect: NamedEffect) -> tuple[str, ...]:
    """Names the effects that are indistinguishable from one, some only together with friction."""
    tied = effect.indistinguishable_from
    friction = tuple(n for n in tied if n in ("coulomb_friction", "viscous_friction"))
    beside = {"asymmetric_friction": "force_offset", "actuator_gain": "armature"}.get(effect.name)
    if beside not in tied or not friction:
        return tuple(_tied(name, effect) for name in tied)
    rubbing = listed(tuple(map(readable, friction)))
    pushed = beside == "force_offset"
    both = f"{rubbing} with a force offset" if pushed else f"armature with {rubbing}"
    return (*(_tied(n, effect) for n in tied if n not in (*friction, beside)), both)


def _tied(name: str, effect: NamedEffect) -> str:
    """Returns an effect's name in words, or that it is the same effect at another element."""
    return "the same at another place" if name == effect.name else readable(name)


def facts(result: Diagnosis) -> tuple[tuple[str, str], ...]:
    """Returns terms with texts: missing effects, confidence, explained share, remaining error.

    Each of several effects has a line.
    """
    changed = "Changed" if result.calibration else "Missing"
    changed = "Fitted" if result.verdict == "fitted" else changed
    if result.effects:
        told = ([_named(e), *_values(e, result.nominal_words)] for e in result.effects)
        missing = ";\n".join(f"{name}: {', '.join(v)}" if v else name for name, *v in told)
        if result.verdict == "unexplained":
            missing = f"nothing that can be named; nearest comes {missing}"
        sized = [effect for effect in result.effects if math.isfinite(effect.confidence)]
        sure = "; ".join(f"{_at(effect)} {percent(effect.confidence)}" for effect in sized)
        if result.among is not None:
            sure = f"{percent(result.among)} that the cause is one of these"
        elif len(sized) == 1 == len(result.effects):
            sure = f"{percent(sized[0].confidence)} that the name is right"
    elif result.verdict == "nothing_missing":
        missing, sure = "nothing that these recordings could show", ""
    else:
        tried = f"the {len(result.ranking)} effects tried"
        missing = f"something that has no name among {tried}{_mostly(result)}"
        sure = "no name is probable enough to be told"
    explains, learned, explained = "", "", result.gap.explained
    if result.effects and explained is not None and math.isfinite(explained):
        explains = f"{100.0 * explained:.0f} % of {_gap_of(result)}"
    if result.learned and result.verdict != "nothing_missing":
        learned = f"without a name: {result.learned.rstrip('.')}"
    rows = {"How sure": sure, "Explains": explains, "Learned": learned, "Left": _left(result)}
    return tuple(
        (term, f"{capital(text)}.") for term, text in {changed: missing, **rows}.items() if text
    )


def _mostly(result: Diagnosis) -> str:
    """Returns in words at which element an unexplained error is largest; empty if unknown."""
    if not result.where:
        return ""
    worst = result.where[0]
    part = {"mechanical": "mechanics", "hydraulic": "hydraulics"}.get(worst.residual, "motion")
    place = "" if worst.region.startswith("everywhere") else f", {worst.region}"
    return f"; most of it in the {part} of {worst.element}{place}"


def sections(result: Diagnosis, model: str) -> tuple[Section, ...]:
    """Returns the sections of the page, in the order in which readers ask their questions."""
    before, unexplained = result.calibration, result.verdict == "unexplained"
    if result.verdict == "fitted":
        answers = {
            "What was looked at": _looked_at(result, model),
            "What was fitted": _missing(result),
            "What is left": _costs(result),
            "Where": _where(result),
            "Remarks": tuple(f"{capital(note).rstrip('.')}." for note in result.notes),
        }
        return _answered(answers)
    answers = {
        "What was looked at": _looked_at(result, model),
        "The specimen before": _before(before) if before else (),
        "What changed since" if before else "What is missing": _missing(result),
        "What was tried" if unexplained else "How sure": (_tried if unexplained else _sure)(result),
        "What is left": _costs(result),
        "Where": _where(result),
        "What cannot be told": _untold(result),
        "Next experiment": _next(result),
    }
    return _answered(answers)


def _answered(answers: Mapping[str, tuple[str, ...]]) -> tuple[Section, ...]:
    """Returns one section per question with a non-empty answer."""
    return tuple(Section(title=title, lines=lines) for title, lines in answers.items() if lines)


def parameter_words(p: Estimate) -> tuple[str, str, str]:
    """Returns value, 95 % interval and nominal value with units; oil values also in SI units.

    The number of digits is such that the ends of the interval differ as text.
    """
    value, ends, nominal, unit = parameter_numbers(p)
    beside = f" ({number(p.value)} {p.unit})" if p.unit in _OIL else ""
    text = f" {unit}" if unit else ""
    return f"{value}{text}{beside}", f"{ends}{text}", f"{nominal}{text}"


def parameter_numbers(p: Estimate) -> tuple[str, str, str, str]:
    """Returns value, 95 % interval, nominal value and unit (empty if dimensionless) as texts."""
    factor, unit = _parameter_unit(p)
    low, high = (factor * end for end in p.interval)
    half, size = (high - low) / 2.0, max(abs(low), abs(high))
    digits = 3
    if 0.0 < half < size and math.isfinite(size):
        digits = min(max(math.ceil(math.log10(size / half)) + 1, 3), 6)
    ends = f"{number(low, digits)} to {number(high, digits)}"
    value, nominal = number(factor * p.value, digits), number(factor * p.nominal)
    return value, ends, nominal, unit


def uncertain(p: Estimate) -> bool:
    """Tests whether the interval contains the nominal value or is wider than the value itself."""
    low, high = p.interval
    if not (math.isfinite(low) and math.isfinite(high)):
        return True
    return low < p.nominal < high or high - low > abs(p.value)


def improved_words(result: Diagnosis) -> str:
    """Describes content and reliability of the improved model, after its name on the page."""
    effects = () if result.verdict == "unexplained" else result.effects
    holds = ["parameters recalibrated within their tolerance"] if result.moved else []
    if effects:
        holds.append(listed(tuple(readable(effect.name) for effect in effects)))
    if result.learned:
        holds.append("a learned remainder")
    text = f"It holds {listed(tuple(holds or ['the model as it was']))}"
    text += "." if effects else "; no effect without a name is in it."
    if result.learned:
        text += f" Learned: {result.learned.rstrip('.')}."
    doubtful = []
    for effect in effects:
        for p in filter(uncertain, effect.parameters):
            value, interval, _ = parameter_words(p)
            doubtful.append(f"{readable(p.name)} of {_at(effect)} {value} (95 %: {interval})")
    if doubtful:
        text += f" Uncertain, check before use: {'; '.join(doubtful)}."
    return text


def main_channels(result: Diagnosis) -> tuple[str, ...]:
    """Returns channels of the joint with the largest error, joints with a named effect first."""
    remaining = {one.channel: one for one in result.remaining}
    channels = list(dict.fromkeys([*remaining, *(t.channel for t in result.traces)]))
    elements = [e.element for e in result.effects]

    def weight(channel: str) -> tuple[bool, float]:
        joint = joint_of(channel)
        near = any(e == joint or e.startswith(f"{joint}_") for e in elements)
        one = remaining.get(channel)
        if one is not None:
            return near, one.before / one.noise if one.noise > 0.0 else one.before
        return near, finite_rms([t.before for t in result.traces if t.channel == channel])

    positions = [c for c in channels if c.endswith("_position")] or channels[:1]
    chosen = [joint_of(channel) for channel in sorted(positions, key=weight, reverse=True)[:1]]
    return tuple(channel for channel in channels if joint_of(channel) in chosen)[:3]


def in_order(result: Diagnosis) -> tuple[RecordingGap, ...]:
    """Returns the recordings in the order of all tables and figures: held-out ones first."""
    return tuple(sorted(result.recordings, key=lambda r: not r.held_out))


def start(result: Diagnosis) -> str:
    """Returns in words which measured quantities determine the start of replays."""
    units = {one.unit for one in result.remaining} | {one.unit for one in result.traces}
    return "the measured motion" + " and pressures" * ("Pa" in units)


def after_start(result: Diagnosis) -> str:
    """Returns in words how long after the start of a replay errors are reported."""
    horizon = f"{result.remaining[0].horizon:.3g} s " if result.remaining else ""
    return f"{horizon}after a start from {start(result)}"


def joint_of(channel: str) -> str:
    """Returns the joint's name in a column's name."""
    return re.sub(r"_(position|pressure_[ab]|velocity)$", "", channel)


def after_words(result: Diagnosis) -> str:
    """Returns in words how the simulation "after" differs from the nominal model."""
    if not result.recalibrated:
        return "with the fitted parameters"
    if result.effects:
        return "with what was found"
    return "with the smaller differences" if result.smaller else "recalibrated"


def _parameter_unit(p: Estimate) -> tuple[float, str]:
    sizes = [abs(v) for v in (p.value, p.nominal, *p.interval) if math.isfinite(v)]
    largest = max(sizes, default=0.0)
    if p.unit == "Pa":
        return (1e-5, "bar") if largest >= 1e3 else (1.0, "Pa")
    if p.unit in _OIL:
        name, factor = _OIL[p.unit]
        return factor, name
    name, factor, limit = _SMALL.get(p.unit, ("", 1.0, 0.0))
    if 0.0 < largest < limit:
        return factor, name
    return 1.0, "" if p.unit == "1" else p.unit


def _at(effect: NamedEffect) -> str:
    return f"{readable(effect.name)} at {effect.element}"


def _named(effect: NamedEffect) -> str:
    """Returns effect and element, with the names that live scenarios give the same cause."""
    live = live_of(effect.name)
    also = f" [{listed(tuple(readable(name) for name in live), 'or')}]" if live else ""
    return f"{readable(effect.name)}{also} at {effect.element}"


def _values(effect: NamedEffect, nominal: str) -> list[str]:
    """Describes an effect's fitted parameters; `nominal` is the word "in the model" or "before"."""
    told = []
    for p in effect.estimates:
        value, interval, other = parameter_words(p)
        doubt = ", uncertain" * uncertain(p)
        told.append(f"{readable(p.name)} {value} (95 %: {interval}{doubt}), {nominal} {other}")
    return told


def _gap_of(result: Diagnosis) -> str:
    """Returns in words the error of which the effects explain a share."""
    held = result.gap.held_out
    place = f" on {listed(held)}" if held else ""
    if result.calibration is not None:
        return f"what went wrong{place} since the healthy recordings"
    return f"the error beyond sensor noise{place}"


def _left(result: Diagnosis) -> str:
    """Returns in words the errors at the end of a replay, in customary units, and sensor noise."""
    wanted = main_channels(result)
    rows = [one for one in result.remaining if one.channel in wanted]
    if not rows:
        return ""
    told = "; ".join(_error_words(one) for one in rows)
    return f"after {rows[0].horizon:.3g} s of simulation: {told}"


def _error_words(one: Remaining) -> str:
    factor, unit = shown_unit(one.unit)
    before, after = (number(factor * v) for v in (one.before, one.after))
    text = f"before {before} {unit}, "
    if one.learned is not None:
        text += f"with what was learned {number(factor * one.learned)} {unit}, "
    text += f"sensor noise {noise_words(one)}"
    return f"{readable(one.channel)} {after} {unit} off ({text})"


def noise_words(one: Remaining) -> str:
    """Formats sensor noise with its unit; noise that no test rig resolves as "under" a limit."""
    factor, unit = shown_unit(one.unit)
    if factor * one.noise < _UNRESOLVED:
        return f"under {_UNRESOLVED:g} {unit}"
    return f"{number(factor * one.noise)} {unit}"


def _looked_at(result: Diagnosis, model: str) -> tuple[str, ...]:
    held = tuple(r.name for r in result.recordings if r.held_out)
    names = tuple(r.name for r in in_order(result))
    count = len(names)
    judged = "No recording was kept apart: the verdict is judged on the data of the fit."
    if held:
        judged = f"{listed(held)} was kept from all fits; the verdict is judged on it."
    tried = f"{len(result.ranking)} possible effects tried, alone and together"
    if result.verdict == "fitted":
        judged = judged.replace("the verdict is", "the fit is")
        tried = f"{sum(len(e.parameters) for e in result.effects)} parameters, no search"
    return (
        f"Model {model}, {count} recording{'s' * (count != 1)}: {listed(names)}.",
        judged,
        f"{tried}, {result.rollouts:.0f} replays, {result.seconds:.0f} s.",
    )


def _before(calibration: Calibration) -> tuple[str, ...]:
    """Describes the calibration of this machine from its healthy recordings."""
    told = "; ".join(
        f"{name} {number(before)}, calibrated {number(after)}"
        for name, before, after in calibration.recordings
    )
    departed = []
    for effect, element, p in calibration.estimates[:_RECALIBRATED]:
        name = readable(effect if p.name == effect else f"{effect}, {p.name}")
        value, _, nominal = parameter_words(p)
        departed.append(f"{name} at {element} {value}, in the model {nominal}")
    differs = "No parameter differs from the model by more than is just noticeable."
    if departed:
        differs = f"What differs most from the model: {'; '.join(departed)}."
    return (
        f"Error of the model in the healthy recordings, in noise levels: {told}.",
        differs,
        "This was so before; what follows is what changed since.",
    )


def _missing(result: Diagnosis) -> tuple[str, ...]:
    lines = []
    for effect in result.effects:
        physics = f"{effect.physics.rstrip('.')}." if effect.physics else ""
        lines.append(f"{capital(_at(effect))}. {physics}".rstrip())
        if told := _values(effect, result.nominal_words):
            lines.append(f"Fitted: {'; '.join(told)}.")
        if effect.onset:
            lines.append(f"{capital(readable(effect.name))} begins {listed(effect.begins())}.")
    if not lines:
        lines.append(
            "Nothing at all is a likely explanation: no effect has to be there."
            if result.verdict == "nothing_missing"
            else "No effect that was tried explains it."
        )
    return (*lines, *smaller_words(result))


def smaller_words(result: Diagnosis) -> tuple[str, ...]:
    """Describes smaller differences, which are not the cause; empty if there are none."""
    if not result.smaller:
        return ()
    told = []
    for effect in result.smaller:
        many = len(effect.parameters) > 1
        values = ", ".join(
            f"{readable(p.name)} " * many + parameter_words(p)[0] for p in effect.parameters
        )
        closes = f"(closes {100.0 * effect.contribution:.0f} % of the gap)"
        told.append(f"{_at(effect)} {values}".rstrip() + f" {closes}")
    start = "There too, and not the cause" if result.effects else "There, and not the cause"
    return (f"{start}: {'; '.join(told)}.",)


def confidence(result: Diagnosis, effect: NamedEffect) -> str:
    """Returns the confidence of an effect, or of all effects indistinguishable from it."""
    return percent(effect.confidence if result.among is None else result.among)


def _sure(result: Diagnosis) -> tuple[str, ...]:
    lines = []
    for effect in result.effects:
        name = capital(readable(effect.name))
        others = " or another of these" if effect.indistinguishable_from else ""
        text = f"{name}{others}: confidence {confidence(result, effect)}"
        times = effect.without / result.gap.after if result.gap.after > 0.0 else math.nan
        if math.isfinite(times):
            text += (
                f"; without it the error is {number(times, 2)} times as large "
                f"({number(effect.without)} instead of {number(result.gap.after)} noise levels)"
            )
        lines.append(f"{text}.")
        if effect.indistinguishable_from:
            others = listed(_alternatives(effect), "or")
            lines.append(f"{name} is not told apart from {others}.")
    if not lines:
        return ("No effect is named, so there is no confidence to state.",)
    return (*lines, _CONFIDENCE)


def _tried(result: Diagnosis) -> tuple[str, ...]:
    """Describes the attempts to explain an error that remains unexplained."""
    sets = (name for rivals in result.rivals for name in rivals.names if name != "nothing")
    closest = listed(tuple(dict.fromkeys(map(readable, sets)))[:_CLOSEST])
    gap = result.gap
    lines = [
        f"{len(result.ranking)} possible effects, alone and together"
        + (f"; {closest} came closest." if closest else "."),
        f"The model errs by {number(gap.before)} noise levels, recalibrated within tolerance by "
        f"{number(gap.baseline)}.",
    ]

    told = []
    for one in sorted(result.moved, key=lambda m: -abs(m.share))[:_RECALIBRATED]:
        value, _, nominal = parameter_words(one.estimate)
        told.append(f"{readable(one.estimate.name)} {value}, in the model {nominal}")
    if told:
        lines.append(f"Recalibrated: {'; '.join(told)}.")
    for effect in result.effects:
        lines.append(f"{capital(_at(effect))}: confidence {percent(effect.confidence)}.")
    if result.effects:
        lines.append(_CONFIDENCE)
    if result.model:
        lines.append("The improved model carries no effect without a name.")
    elif "improved.xml" not in result.missing:
        lines.append("No improved model is written: nothing makes the held-out recordings better.")
    if result.learned:
        lines.append(f"Learned without a name: {result.learned.rstrip('.')}.")
    return tuple(lines)


def _costs(result: Diagnosis) -> tuple[str, ...]:
    gap = result.gap
    place = f"On {listed(gap.held_out)}" if gap.held_out else "On the recordings of the fit"
    error = f"{place} the simulation is off by {number(gap.before)} noise levels"
    if result.recalibrated:
        error += f"; recalibrated within tolerance, by {number(gap.baseline)}"
    if result.effects or result.smaller:
        error += f"; {after_words(result)}, by {number(gap.after)}"
    floor = f"Noise of the sensors alone gives {number(gap.noise_floor)}"
    if gap.healthy is not None:
        floor += f"; the healthy machine, calibrated, had {number(gap.healthy)}"
    lines = [f"{error}.", f"{floor}."]
    closed = gap.explained if gap.explained is not None else gap.closed_fraction
    if result.effects and closed is not None and math.isfinite(closed):
        share = f"{100.0 * closed:.0f} % of {_gap_of(result)} is explained."
        hardly = f"The gap hardly closes: {100.0 * closed:.0f} %."
        lines.append(share if closed > _HARDLY else hardly)
    told = main_channels(result)  # `_left` reports them at the top of the page.
    rows = [_error_words(one) for one in result.remaining if one.channel not in told][:_CHANNELS]
    if rows:
        lines.append(f"Elsewhere, {after_start(result)}, RMS: {'; '.join(rows)}.")
    return tuple(lines)


_RESIDUALS = {
    "mechanical": "Mechanics of {}, force balance from measured pressures and motion",
    "hydraulic": "Hydraulics of {}, oil balance from measured command, motion and pressures",
    "motion": "Motion of {}, replayed from the measured command",
}


def _where(result: Diagnosis) -> tuple[str, ...]:
    """Returns where simulation and data disagree, one line per element."""
    lines = []
    for w in result.where:
        place = w.region or "everywhere alike"
        worst = place if place.startswith("everywhere") else f"worst {place}"
        told = _RESIDUALS.get(w.residual, f"{capital(w.residual)} balance of {{}}")
        lines.append(f"{told.format(w.element)}: {number(w.level)} noise levels, {worst}.")
    if not lines:
        return ("No joint was measured in a way that says where.",)
    return (*lines, "This is the model as it was, along the measured motion.")


def _untold(result: Diagnosis) -> tuple[str, ...]:
    untold = tuple(f"{readable(n.name)} at {n.element}" for n in result.not_testable)
    lines = [
        f"{capital(name)}: {entry.reason.rstrip('.')}."
        for name, entry in zip(untold, result.not_testable, strict=True)
    ]
    if len(untold) > _UNTOLD:
        few = f"These recordings hardly show {listed(untold, 'or')}"
        lines = [f"{few}; the table below has what each needs."]
    names = tuple(r.name for r in result.recordings)
    for note in result.notes:
        told = note if note.startswith(names) else capital(note)
        lines.append(f"{told.rstrip('.')}.")
    return tuple(lines) or ("These recordings excite every effect that was tried.",)


def _next(result: Diagnosis) -> tuple[str, ...]:
    proposal = result.next_experiment
    if proposal is None:
        if any(e.indistinguishable_from for e in result.effects):
            return ("No command of the catalogue separates the rivals.",)
        if result.verdict == "unexplained":
            return (
                "No rivals are left to separate: what is missing is not among the effects that "
                "were tried. The residual figures show where to look.",
            )
        return ("None is needed: no rivals are left to separate.",)
    one, other = (readable(name) for name in proposal.rivals)
    text = proposal.description or proposal.name
    return (
        f"{capital(text).rstrip('.')}.",
        f"It separates {one} from {other} by a chi-square of {number(proposal.separation)} in one "
        f"second; all present recordings give {number(proposal.separation_now)}.",
    )
