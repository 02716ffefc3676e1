"""Checks shared by the settings and the front-end; each raises `LeglabError` in one line."""

import math
from collections.abc import Iterable, Sequence

from leglab.base.errors import LeglabError, unknown_name


def number(
    where: str,
    value: float,
    *,
    above: float = -math.inf,
    least: float = -math.inf,
    most: float = math.inf,
) -> None:
    """Requires a finite number with above < value, least <= value <= most."""
    if not isinstance(value, (int, float)) or not math.isfinite(value):
        raise LeglabError(f"{where} is {value!r}: must be a finite number")
    if value <= above:
        raise LeglabError(f"{where} is {value!r}: must be above {above:g}")
    if not least <= value <= most:
        raise LeglabError(f"{where} is {value!r}: must lie in [{least:g}, {most:g}]")


def whole(where: str, value: int, *, least: int, most: int = 2**31 - 1) -> None:
    """Requires an integer in [least, most]."""
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise LeglabError(f"{where} is {value!r}: must be an integer in [{least}, {most}]")


def choice(where: str, value: object, known: Iterable[str]) -> None:
    """Requires one of the known names."""
    known = tuple(known)
    if value not in known:
        raise unknown_name(where, value, known)


def interval(where: str, value: Sequence[float]) -> None:
    """Requires a pair (lower, upper) of finite numbers with lower < upper."""
    if len(value) != 2:
        raise LeglabError(f"{where} is {value!r}: must be a pair (lower, upper)")
    number(f"{where} lower end", value[0])
    number(f"{where} upper end", value[1], above=value[0])
