"""Settings given by users: named, typed, checked, and refused with one line."""

import inspect
import re
from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from leglab.base.errors import SettingsError

# A setting and its meaning, up to the next one; a unit, but for ranges such as [-1, 1].
_SETTING = re.compile(r"^    (\w+): (.*(?:\n     .*)*)", re.MULTILINE)
_UNIT = re.compile(r"\[([^\],]+)\]")


class Configuration(BaseModel):
    """Base of every configuration: immutable, without unknown keys, NaN or infinity."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


Model = TypeVar("Model", bound=Configuration)


def first_problem(error: ValidationError) -> tuple[str, str]:
    """Returns where a validation found its first problem, "" for the whole, and the reason."""
    problem = error.errors(include_url=False, include_input=False)[0]
    reason = problem["msg"].removeprefix("Value error, ")
    return ".".join(str(part) for part in problem["loc"]), reason[:1].lower() + reason[1:]


def validate_configuration(
    model: type[Model], values: Mapping[str, Any] | None, owner: str
) -> Model:
    """Checks settings against their model.

    Args:
        model: The configuration class.
        values: Settings by name; None stands for none, so that all defaults hold.
        owner: Whose settings they are, for messages, for instance "controller 'pd'".

    Returns:
        The validated configuration.

    Raises:
        LeglabError: A key is unknown or missing, or a value is not allowed; one line names the
            key, the value and what is allowed.
    """
    try:
        return model.model_validate(dict(values or {}))
    except ValidationError as error:
        problem = error.errors(include_url=False)[0]
        key, reason = first_problem(error)
    if problem["type"] == "extra_forbidden":
        if not model.model_fields:
            raise SettingsError(f"{owner} has no settings, but {key!r} was given", given=key)
        raise SettingsError.unknown(f"setting of {owner}", key, model.model_fields)
    if problem["type"] == "missing":
        raise SettingsError(f"{owner} needs the setting {key!r}", allowed=(key,))
    where = f"{owner}: setting {key!r} is {problem['input']!r}: " if key else f"{owner}: "
    raise SettingsError(where, given=problem["input"], allowed=reason)


def documented_units(owner: type) -> dict[str, str]:
    """Returns the units of settings, which stand in brackets in the docs of their class.

    Args:
        owner: A class whose docstring, or those of its bases, has "Attributes:".

    Returns:
        Units by name of the setting, without those that have none.
    """
    found: dict[str, str] = {}
    for base in reversed(owner.__mro__):
        if base.__module__.startswith("pydantic"):
            continue
        _, _, text = inspect.cleandoc(base.__doc__ or "").partition("Attributes:\n")
        for name, meaning in _SETTING.findall(text):
            units = [unit for unit in _UNIT.findall(meaning) if unit != "1"]
            if units:
                found[name] = units[-1]
    return found
