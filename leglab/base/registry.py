"""Registries: scenarios, controllers, references and effects by name."""

import importlib
import os
import pkgutil
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from leglab.base import plugins
from leglab.base.errors import SettingsError
from leglab.base.settings import Configuration, validate_configuration

Entry = TypeVar("Entry")


class Registry(Generic[Entry]):
    """Named entries of one kind; modules that define entries are imported at the first look-up.

    Lazy loading keeps `import leglab` fast, and lets a module of the registry's package run as a
    script without being imported first.
    """

    def __init__(self, kind: str) -> None:
        """Starts an empty registry.

        Args:
            kind: Kind of the entries for error messages, for instance "scenario".
        """
        self.kind = kind
        self._entries: dict[str, Entry] = {}
        self._definitions: dict[str, tuple[str, str]] = {}
        self._loaders: list[Callable[[], None]] = []
        self._with_plugins = f"{kind}s" in plugins.KINDS
        self._register: Callable[[str, Any], None] | None = None

    def add(self, name: str, entry: Entry, defined_by: Callable | Path) -> None:
        """Adds an entry.

        Args:
            name: Name of the entry.
            entry: Object that `get` returns.
            defined_by: Function, class or file that defines it. The same definition may be added
                twice, since a module that runs as a script is also imported under its own name.

        Raises:
            SettingsError: Another definition already has this name.
        """
        if isinstance(defined_by, Path):
            definition = str(defined_by.resolve()), ""
        else:
            definition = _definition_of(defined_by)
            plugins.note(defined_by.__module__)
        taken = self._definitions.get(name)
        if taken not in (None, definition):
            raise SettingsError(
                f"{self.kind} {name!r} is defined twice: in {taken[0]} and in {definition[0]}",
                given=name,
            )
        self._definitions[name] = definition
        self._entries[name] = entry

    def add_loader(self, load: Callable[[], None]) -> None:
        """Adds a function that imports modules with entries; it runs once, at the first look-up."""
        self._loaders.append(load)

    def add_plugins(self, register: Callable[[str, Any], None]) -> None:
        """Sets the function that registers a plug-in's object under its entry point's name."""
        self._register = register

    def get(self, name: str) -> Entry:
        """Returns the entry of this name.

        Raises:
            SettingsError: The name is unknown; the message lists known names and failed plug-ins.
        """
        self._load()
        if name not in self._entries:
            error = SettingsError.unknown(self.kind, name, self._entries)
            told = "; ".join((str(error), *plugins.failures(f"{self.kind}s")))
            raise SettingsError(told, given=name, allowed=error.allowed)
        return self._entries[name]

    def names(self) -> tuple[str, ...]:
        """Returns all names in alphabetical order."""
        self._load()
        return tuple(sorted(self._entries))

    def _load(self) -> None:
        while self._loaders:
            self._loaders.pop()()
        if self._with_plugins:
            self._with_plugins = False  # a plug-in may look names up while it is loaded
            plugins.load_entry_points(
                f"{self.kind}s", lambda name: name in self._entries, self._register
            )


@dataclass(frozen=True, kw_only=True)
class Configured(Generic[Entry]):
    """A factory with its settings class."""

    factory: Entry  #: Function or class that makes the object
    summary: str  #: One line for listings
    configuration: type[Configuration]  #: Class of the factory's settings


class FactoryRegistry(Registry[Configured[Entry]]):
    """Registry of factories, each with a summary and the class of its settings."""

    def register(
        self, name: str, *, summary: str, configuration: type[Configuration]
    ) -> Callable[[Entry], Entry]:
        """Registers the decorated factory under a name.

        Args:
            name: Name by which users select it.
            summary: One line for listings.
            configuration: Class of its settings.
        """
        if not (isinstance(configuration, type) and issubclass(configuration, Configuration)):
            given = getattr(configuration, "__qualname__", repr(configuration))
            raise SettingsError(
                f"{self.kind} {name!r}: configuration is {given}; allowed: ",
                given=given,
                allowed="a subclass of leglab.Configuration, which refuses unknown settings",
            )

        def add(factory: Entry) -> Entry:
            entry = Configured(factory=factory, summary=summary, configuration=configuration)
            assert callable(factory)
            self.add(name, entry, factory)
            return factory

        return add

    def configured(
        self, name: str, config: Mapping[str, Any] | None, **defaults: Any
    ) -> tuple[Entry, Any]:
        """Returns a factory and its validated settings.

        Args:
            name: Name of the entry.
            config: Its settings; a setting that is left out has its default.
            **defaults: Values of settings not in `config`; those unknown to the class are ignored.

        Raises:
            SettingsError: The name or a setting is unknown, or a value is not allowed.
        """
        entry = self.get(name)
        known = {k: v for k, v in defaults.items() if k in entry.configuration.model_fields}
        settings = {**known, **(config or {})}
        owner = f"{self.kind} {name!r}"
        return entry.factory, validate_configuration(entry.configuration, settings, owner)


def import_modules(package: str, path: Iterable[str]) -> None:
    """Imports every public module of a package, so that each registers its definitions.

    Args:
        package: Name of the package.
        path: The `__path__` of the package.
    """
    for module in sorted(pkgutil.iter_modules(path), key=lambda module: module.name):
        if not module.name.startswith("_"):
            importlib.import_module(f"{package}.{module.name}")


def _definition_of(function: Callable) -> tuple[str, str]:
    """Returns the real path of the file and the qualified name that define a function or class."""
    module = sys.modules.get(function.__module__)
    path = getattr(module, "__file__", None) or function.__module__
    return os.path.realpath(path), function.__qualname__
