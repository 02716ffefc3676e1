"""The process that makes the runs of a sweep, one after the other: `python -m` with this module.

It reads a line of JSON a run from standard input and writes one back, so that nothing it says can
be more than data. Whatever a run does to it, the process that asked lives on: see `runner`.
"""

import json
import os
import resource
import select
import signal
import sys
import time
import traceback
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any, BinaryIO

from leglab.base import plugins
from leglab.base.errors import LeglabError
from leglab.runs.fingerprint import fingerprint
from leglab.runs.folder import write_run
from leglab.runs.parallel import end_with
from leglab.runs.preparation import RunSettings, forget_preparations, prepared
from leglab.runs.run import run_scenario
from leglab.runs.sweeps.outcome import outcome_of

# A process that nobody has asked for so long ends [s].
_IDLE = 300.0


def answer(request: dict[str, Any]) -> dict[str, Any]:
    """Makes one run.

    Args:
        request: `settings` of the run, what to `keep`, and the `folder` of its recording or None.

    Returns:
        `outcome`, or `error` with its `kind`; `wall_s` and `cpu_s` that it took.
    """
    started, used = time.perf_counter(), time.process_time()
    found = _outcome(request)
    return {
        **found,
        "wall_s": time.perf_counter() - started,
        "cpu_s": time.process_time() - used,
    }


def _outcome(request: dict[str, Any]) -> dict[str, Any]:
    try:
        settings = RunSettings(**request["settings"])
        run = run_scenario(settings, preparation=prepared(settings))
        if request["folder"] is not None:
            write_run(run, Path(request["folder"]), overwrite=True)
        if run.history.failure:
            memory = "MemoryError" in run.history.failure
            return {"error": run.history.failure, "kind": "memory" if memory else "ended early"}
        return {"outcome": outcome_of(run, request["keep"])}
    except MemoryError:
        forget_preparations()
        return {"error": "it needs more memory than it may have", "kind": "memory"}
    except LeglabError as error:
        return {"error": " ".join(str(error).split()), "kind": "refused"}
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        text = " ".join(str(error).split())
        place = f"{Path(last.filename).name}, line {last.lineno}"
        return {"error": f"{type(error).__name__}: {text} ({place})", "kind": "exception"}


def _lines(place: int) -> Iterator[bytes]:
    """Lines from a file descriptor, until it ends or has nothing to say for long."""
    rest = b""
    while select.select([place], [], [], _IDLE)[0]:
        part = os.read(place, 1 << 16)
        if not part:
            return
        *lines, rest = (rest + part).split(b"\n")
        yield from lines


def _serve(requests: int, answers: BinaryIO) -> None:
    def say(content: dict[str, Any]) -> None:
        try:
            text = json.dumps(content, allow_nan=False)
        except ValueError:
            text = json.dumps({"error": "its figures are not finite", "kind": "ended early"})
        answers.write(text.encode() + b"\n")
        answers.flush()

    lines = _lines(requests)
    start = json.loads(next(lines))
    end_with(start["user"])
    if start["memory"] is not None:
        limit = int(start["memory"] * 1e6)
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    try:
        plugins.carry(start["luggage"])
        say({"ready": [field.name for field in fields(RunSettings)], "code": fingerprint()})
    except LeglabError as error:
        say({"refused": str(error)})
        return
    for line in lines:
        say(answer(json.loads(line)))


def main() -> None:
    """Serves standard input until it ends; what runs print goes to standard error."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    _serve(sys.stdin.fileno(), answers)


if __name__ == "__main__":
    try:
        main()
    except BrokenPipeError:
        os._exit(1)
