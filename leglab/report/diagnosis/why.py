"""Explanations of why an effect is reported or not, from the record of the search."""

from collections.abc import Collection, Sequence

from leglab.diagnosis.result import Certainty, Diagnosis, Rank, Tried
from leglab.report.diagnosis.words import confidence, percent
from leglab.report.page.wording import number, readable


def why(result: Diagnosis, name: str, effects: Collection[str] = ()) -> tuple[str, ...]:
    """Returns lines of text on an effect, for each element at which the search considered it.

    Args:
        result: The diagnosis.
        name: Name of the effect.
        effects: Effects to which the user confined the search; empty if not confined.
    """
    ranks = [one for one in result.ranking if one.name == name]
    if not ranks:
        out = effects and name not in effects
        reason = "--effect leaves it out" if out else "this machine has no place for it"
        return (f"{readable(name)} was not considered: {reason}",)
    return tuple(line for one in ranks for line in _of(result, one))


def _of(result: Diagnosis, one: Rank) -> list[str]:
    """Returns lines of text on an effect at one element."""
    own, first = (one.name, one.element), result.ranking[0]
    lines = [f"{readable(one.name)} at {one.element}"]
    for hidden in result.not_testable:
        if (hidden.name, hidden.element) == own:
            lines.append(f"  these recordings hardly show it: {hidden.reason}")
    alone = f"  alone, at first order and with the final model error: {number(one.gain)} nats"
    most = f"; the largest is {number(first.gain)}, {_set([(first.name, first.element)])}"
    lines.append(f"{alone} over no effect" + most * (first.gain > one.gain))
    fitted = [t for t in result.tried if own in t.names]
    lines += [f"  fitted: {_fitted(t)}" for t in fitted]
    lines += [_judged(j) for j in result.judged if (j.name, j.element) == own]
    best = min(result.tried, key=lambda t: t.behind)
    if best in fitted:
        return [*lines, *_verdict(result, one)]
    if one.added is not None:
        ahead = f"{number(abs(one.added))} nats {'more' if one.added > 0.0 else 'less'}"
        lines.append(f"  added to good sets: at best {ahead} than the most probable set, predicted")
    elif not fitted:
        lines.append("  added to good sets: it is not among the effects that gain most")
    return [*lines, f"  most probable: {_fitted(best)}"]


def _verdict(result: Diagnosis, one: Rank) -> list[str]:
    """Returns the verdict on an effect that belongs to the most probable set of effects."""
    for effect, _ in result.all_effects:
        if effect.element == one.element and effect.name == one.name:
            return [f"  reported with a confidence of {confidence(result, effect)}"]
    return ["  in the most probable set, but below the confidence that a name needs"]


def _judged(one: Certainty) -> str:
    """Describes the confidence of an effect of the fitted sets: three probabilities and factors."""
    line = (
        f"  confidence {percent(one.confidence)}: the smallest of {percent(one.evidence)} by the "
        f"evidence of its sets, {percent(one.parts)} without the least favourable part of the "
        f"recordings and sets at a bound, {percent(one.drive)} in units of the drive; times "
        f"{percent(one.inside)}, as it explains {percent(one.explained)} of the errors"
    )
    if one.differs < 1.0:
        line += f"; times {percent(one.differs)} that directions differ"
    if one.ties:
        line += f"; divided by {one.ties + 1}; other sets that fit as well: {one.ties}"
    return line


def _fitted(one: Tried) -> str:
    """Describes a fitted set of effects: why it was fitted, its error and its evidence."""
    behind = f", {number(one.behind)} nats behind the most probable set" * (one.behind > 0.0)
    return f"{_set(one.names)} ({one.reason}): {number(one.level)} noise levels{behind}"


def _set(names: Sequence[tuple[str, str]]) -> str:
    return " + ".join(f"{readable(name)} at {element}" for name, element in names) or "no effect"


def tried_rows(result: Diagnosis) -> list[list[str]]:
    """Returns table rows of fitted sets of effects: set, reason, noise levels, nats behind best."""
    rows = sorted(result.tried, key=lambda t: t.behind)
    return [[_set(t.names), t.reason, number(t.level), number(t.behind)] for t in rows]
