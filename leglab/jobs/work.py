"""Tasks: the name of a function, and its argument; both are JSON-serialisable."""

import json
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from leglab.base import plugins
from leglab.base.errors import LeglabError, SettingsError, SimulationError, origin

# Function with a JSON-serialisable argument and result.
Work = Callable[[dict[str, Any]], Any]


class WorkError(Exception):
    """A task failed and names the kind of failure itself.

    Args:
        kind: Kind of failure in a word or two, for instance "ended early".
        message: Reason in one line.
    """

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


def name_of(work: Work) -> str:
    """Returns the name by which another process can import a function: MODULE:NAME or FILE:NAME.

    Raises:
        LeglabError: The function is not defined at the top level of a module or file.
    """
    module = sys.modules.get(work.__module__)
    name = getattr(work, "__qualname__", "")
    if getattr(module, name, None) is not work:
        allowed = "a function defined at the top of a module or file"
        text = f"{name or work!r} cannot be called by another process; allowed: "
        raise SettingsError(text, given=name, allowed=allowed)
    if work.__module__ != "__main__":
        return f"{work.__module__}:{name}"
    file = getattr(module, "__file__", None)
    if file is None:
        text = f"{name} is defined at a prompt, where no other process finds it; allowed: "
        raise SettingsError(text, given=name, allowed="one process")
    return f"{Path(file).resolve()}:{name}"


def work_of(name: str) -> Work:
    """Imports and returns the function of a name from `name_of`.

    Raises:
        LeglabError: The module cannot be imported or has no such function.
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
    """Runs a task and returns its answer.

    Returns:
        `result`, JSON-serialisable, or `error` with its `kind`: the `WorkError`'s, "memory",
        "refused" (a `LeglabError`, with its `class` and attributes) or "exception"; and the times
        `wall_s` and `cpu_s` of the task [s].
    """
    started, used = time.perf_counter(), time.process_time()
    found = _found(work)
    return {**found, "wall_s": time.perf_counter() - started, "cpu_s": time.process_time() - used}


def error_of(answer: Mapping[str, Any]) -> LeglabError:
    """Returns the error of an answer without a result.

    It has the class of the `LeglabError` that the task raised, or is a `SimulationError`.
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
    """Returns a value, converted to text if it is not JSON-serialisable."""
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
