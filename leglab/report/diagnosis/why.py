"""Why an effect is named or not: what it promised, where it was fitted, what is more probable."""

from collections.abc import Collection, Sequence

from leglab.diagnosis.result import Diagnosis, Rank, Tried
from leglab.report.diagnosis.words import confidence
from leglab.report.page.wording import number, readable


def why(result: Diagnosis, name: str, effects: Collection[str] = ()) -> tuple[str, ...]:
    """Lines on an effect, by its name, for every element where it was looked for.

    `effects` are those to which the user has confined the search; none for all.
    """
    ranks = [one for one in result.ranking if one.name == name]
    if not ranks:
        out = effects and name not in effects
        reason = "--effect leaves it out" if out else "this machine has no place for it"
        return (f"{readable(name)} was not looked for: {reason}",)
    return tuple(line for one in ranks for line in _of(result, one))


def _of(result: Diagnosis, one: Rank) -> list[str]:
    """Lines on an effect at one element."""
    own, first = (one.name, one.element), result.ranking[0]
    lines = [f"{readable(one.name)} at {one.element}"]
    for hidden in result.not_testable:
        if (hidden.name, hidden.element) == own:
            lines.append(f"  these recordings hardly show it: {hidden.reason}")
    alone = f"  alone it promises {number(one.gain)} nats at first order"
    most = f", the most of all is {number(first.gain)} by {_set([(first.name, first.element)])}"
    lines.append(alone + most * (first.gain > one.gain))
    fitted = [t for t in result.tried if own in t.names]
    lines += [f"  fitted: {_fitted(t)}" for t in fitted]
    best = min(result.tried, key=lambda t: t.behind, default=None)
    if best is None:
        return [*lines, "  the model as it is leaves noise alone: no set of effects was fitted"]
    if best in fitted:
        return [*lines, *_verdict(result, one)]
    if one.beside is not None:
        ahead = f"{number(abs(one.beside))} nats {'more' if one.beside > 0.0 else 'less'}"
        lines.append(f"  beside good sets: at best {ahead} probable than the most probable set")
    elif not fitted:
        lines.append("  beside good sets: it is not among the additions that gain most")
    return [*lines, f"  more probable: {_fitted(best)}"]


def _verdict(result: Diagnosis, one: Rank) -> list[str]:
    """What is told of a member of the most probable set."""
    for effect, _ in result.all_effects:
        if effect.element == one.element and effect.name == one.name:
            return [f"  told, with a confidence of {confidence(result, effect)}"]
    return ["  in the most probable set, but not sure enough to be told"]


def _fitted(one: Tried) -> str:
    """A fitted set, why it was fitted and what it came to."""
    behind = f"{number(one.behind)} nats behind the most probable set"
    if one.behind == 0.0:
        behind = "the most probable set"
    return f"{_set(one.names)} ({one.reason}): {number(one.level)} noise levels, {behind}"


def _set(names: Sequence[tuple[str, str]]) -> str:
    return " + ".join(f"{readable(name)} at {element}" for name, element in names) or "no effect"


def tried_rows(result: Diagnosis) -> list[list[str]]:
    """Sets that were fitted, most probable first: the set, why, noise levels, nats behind."""
    rows = sorted(result.tried, key=lambda t: t.behind)
    return [[_set(t.names), t.reason, number(t.level), number(t.behind)] for t in rows]
