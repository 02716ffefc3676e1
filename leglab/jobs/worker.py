"""Main module of a worker process, which runs tasks one after the other; started by `python -m`.

It reads one line of JSON per task from standard input and writes one line back, so that its answers
are data only. A task may crash this process without harm to the parent process: see `runner`.
"""

import json
import os
import resource
import select
import signal
import sys
import threading
import time
from collections.abc import Iterator
from functools import partial
from typing import Any, BinaryIO

from leglab.base import plugins
from leglab.base.errors import LeglabError
from leglab.jobs.fingerprint import fingerprint
from leglab.jobs.work import answer_of, work_of

# A process ends after this time without a request [s].
_IDLE = 300.0
# Interval of checks whether the parent process is alive [s].
_WATCH_PERIOD = 0.5


def _lines(place: int) -> Iterator[bytes]:
    """Yields lines from a file descriptor until its end, or until the idle time is over."""
    rest = b""
    while select.select([place], [], [], _IDLE)[0]:
        part = os.read(place, 1 << 16)
        if not part:
            return
        *lines, rest = (rest + part).split(b"\n")
        yield from lines


def _serve(requests: int, answers: BinaryIO) -> None:
    def say(content: dict[str, Any]) -> None:
        answers.write(json.dumps(content).encode() + b"\n")
        answers.flush()

    lines = _lines(requests)
    start = json.loads(next(lines))
    _end_with(start["user"])
    if start["memory"] is not None:
        limit = int(start["memory"] * 1e6)
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    try:
        plugins.carry(start["luggage"])
        work = work_of(start["work"])
        say({"code": fingerprint()})
    except LeglabError as error:
        say({"refused": str(error)})
        return
    for line in lines:
        say(answer_of(partial(work, json.loads(line))))


def _end_with(user: int) -> None:
    """Ends this process soon after its parent process has ended, whatever the cause."""

    def watch() -> None:
        while os.getppid() == user:
            time.sleep(_WATCH_PERIOD)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def main() -> None:
    """Serves requests from standard input until its end; redirects prints to standard error."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    _serve(sys.stdin.fileno(), answers)


if __name__ == "__main__":
    try:
        main()
    except BrokenPipeError:
        os._exit(1)
