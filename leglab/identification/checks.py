"""Checks shared by the settings and the front-end; each raises `SettingsError` in one line."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any, ClassVar, Literal, get_args, get_origin

from leglab.base.errors import SettingsError


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Base of all settings: checks literal types, and fields made by `a_number` or `a_whole`."""

    owner: ClassVar[str] = ""  # stands before a field's name in messages

    def __post_init__(self) -> None:
        for part in fields(self):
            where, value = f"{self.owner} {part.name}".lstrip(), getattr(self, part.name)
            if get_origin(part.type) is Literal:
                if value not in get_args(part.type):
                    raise SettingsError.unknown(where, value, get_args(part.type))
            elif "check" in part.metadata:
                part.metadata["check"](where, value)


def a_number(default: float, **limits: Any) -> Any:
    """Returns a field of a `Settings` that `number` checks."""
    return field(default=default, metadata={"check": partial(number, **limits)})


def a_whole(default: int, **limits: Any) -> Any:
    """Returns a field of a `Settings` that `whole` checks."""
    return field(default=default, metadata={"check": partial(whole, **limits)})


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
        raise _wrong(where, value, "a finite number")
    if value <= above:
        raise _wrong(where, value, f"above {above:g}")
    if not least <= value <= most:
        raise _wrong(where, value, f"[{least:g}, {most:g}]", "lie in")


def _wrong(where: str, value: object, allowed: str, verb: str = "be") -> SettingsError:
    return SettingsError(f"{where} is {value!r}: must {verb} ", given=value, allowed=allowed)


def whole(where: str, value: int, *, least: int, most: int = 2**31 - 1) -> None:
    """Requires an integer in [least, most]."""
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise _wrong(where, value, f"an integer in [{least}, {most}]")


def interval(where: str, value: Sequence[float]) -> None:
    """Requires a pair (lower, upper) of finite numbers with lower < upper."""
    if len(value) != 2:
        raise _wrong(where, value, "a pair (lower, upper)")
    number(f"{where} lower end", value[0])
    number(f"{where} upper end", value[1], above=value[0])
