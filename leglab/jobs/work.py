"""A piece of work: a function by its name and what it is given, both as JSON can hold them."""

import json
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from leglab.base import plugins
from leglab.base.errors import LeglabError, SettingsError, SimulationError, origin

# Takes and gives what JSON can hold.
Work = Callable[[dict[str, Any]], Any]


class WorkError(Exception):
    """Work that failed in a way that it names itself.

    Args:
        kind: How it failed, in a word or two: "ended early".
        message: Why, in one line.
    """

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


def name_of(work: Work) -> str:
    """Returns by what name another process finds a function: MODULE:NAME, or FILE:NAME of a script.

    Raises:
        LeglabError: It is not defined at the top of a module or file.
    """
    module = sys.modules.get(work.__module__)
    name = getattr(work, "__qualname__", "")
    if getattr(module, name, None) is not work:
        allowed = "a function defined at the top of a module or file"
        told = f"{name or work!r} cannot be called by another process; allowed: "
        raise SettingsError(told, given=name, allowed=allowed)
    if work.__module__ != "__main__":
        return f"{work.__module__}:{name}"
    file = getattr(module, "__file__", None)
    if file is None:
        told = f"{name} is defined at a prompt, where no other process finds it; allowed: "
        raise SettingsError(told, given=name, allowed="one process")
    return f"{Path(file).resolve()}:{name}"


def work_of(name: str) -> Work:
    """Returns the function of this name, as `name_of` gives it.

    Raises:
        LeglabError: There is none.
    """
    place, _, function = name.rpartition(":")
    try:
        module = plugins.imported(place)
    except ImportError as error:
        raise SettingsError(f"{place} cannot be imported: {error}", given=place) from error
    work = getattr(module, function, None)
    if not callable(work):
        raise SettingsError(f"{place} has no function {function!r}", given=function)
    return work


def answer_of(work: Callable[[], Any]) -> dict[str, Any]:
    """Does a piece of work.

    Returns:
        `result` as JSON can hold it, or `error` with its `kind`: that of a `WorkError`, "memory",
        "refused" (a `LeglabError`, with its `class` and attributes) or "exception"; `wall_s` and
        `cpu_s` that it took.
    """
    started, used = time.perf_counter(), time.process_time()
    found = _found(work)
    return {
        **found,
        "wall_s": time.perf_counter() - started,
        "cpu_s": time.process_time() - used,
    }


def error_of(answer: Mapping[str, Any]) -> LeglabError:
    """Returns the error of an answer without a result.

    That which the work raised, in this class; a `SimulationError` for whatever else went wrong.
    """
    kinds: list[type[LeglabError]] = [LeglabError, *LeglabError.__subclasses__()]
    classes = {kind.__name__: kind for kind in kinds}
    allowed = answer.get("allowed")
    return classes.get(str(answer.get("class")), SimulationError)(
        str(answer.get("error")),
        given=answer.get("given"),
        allowed=allowed if isinstance(allowed, str | list) else None,
    )


def _plain(value: Any) -> Any:
    """A value, as text if JSON cannot hold it."""
    try:
        json.dumps(value, allow_nan=False)
    except (TypeError, ValueError):
        return str(value)
    return value


def _found(work: Callable[[], Any]) -> dict[str, Any]:
    try:
        result = work()
        try:
            json.dumps(result, allow_nan=False)
        except ValueError:
            return {"error": "its figures are not finite", "kind": "ended early"}
        return {"result": result}
    except WorkError as error:
        return {"error": str(error), "kind": error.kind}
    except MemoryError:
        return {"error": "it needs more memory than it may have", "kind": "memory"}
    except LeglabError as error:
        told = {"class": type(error).__name__, "given": error.given, "allowed": error.allowed}
        text = " ".join(str(error).split())
        return {"error": text, "kind": "refused", **{k: _plain(v) for k, v in told.items()}}
    except Exception as error:
        text = " ".join(str(error).split())
        return {"error": f"{type(error).__name__}: {text} ({origin(error)})", "kind": "exception"}
