"""A diagnosis in words: what a reader learns in one minute, before any number or figure.

All texts are plain: whoever puts them into a page escapes them.
"""

import math
from collections.abc import Sequence

import numpy as np

from leglab.diagnosis.result import Diagnosis, Estimate, shown_unit
from leglab.report.page.shell import Section
from leglab.report.page.wording import capital, listed, number, readable

# Below this share of the gap, "closed" would mislead.
_HARDLY = 0.05
# More channels than this make no sentence.
_CHANNELS = 6


def percent(share: float) -> str:
    """A confidence; resampling never gives certainty, so nothing above 99 % is told apart."""
    if not math.isfinite(share):
        return "unknown"
    return "over 99 %" if share > 0.99 else f"{100.0 * share:.0f} %"


def rms(arrays: Sequence[np.ndarray]) -> float:
    """Root mean square of all finite values; NaN where there is none."""
    values = np.concatenate([np.ravel(a) for a in arrays])
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(values**2))) if values.size else math.nan


def headline(result: Diagnosis) -> str:
    """The verdict in one sentence."""
    found = listed(tuple(f"{readable(e.name)} at {e.element}" for e in result.effects))
    if result.verdict == "named":
        return f"The simulation is missing: {found}."
    if result.verdict == "confusion_set":
        sets = []
        for effect in result.effects:
            names = (effect.name, *effect.indistinguishable_from)
            sets.append(f"{listed(tuple(map(readable, names)), 'or')} at {effect.element}")
        told = "; and ".join(sets)
        return f"Something is missing that these recordings do not pin down: {told}."
    if result.verdict == "partial":
        return f"The simulation is missing {found}, and more that has no name yet."
    if result.verdict == "unexplained":
        ending = f"; {found} explains less than half of it" if found else ""
        return f"Simulation and recordings disagree, and no known effect explains it{ending}."
    return "Nothing is missing that these recordings could show."


def sections(result: Diagnosis, model: str) -> tuple[Section, ...]:
    """Questions a reader has about the diagnosis of a model, in the order in which they ask."""
    return (
        Section(title="What was looked at", lines=_looked_at(result, model)),
        Section(title="What is missing", lines=_missing(result)),
        Section(title="How sure", lines=_sure(result)),
        Section(title="What it costs", lines=_costs(result)),
        Section(title="Where", lines=_where(result)),
        Section(title="What cannot be told", lines=_untold(result)),
        Section(title="Next experiment", lines=_next(result)),
    )


def parameter_words(p: Estimate) -> tuple[str, str, str]:
    """Value, 95 % interval and what the model has, each with the unit.

    As many digits as the interval allows, so that its ends do not read alike.
    """
    unit = "" if p.unit in ("", "1") else f" {p.unit}"
    low, high = p.interval
    half, size = (high - low) / 2.0, max(abs(low), abs(high))
    digits = 3
    if 0.0 < half < size and math.isfinite(size):
        digits = min(max(math.ceil(math.log10(size / half)) + 1, 3), 6)
    ends = f"{number(low, digits)} to {number(high, digits)}"
    return f"{number(p.value, digits)}{unit}", f"{ends}{unit}", f"{number(p.nominal)}{unit}"


def _looked_at(result: Diagnosis, model: str) -> tuple[str, ...]:
    held = tuple(r.name for r in result.recordings if r.held_out)
    fitted = tuple(r.name for r in result.recordings if not r.held_out)
    count = len(result.recordings)
    lines = [f"Model {model}, {count} recording{'s' * (count != 1)}: {listed(fitted + held)}."]
    if held:
        lines.append(f"{listed(held)} was kept from all fits; the verdict is judged on it.")
    else:
        lines.append("No recording was kept apart: the verdict is judged on the data of the fit.")
    tried = len({(rank.name, rank.element) for rank in result.ranking})
    lines.append(
        f"{tried} possible effects tried, {result.rollouts:.0f} replays of all windows, "
        f"{result.seconds:.0f} s."
    )
    return tuple(lines)


def _missing(result: Diagnosis) -> tuple[str, ...]:
    if not result.effects:
        return ("No effect stands out from what chance gives.",)
    lines = []
    for effect in result.effects:
        told = []
        for p in effect.parameters:
            value, interval, nominal = parameter_words(p)
            told.append(f"{readable(p.name)} {value} (95 %: {interval}), in the model {nominal}")
        physics = f"{effect.physics.rstrip('.')}." if effect.physics else ""
        text = f"{capital(readable(effect.name))} at {effect.element}. {physics}"
        lines.append(f"{text} Fitted: {'; '.join(told)}." if told else text)
        if effect.onset:
            times = listed(tuple(f"{time:.2f} s of {name}" for name, time in effect.onset))
            lines.append(f"{capital(readable(effect.name))} begins at {times}.")
    return tuple(lines)


def _sure(result: Diagnosis) -> tuple[str, ...]:
    lines = []
    for effect in result.effects:
        name = capital(readable(effect.name))
        lines.append(
            f"{name}: confidence {percent(effect.confidence)}; added last, it closes "
            f"{percent(effect.contribution)} of what is open without it."
        )
        if effect.indistinguishable_from:
            others = listed(tuple(readable(n) for n in effect.indistinguishable_from), "or")
            lines.append(f"{name} is not told apart from {others}.")
    if not lines:
        return ("No effect is named, so there is no confidence to state.",)
    return (
        *lines,
        "Confidence is the share of resampled data that prefers the name to every rival, "
        "times the quality of the fit.",
    )


def _costs(result: Diagnosis) -> tuple[str, ...]:
    gap = result.gap
    place = f"On {listed(gap.held_out)}" if gap.held_out else "On the recordings of the fit"
    text = (
        f"{place} the simulation is off by {number(gap.before)} noise levels; recalibrated within "
        f"tolerance, by {number(gap.baseline)}"
    )
    text += f"; with what was found, by {number(gap.after)}." if result.effects else "."
    lines = [text, f"Noise of the sensors alone gives {number(gap.noise_floor)}."]
    closed = gap.closed_fraction
    if result.effects and closed is not None and math.isfinite(closed):
        share = f"{100.0 * closed:.0f} % of the gap is closed."
        lines.append(
            share if closed > _HARDLY else f"The gap hardly closes: {100.0 * closed:.0f} %."
        )
    return (*lines, *_in_units(result))


def _in_units(result: Diagnosis) -> tuple[str, ...]:
    """Replay errors of the measured channels in units that a person knows."""
    held = set(result.gap.held_out) or {r.name for r in result.recordings}
    told = []
    for channel in list(dict.fromkeys(t.channel for t in result.traces))[:_CHANNELS]:
        mine = [t for t in result.traces if t.channel == channel and t.recording in held]
        if not mine:
            continue
        factor, unit = shown_unit(mine[0].unit)
        text = f"{readable(channel)} {number(factor * rms([t.before for t in mine]))} {unit}"
        if result.effects:
            text += f", then {number(factor * rms([t.after for t in mine]))} {unit}"
        told.append(text)
    return (f"RMS error of the replays: {'; '.join(told)}.",) if told else ()


def _where(result: Diagnosis) -> tuple[str, ...]:
    if not result.where:
        return ("No balance of torque and oil was possible: it needs chamber pressures.",)
    lines = [
        f"{capital(w.residual)} balance of {w.element}: {number(w.level)} noise levels"
        + (f", worst at {w.region}." if " in [" in w.region else f", {w.region or 'anywhere'}.")
        for w in result.where
    ]
    lines.append("These are balances of the model as it was, along the measured motion.")
    if result.ceiling is not None and math.isfinite(result.ceiling):
        lines.append(
            f"Static functions of position, velocity, pressure and command could explain "
            f"{100.0 * result.ceiling:.0f} % of the worst one at most; the rest has memory."
        )
    return tuple(lines)


def _untold(result: Diagnosis) -> tuple[str, ...]:
    lines = [
        f"{capital(readable(entry.name))} at {entry.element}: {entry.reason.rstrip('.')}."
        for entry in result.not_testable
    ]
    lines += [f"{capital(note).rstrip('.')}." for note in result.notes]
    return tuple(lines) or ("These recordings excite every effect that was tried.",)


def _next(result: Diagnosis) -> tuple[str, ...]:
    proposal = result.next_experiment
    if proposal is None:
        if any(e.indistinguishable_from for e in result.effects):
            return ("No command of the catalogue separates the rivals.",)
        if result.verdict in ("unexplained", "partial"):
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
