"""Plug-ins: entry points of installed packages, and files and modules that a user names.

A package registers plug-ins by entry points in the groups `leglab.controllers`,
`leglab.scenarios`, `leglab.references`, `leglab.effects` and `leglab.models`; an entry point has
the name of the object it defines. They are imported at the first look-up of a name of their kind.
`load` imports a file or module at once. `carried` and `carry` pass plug-ins on to worker processes.
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

# Sources that were loaded or have registered something, in this order: absolute paths of files, and
# names of modules, with True if the user named the source.
_sources: dict[str, bool] = {}
# Modules of entry points that were loaded.
_packages: set[str] = set()
# Error message of each entry point that could not be loaded, by kind and name.
_failures: dict[tuple[str, str], str] = {}
# Files on which results depend, with the digest of their content at the first import, since later
# edits of a file do not change the running code.
_files: dict[Path, bytes] = {}
# Number of nested plug-in imports, during which `note` does nothing: `load` records the imports.
_importing = 0
_SUFFIXES = (".py", ".xml", ".toml")


class Carried(TypedDict):
    """Plug-ins that a process has to load to know the same names; JSON-serialisable."""

    path: list[str]
    packages: list[str]
    sources: dict[str, bool]


@functools.cache
def entry_points(kind: str) -> dict[str, importlib.metadata.EntryPoint]:
    """Returns the entry points of a kind by name, without importing them.

    Args:
        kind: One of `KINDS`.
    """
    found = _all_entry_points().select(group=f"leglab.{kind}")
    return {entry.name: entry for entry in sorted(found, key=lambda entry: entry.name)}


@functools.cache
def _all_entry_points() -> Any:
    """Returns the entry points of all groups; cached, since the search takes 20 ms."""
    return importlib.metadata.entry_points()


def load_entry_points(
    kind: str, known: Callable[[str], bool], register: Callable[[str, Any], None] | None = None
) -> None:
    """Imports all entry points of a kind; skips one that fails, and `failures` reports it.

    Args:
        kind: One of `KINDS`.
        known: Function that tests whether a name is registered.
        register: Registers the loaded object under its name, unless the import has done so.
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
                text = f"it registers nothing called {name!r} among the {kind}"
                raise SettingsError(text, given=name)
        except Exception as error:
            _failures[kind, name] = f"{where} cannot be loaded: {_line(error)}"
        else:
            _take_package(entry.module)


def _take_package(name: str) -> None:
    """Records an imported module and its package as code that results may depend on."""
    module = sys.modules.get(name)
    if module is not None:
        _packages.add(name)
        _take_files(module)


def failures(kind: str | None = None) -> tuple[str, ...]:
    """Returns why entry points could not be loaded, one line each; of all kinds for None."""
    return tuple(text for (of, _), text in _failures.items() if kind in (None, of))


def load(source: str) -> None:
    """Imports a Python file or a module, which registers what it defines.

    Args:
        source: Path of a `.py` file, or name of a module. The folder of a file is appended to
            `sys.path`, so that the file can import other modules in it.

    Raises:
        LeglabError: The file or module does not exist, or its import fails.
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
    """Imports and returns a module by its name, or a Python file by its path.

    Raises:
        ImportError: The module does not exist.
    """
    if source.endswith(".py"):
        with _Importing():
            return _import_file(Path(source))
    return importlib.import_module(source)


def note(module_name: str) -> None:
    """Records that a module has registered something; ignores modules of leglab itself."""
    if _importing or module_name.partition(".")[0] == "leglab":
        return
    module = sys.modules.get(module_name)
    file = getattr(module, "__file__", None)
    if module is None or file is None or not Path(file).is_file():
        return  # a notebook or a prompt: no other process can import it
    # A script runs as `__main__`, which other processes cannot import by name: record its path.
    _sources.setdefault(
        str(Path(file).resolve()) if module_name == "__main__" else module_name, False
    )
    _take_files(module)


def carried() -> Carried:
    """Returns the plug-ins of this process, as another process passes them to `carry`."""
    return {"path": list(sys.path), "packages": sorted(_packages), "sources": dict(_sources)}


def carry(luggage: Carried) -> None:
    """Loads the plug-ins that another process has loaded.

    Raises:
        LeglabError: A source that the user named cannot be loaded, as in `load`.
    """
    sys.path.extend(place for place in luggage["path"] if place not in sys.path)
    for name in luggage["packages"]:
        # A package that is missing or fails here changes the code digest, which is compared.
        with contextlib.suppress(Exception), _Importing():
            importlib.import_module(name)
            _take_package(name)
    for source, named in luggage["sources"].items():
        if source in _sources:
            continue
        try:
            load(source)
        except LeglabError:
            # A source that the user did not name may be irrelevant to the work.
            if named:
                raise


def code_digest() -> str:
    """Returns a digest of all loaded files and the modules they import from their folder."""
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
    """Imports a file under its stem as module name, or a generated name if the stem is taken."""
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
    """Tests whether a module or module specification refers to this file."""
    file = getattr(module, "__file__", None) or getattr(module, "origin", None)
    return file is not None and Path(file).resolve() == path


def _take_files(module: ModuleType) -> None:
    """Records the files of a module as code that results may depend on."""
    for file in _package_files(module):
        if file not in _files:
            _files[file] = hashlib.sha256(file.read_bytes()).digest()


def _package_files(module: ModuleType) -> Iterable[Path]:
    """Yields the file of a module, or all code and data files of the package that contains it."""
    file = getattr(module, "__file__", None)
    if file is None:
        return
    path = Path(file).resolve()
    top = path.parent
    if not (top / "__init__.py").exists():
        yield path
        if top.name not in ("site-packages", "dist-packages"):
            # Imports are found by parsing the source, so that every process gets the same files.
            finder = ModuleFinder([str(top)])
            finder.run_script(str(path))
            found = (getattr(one, "__file__", None) for one in finder.modules.values())
            yield from (Path(name).resolve() for name in found if name)
        return
    while (top.parent / "__init__.py").exists():
        top = top.parent
    yield from (found for found in top.rglob("*") if found.suffix in _SUFFIXES)


def _line(error: BaseException) -> str:
    """Returns an error in one line, with file and line in the plug-in's code if known."""
    text = " ".join(str(error).split())
    if isinstance(error, LeglabError):
        return text
    frames = traceback.extract_tb(error.__traceback__)
    own = [f for f in frames if "importlib" not in f.filename and f.filename != __file__]
    place = f" ({Path(own[-1].filename).name}, line {own[-1].lineno})" if own else ""
    return f"{type(error).__name__}: {text}{place}"
