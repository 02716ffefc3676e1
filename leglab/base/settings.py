"""Settings given by users: named, typed, checked, and refused with one line."""

from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from leglab.base.errors import LeglabError, unknown_name


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
