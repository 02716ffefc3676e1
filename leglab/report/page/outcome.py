"""Sentences about the damage by a change and its recovery, for terminals, lists and pages."""

from leglab.report.page.wording import number
from leglab.runs.clock import TWIN
from leglab.runs.record import AdaptationMetrics

# An undone share of the damage below _LEAST counts as nothing, a share of at least _MOST as all.
_LEAST, _MOST = 0.05, 0.995
NOTHING = "nothing"


def outcome(found: AdaptationMetrics, unit: str) -> str:
    """Returns the adaptation metrics in one line, errors in `unit`, or why they are missing."""
    if found.recovered is None or found.damage_rad is None:
        return found.reason or ""
    damage = f"damage {milli(found.damage_rad, unit)} ({found.damage_of})"
    return f"{damage}; {share(found)} undone in the last {found.span_s:g} s; {t90(found)}"


def sentence(found: AdaptationMetrics, unit: str) -> str:
    """Returns the adaptation metrics as a sentence, or why they are missing."""
    if found.recovered is None or found.damage_rad is None:
        return f"What was undone cannot be told: {(found.reason or 'no reason').rstrip('.')}."
    if found.damage_of == TWIN:
        text = (
            "With adaptation stopped just before it, the change would raise the error by "
            f"{milli(found.damage_rad, unit)}"
        )
    else:
        text = f"The change raises the error by {milli(found.damage_rad, unit)} in the worst stride"
    undone = f"{share(found)} of that is undone in the last {found.span_s:g} s"
    if found.recovered < _LEAST:
        return f"{text}; {undone}."
    if found.t90_s is None:
        soon = "90 % never, within the run"
    elif found.t90_s == 0.0:
        soon = "and no stride lost more than a tenth of it"
    else:
        soon = f"90 % of it {found.t90_s:.2f} s after the change"
    return f"{text}; {undone}, {soon}."


def milli(value: float, unit: str) -> str:
    """Formats an error [rad or m], times 1000, with `unit`: "mrad", "mm" or "mrad or mm"."""
    return f"{number(1e3 * value)} {unit}"


def share(found: AdaptationMetrics) -> str:
    """Returns the share of the damage undone in the last strides: "95 %", "all" or "nothing"."""
    assert found.recovered is not None
    if found.recovered >= _MOST:
        return "all"
    return NOTHING if found.recovered < _LEAST else f"{100 * found.recovered:.0f} %"


def t90(found: AdaptationMetrics) -> str:
    """Returns a phrase on the time from the change until 90 % of the damage were undone."""
    if found.t90_s is None:
        return "90 % never undone"
    if found.t90_s == 0.0:
        return "no stride lost more than a tenth"
    return f"90 % undone after {found.t90_s:.2f} s"
