"""Reading of run settings from TOML files, the `run.json` of a run, and `--set` options."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any, get_type_hints

from pydantic import TypeAdapter, ValidationError

from leglab.base.errors import SettingsError
from leglab.base.input import parse_toml, read_bytes
from leglab.base.settings import first_problem
from leglab.control.contract import CONTROLLERS
from leglab.references.base import REFERENCES
from leglab.references.from_file import NAME as FILE
from leglab.references.from_file import is_file
from leglab.runs.folder import model_of
from leglab.runs.preparation import RunSettings
from leglab.runs.record import RunConfiguration, read

SUFFIXES = (".toml", ".json")
# Sections of `--set` and of a TOML file, and the fields of `RunSettings` that they map to.
SECTIONS = {
    "controller": "controller_config",
    "reference": "reference_config",
    "sensors": "sensors",
}
NAMES = tuple(field.name for field in fields(RunSettings))


def read_settings(path: Path) -> dict[str, Any]:
    """Reads the settings of a run, by the names of `RunSettings`.

    Args:
        path: A TOML file with these names, in which a table `controller` or `reference` may hold
            its `name` and settings; or the `run.json` of a run, with all settings, which selects
            the copy of the model in the run's folder.

    Raises:
        LeglabError: The file cannot be read, or a name or a value is not allowed.
    """
    if path.suffix == ".json":
        run = read(RunConfiguration, path)
        found = {**run.settings, "model": model_of(path.parent, run)}
    else:
        found = _without_tables(read_toml(path), str(path))
    return checked(found, str(path))


def replace_names(values: dict[str, Any], given: Mapping[str, Any]) -> list[str]:
    """Overrides settings of a file by given settings.

    Another controller or reference keeps those settings of the file's that it has as well.

    Args:
        values: Settings of the file; modified in place.
        given: Settings that override those of the same name.

    Returns:
        A warning for each setting in the file that the other controller or reference lacks.

    Raises:
        SettingsError: `given` names an unknown controller or reference.
    """
    lines = []
    for section, registry in (("controller", CONTROLLERS), ("reference", REFERENCES)):
        before, after = values.get(section), given.get(section)
        if after in (None, before):
            continue
        name = FILE if section == "reference" and is_file(after) else str(after)
        known = registry.get(name).configuration.model_fields
        config = values.get(SECTIONS[section], {})
        lines += [
            f"the setting {name!r} of {section} {before!r} is left out, {after!r} has none"
            for name in config
            if name not in known
        ]
        values[SECTIONS[section]] = {name: config[name] for name in config if name in known}
    values.update(given)
    return lines


def read_toml(path: Path) -> dict[str, Any]:
    """Reads a TOML file.

    Raises:
        LeglabError: The file cannot be read, or is not TOML.
    """
    content = read_bytes(path)
    try:
        return parse_toml(content)
    except ValueError as error:
        raise SettingsError(f"{path}: is not TOML: {error}", given=path) from error


def checked(values: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Checks names and types of settings against `RunSettings` and returns them as a dict.

    Raises:
        SettingsError: A setting is unknown, missing or of the wrong type; the message names it.
    """
    for name in values:
        if name not in NAMES:
            raise SettingsError.unknown("setting of a run", name, NAMES).at(where)
    if "scenario" not in values:
        raise SettingsError(f"{where}: needs the setting 'scenario'", allowed=("scenario",))
    for name, value in values.items():
        check_type(name, value, f"{where}: setting {name!r}")
    return dict(values)


def check_type(name: str, value: Any, where: str) -> None:
    """Checks that a value has the type of the field of this name in `RunSettings`.

    Raises:
        SettingsError: The type is wrong; the message names place, value and allowed type.
    """
    try:
        _type(name).validate_python(value, strict=True)
    except ValidationError as error:
        text = f"{where} is {value!r}: "
        raise SettingsError(text, given=value, allowed=first_problem(error)[1]) from None


@cache
def _type(name: str) -> TypeAdapter[Any]:
    return TypeAdapter(get_type_hints(RunSettings)[name])


def with_entries(values: Mapping[str, Any], entries: Sequence[str]) -> dict[str, Any]:
    """Returns settings with single entries changed.

    Args:
        values: Settings by the names of `RunSettings`.
        entries: For example "controller.memory=1500", "sensors.latency=0" or
            "reference.period=1.0"; a value that is not valid TOML is taken as text.

    Raises:
        SettingsError: An entry does not have this form.
    """
    found = {**values, **{name: deepcopy(values.get(name) or {}) for name in SECTIONS.values()}}
    for entry in entries:
        name, equals, text = entry.partition("=")
        section, dot, key = name.strip().partition(".")
        if not (equals and dot and key and section in SECTIONS):
            form = "SECTION.SETTING=VALUE with one of the sections"
            message = f"--set {entry!r}: allowed is {form} "
            raise SettingsError(message, given=entry, allowed=SECTIONS)
        target = found[SECTIONS[section]]
        *tables, last = key.split(".")
        for table in tables:
            target = target.setdefault(table, {})
            if not isinstance(target, dict):
                message = f"--set {entry!r}: {table!r} has a value already"
                raise SettingsError(message, given=entry)
        target[last] = _value(text.strip())
    return found


def _without_tables(content: dict[str, Any], where: str) -> dict[str, Any]:
    """Splits the TOML tables `controller` and `reference` into name and settings."""
    found = dict(content)
    for section in ("controller", "reference"):
        table = found.get(section)
        if not isinstance(table, dict):
            continue
        del found[section]
        own = dict(table)
        if "name" in own:  # A TOML key cannot be both text and table, so the table has the name.
            found[section] = own.pop("name")
        beside = found.get(SECTIONS[section], {})
        if not isinstance(beside, dict):
            text = f"{where}: setting {SECTIONS[section]!r} is {beside!r}; allowed: "
            raise SettingsError(text, given=beside, allowed="a table")
        found[SECTIONS[section]] = {**beside, **own}
    return found


def _value(text: str) -> Any:
    try:
        return parse_toml(f"value = {text}")["value"]
    except ValueError:
        return text
