"""Validation and documentation of users' settings; an invalid one is reported in one line."""

import inspect
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.fields import FieldInfo

from leglab.base.errors import SettingsError

# An attribute with its description in a docstring; a unit in brackets, but no range like [-1, 1].
_SETTING = re.compile(r"^    (\w+): (.*(?:\n     .*)*)", re.MULTILINE)
_UNIT = re.compile(r"\[([^\],]+)\]")


class Configuration(BaseModel):
    """Base of every configuration: immutable, without unknown keys, NaN or infinity."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


Model = TypeVar("Model", bound=Configuration)


def first_problem(error: ValidationError) -> tuple[str, str]:
    """Returns location ("" for the whole model) and reason of the first validation problem."""
    problem = _first(error)
    reason = problem["msg"].removeprefix("Value error, ")
    return ".".join(str(part) for part in problem["loc"]), reason[:1].lower() + reason[1:]


def _first(error: ValidationError) -> Any:
    """Returns the problem of an unknown key (often a misspelled missing one), or the first one."""
    problems = error.errors(include_url=False)
    unknown = (one for one in problems if one["type"] == "extra_forbidden")
    return next(unknown, problems[0])


def validate_configuration(
    model: type[Model], values: Mapping[str, Any] | None, owner: str
) -> Model:
    """Checks settings against their model.

    Args:
        model: The configuration class.
        values: Settings by name; None for all defaults.
        owner: Owner of the settings in error messages, for instance "controller 'pd'".

    Returns:
        The validated configuration.

    Raises:
        SettingsError: A key is unknown or missing, or a value is not allowed; the message is one
            line with the key, the value and the allowed values.
    """
    try:
        return model.model_validate(dict(values or {}))
    except ValidationError as error:
        problem = _first(error)
        key, reason = first_problem(error)
    if problem["type"] == "extra_forbidden":
        if not model.model_fields:
            raise SettingsError(f"{owner} has no settings, but {key!r} was given", given=key)
        raise SettingsError.unknown(f"setting of {owner}", key, model.model_fields)
    if problem["type"] == "missing":
        raise SettingsError(f"{owner} needs the setting {key!r}", allowed=(key,))
    where = f"{owner}: setting {key!r} is {problem['input']!r}: " if key else f"{owner}: "
    if "than" in problem["type"]:  # a bound
        reason = f"{reason} {documented_units(model).get(key, '')}".rstrip()
    raise SettingsError(where, given=problem["input"], allowed=reason)


@dataclass(frozen=True, kw_only=True)
class Setting:
    """Description of a setting in listings."""

    name: str  #: Name for `--set SECTION.NAME`; PART.NAME in a nested configuration
    default: str  #: Default as text; "required" if there is none
    allowed: str  #: Bounds or choices; "" if only the type is restricted
    unit: str  #: Unit; "" if there is none
    meaning: str  #: Description from the docstring of its class


def documented_settings(model: type[Configuration]) -> tuple[Setting, ...]:
    """Returns all settings of a configuration, including those of nested configurations."""
    units, meanings = documented_units(model), _meanings(model)
    found: list[Setting] = []
    for name, field in model.model_fields.items():
        kind = field.annotation
        if inspect.isclass(kind) and issubclass(kind, Configuration):
            found += (replace(s, name=f"{name}.{s.name}") for s in documented_settings(kind))
            continue
        default = field.get_default(call_default_factory=True, validated_data={})
        found.append(
            Setting(
                name=name,
                default="required" if field.is_required() else _shown(default),
                allowed=_allowed(field),
                unit=units.get(name, ""),
                meaning=meanings.get(name) or field.description or "",
            )
        )
    return tuple(found)


def documented_units(owner: type) -> dict[str, str]:
    """Returns the units of settings, parsed from the brackets in the docstring of their class.

    Args:
        owner: A class that documents "Attributes:" in its docstring or those of its bases.

    Returns:
        Units by name of the setting; settings without a unit are left out.
    """
    found: dict[str, str] = {}
    for name, meaning in _meanings(owner).items():
        units = [unit for unit in _UNIT.findall(meaning) if unit != "1"]
        if units:
            found[name] = units[-1]
    return found


def _meanings(owner: type) -> dict[str, str]:
    """Returns each attribute's description, on one line, from docstrings of class and bases."""
    found: dict[str, str] = {}
    for base in reversed(owner.__mro__):
        if not base.__module__.startswith("pydantic"):
            _, _, text = inspect.cleandoc(base.__doc__ or "").partition("Attributes:\n")
            found |= {name: " ".join(told.split()) for name, told in _SETTING.findall(text)}
    return found


def _allowed(field: FieldInfo) -> str:
    """Returns the bounds of a setting, or its allowed words, as text."""
    if get_origin(field.annotation) is Literal:
        return ", ".join(map(str, get_args(field.annotation)))
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    rules = [(signs[name], rule, name) for rule in field.metadata for name in signs]
    return ", ".join(f"{s} {getattr(r, n):g}" for s, r, n in rules if hasattr(r, n))


def _shown(value: Any) -> str:
    """Returns a default value in the syntax of `--set`."""
    if value is None:
        return "-"
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(map(_shown, value))}]"
    return str(value).lower() if isinstance(value, bool) else f"{value}"
