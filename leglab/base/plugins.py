"""Code of others: entry points of installed packages, and files and modules that a user names.

A package offers what it defines by entry points in the groups `leglab.controllers`,
`leglab.scenarios`, `leglab.references`, `leglab.effects` and `leglab.models`, each called like what
it defines. They are imported when a name of their kind is first looked up. `load` imports a file
or module at once. Processes that work for this one get the same by `carried` and `carry`.
"""

import contextlib
import functools
import hashlib
import importlib
import importlib.metadata
import importlib.util
import sys
import traceback
from collections.abc import Callable, Iterable
from modulefinder import ModuleFinder
from pathlib import Path
from types import ModuleType
from typing import Any, TypedDict

from leglab.base.errors import FileError, LeglabError, SettingsError
from leglab.base.input import no_file

KINDS = ("controllers", "scenarios", "references", "effects", "models")

# What was loaded or has registered something, in this order: absolute paths of files, and modules,
# with whether the user named it.
_sources: dict[str, bool] = {}
# Modules of entry points that were loaded.
_packages: set[str] = set()
# Why an entry point could not be loaded, by kind and name.
_failures: dict[tuple[str, str], str] = {}
# Files on which results depend, with the digest of their content at the first import: later edits
# of a file do not change the code that runs.
_files: dict[Path, bytes] = {}
# Code that is being imported here brings what it registers along by itself.
_importing = 0
_SUFFIXES = (".py", ".xml", ".toml")


class Carried(TypedDict):
    """Plug-ins that a process has to load for the same names: plain types, which JSON can hold."""

    path: list[str]
    packages: list[str]
    sources: dict[str, bool]


@functools.cache
def entry_points(kind: str) -> dict[str, importlib.metadata.EntryPoint]:
    """Entry points of a kind by name, without importing them.

    Args:
        kind: One of `KINDS`.
    """
    found = _all_entry_points().select(group=f"leglab.{kind}")
    return {entry.name: entry for entry in sorted(found, key=lambda entry: entry.name)}


@functools.cache
def _all_entry_points() -> Any:
    """Those of all groups: looking into every installed package takes 20 ms."""
    return importlib.metadata.entry_points()


def load_entry_points(
    kind: str, known: Callable[[str], bool], register: Callable[[str, Any], None] | None = None
) -> None:
    """Imports all entry points of a kind; one that fails is passed over and told by `failures`.

    Args:
        kind: One of `KINDS`.
        known: Whether a name is registered.
        register: Registers what an entry point refers to under its name, unless importing it did.
    """
    for name, entry in entry_points(kind).items():
        owner = "" if entry.dist is None else f" of package {entry.dist.name!r}"
        where = f"plug-in {name!r}{owner} ({entry.value})"
        try:
            with _Importing():
                found = entry.load()
            if register is not None and not known(name):
                register(name, found)
            if not known(name):
                told = f"it registers nothing called {name!r} among the {kind}"
                raise SettingsError(told, given=name)
        except Exception as error:
            _failures[kind, name] = f"{where} cannot be loaded: {_line(error)}"
        else:
            _take_package(entry.module)


def _take_package(name: str) -> None:
    """Notes that results may depend on the code of an imported module and its package."""
    module = sys.modules.get(name)
    if module is not None:
        _packages.add(name)
        _take_files(module)


def failures(kind: str | None = None) -> tuple[str, ...]:
    """Why entry points could not be loaded, a line each; of all kinds without one."""
    return tuple(text for (of, _), text in _failures.items() if kind in (None, of))


def load(source: str) -> None:
    """Imports a Python file or a module, so that what it registers is known.

    Args:
        source: Path of a `.py` file, or name of a module. The folder of a file is added to the end
            of `sys.path`, so that it can import its neighbours.

    Raises:
        LeglabError: There is no such file or module, or importing it fails.
    """
    path = Path(source)
    is_file = path.suffix == ".py" or path.is_file()
    if is_file and not path.is_file():
        raise FileError(f"--load {source}: {no_file(source)}", given=source)
    try:
        with _Importing():
            module = _import_file(path.resolve()) if is_file else importlib.import_module(source)
    except LeglabError as error:
        raise error.at(f"--load {source}") from error
    except Exception as error:
        missing = isinstance(error, ModuleNotFoundError) and error.name == source
        reason = "there is no module of this name, nor a file" if missing else _line(error)
        raise SettingsError(f"--load {source}: {reason}", given=source) from error
    _sources[str(path.resolve()) if is_file else source] = True
    _take_files(module)


def imported(source: str) -> ModuleType:
    """Returns a module by its name, or that of a Python file by its path.

    Raises:
        ImportError: There is none.
    """
    if source.endswith(".py"):
        with _Importing():
            return _import_file(Path(source))
    return importlib.import_module(source)


def note(module_name: str) -> None:
    """Notes that a module has registered something; those of leglab itself go without saying."""
    if _importing or module_name.partition(".")[0] == "leglab":
        return
    module = sys.modules.get(module_name)
    file = getattr(module, "__file__", None)
    if module is None or file is None or not Path(file).is_file():
        return  # a notebook or a prompt: no other process can import it
    # What runs as a script is no module that could be imported.
    _sources.setdefault(
        str(Path(file).resolve()) if module_name == "__main__" else module_name, False
    )
    _take_files(module)


def carried() -> Carried:
    """Returns what another process gives to `carry`."""
    return {"path": list(sys.path), "packages": sorted(_packages), "sources": dict(_sources)}


def carry(luggage: Carried) -> None:
    """Loads what another process has loaded.

    Raises:
        LeglabError: As `load`, of what the user named.
    """
    sys.path.extend(place for place in luggage["path"] if place not in sys.path)
    for name in luggage["packages"]:
        # One that is not here, or fails, shows in the digest of the code.
        with contextlib.suppress(Exception), _Importing():
            importlib.import_module(name)
            _take_package(name)
    for source, named in luggage["sources"].items():
        if source in _sources:
            continue
        try:
            load(source)
        except LeglabError:
            # What merely happened to register something may have nothing to do with the work.
            if named:
                raise


def code_digest() -> str:
    """Returns a digest of all loaded files and of modules that they import from their folder."""
    digest = hashlib.sha256()
    for file in sorted(_files):
        digest.update(_files[file])
    return digest.hexdigest() if _files else ""


class _Importing:
    def __enter__(self) -> None:
        global _importing
        _importing += 1

    def __exit__(self, *_: object) -> None:
        global _importing
        _importing -= 1


def _import_file(path: Path) -> ModuleType:
    """Imports a file under its own name, or under another one where that is taken."""
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    name = path.stem
    present: Any = sys.modules.get(name)
    if present is None and name.isidentifier():
        present = importlib.util.find_spec(name)
    if not _is_file(present, path):
        name = f"leglab_loaded_{hashlib.sha256(str(path).encode()).hexdigest()[:12]}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise FileError("it is no Python file", given=path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _is_file(module: Any, path: Path) -> bool:
    """Whether a module, or the specification of one, is this file."""
    file = getattr(module, "__file__", None) or getattr(module, "origin", None)
    return file is not None and Path(file).resolve() == path


def _take_files(module: ModuleType) -> None:
    """Notes that results may depend on the files of a module."""
    for file in _package_files(module):
        if file not in _files:
            _files[file] = hashlib.sha256(file.read_bytes()).digest()


def _package_files(module: ModuleType) -> Iterable[Path]:
    """The file of a module; all code and data of its package where it belongs to one."""
    file = getattr(module, "__file__", None)
    if file is None:
        return
    path = Path(file).resolve()
    top = path.parent
    if not (top / "__init__.py").exists():
        yield path
        if top.name not in ("site-packages", "dist-packages"):
            # By its text, which is the same in every process, whatever else that has imported.
            finder = ModuleFinder([str(top)])
            finder.run_script(str(path))
            found = (getattr(one, "__file__", None) for one in finder.modules.values())
            yield from (Path(name).resolve() for name in found if name)
        return
    while (top.parent / "__init__.py").exists():
        top = top.parent
    yield from (found for found in top.rglob("*") if found.suffix in _SUFFIXES)


def _line(error: BaseException) -> str:
    """An error in one line, with the place in the user's code where it can be told."""
    text = " ".join(str(error).split())
    if isinstance(error, LeglabError):
        return text
    frames = traceback.extract_tb(error.__traceback__)
    own = [f for f in frames if "importlib" not in f.filename and f.filename != __file__]
    place = f" ({Path(own[-1].filename).name}, line {own[-1].lineno})" if own else ""
    return f"{type(error).__name__}: {text}{place}"
