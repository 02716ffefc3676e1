"""Settings given by users: named, typed, checked, and refused with one line."""

import inspect
import re
from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from leglab.base.errors import LeglabError, unknown_name

# A setting and its meaning, up to the next one; a unit, but for ranges such as [-1, 1].
_SETTING = re.compile(r"^    (\w+): (.*(?:\n     .*)*)", re.MULTILINE)
_UNIT = re.compile(r"\[([^\],]+)\]")


class Configuration(BaseModel):
    """Base of every configuration: immutable, without unknown keys, NaN or infinity."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


Model = TypeVar("Model", bound=Configuration)


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
    key = ".".join(str(part) for part in problem["loc"])
    if problem["type"] == "extra_forbidden":
        if not model.model_fields:
            raise LeglabError(f"{owner} has no settings, but {key!r} was given")
        raise unknown_name(f"setting of {owner}", key, model.model_fields)
    if problem["type"] == "missing":
        raise LeglabError(f"{owner} needs the setting {key!r}")
    message = problem["msg"].removeprefix("Value error, ")
    message = message[:1].lower() + message[1:]
    if not key:
        raise LeglabError(f"{owner}: {message}")
    raise LeglabError(f"{owner}: setting {key!r} is {problem['input']!r}: {message}")


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
