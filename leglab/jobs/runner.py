"""Client side of a worker process, which may die, hang, or send invalid answers."""

import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from leglab.base import plugins
from leglab.base.errors import SimulationError
from leglab.base.input import parse_json

_START_TIME = 120.0  # maximum time for a process to start and to import its modules [s]
_MOST_ANSWER = 100_000_000  # maximum length of an answer [bytes]
_MOST_SAID = 1_000_000  # maximum length of standard error that is kept for error messages [bytes]
# After a task shorter than `_SHORT` [s], a request of at most `_MOST_AHEAD` [bytes] is sent early.
_SHORT, _MOST_AHEAD = 0.5, 30_000
_TRIES = 2  # attempts at a task whose process dies
# Several processes share the cores, so each uses one thread for linear algebra. Then the rounding
# of a result does not depend on the number of processes either.
_THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


# Number of a task, and the argument of the function.
Task = tuple[int, dict[str, Any]]
# Number of the task, answer in the form of `leglab.jobs.work.answer_of`, and the worker's name.
Answered = tuple[int, dict[str, Any], str]
# Runs tasks, several in parallel, and yields answers as they arrive. May be called repeatedly.
Executor = Callable[[Iterator[Task]], Iterator[Answered]]


class DiedError(Exception):
    """The process ended or failed during a task; the message says how."""


class TimedOutError(Exception):
    """A task took longer than its time-out."""


@dataclass(frozen=True, kw_only=True)
class Terms:
    """Conditions under which worker processes work; JSON-serialisable."""

    work: str  #: Name of the function that they call, from `leglab.jobs.work.name_of`
    luggage: plugins.Carried  #: Plug-ins that the processes load
    code: str  #: Digest that their version of leglab's code must have
    timeout: float  #: Maximum wall time of a task [s]
    memory: float | None  #: Maximum memory of a process [MB]; None for no limit


class Runner:
    """One worker process; started with the first task, and again after it has died.

    Args:
        terms: Conditions under which it works.
    """

    def __init__(self, terms: Terms) -> None:
        self._terms = terms
        self._process: subprocess.Popen[bytes] | None = None
        self._rest = b""
        self._closed = False
        self._sent = 0
        self._errors = tempfile.TemporaryFile("a+b")  # noqa: SIM115  open until `close`

    def answers(self, tasks: Iterator[Task]) -> Iterator[tuple[int, dict[str, Any]]]:
        """Runs tasks one after the other.

        A task whose process dies is tried again in a new process, since the cause may be external.

        Args:
            tasks: Number of each task, and the argument of the function.

        Yields:
            Number and answer of each task.

        Raises:
            LeglabError: The process cannot be started, or has another version of the code.
        """
        # Sent tasks, of which the first is running; after a short task a second one is sent.
        asked: deque[Task] = deque()
        ahead, tries = 1, 0
        while True:
            while len(asked) < ahead and (task := next(tasks, None)) is not None:
                asked.append(task)
            if not asked:
                return
            try:
                self._send_all([request for _, request in asked])
                found = self._line(self._terms.timeout)
            except TimedOutError:
                self._end()
                text = f"it took longer than {self._terms.timeout:g} s"
                found = {"error": text, "kind": "time-out"}
            except DiedError as death:
                self._end()
                tries += 1
                if tries < _TRIES and not self._closed:
                    continue
                found = {"error": str(death), "kind": "died"}
            tries = 0
            self._sent = max(self._sent - 1, 0)
            if self._errors.seek(0, os.SEEK_END) > _MOST_SAID:
                self._errors.truncate(0)
            wall = found.get("wall_s")
            ahead = 2 if isinstance(wall, float) and wall < _SHORT else 1
            yield asked.popleft()[0], found

    def stop(self) -> None:
        """Kills the process, also during a task; may be called from any thread."""
        self._closed = True
        if (process := self._process) is not None:
            process.kill()

    def close(self) -> None:
        """Ends the process; must not be called while `answers` waits in another thread."""
        self._closed = True
        self._end()
        self._errors.close()

    def _send_all(self, requests: Sequence[dict[str, Any]]) -> None:
        """Sends the requests that this process does not have yet."""
        if self._process is not None and self._process.poll() is not None and not self._sent:
            self._end()  # It has ended by itself after its idle time.
        if self._process is None:
            self._start()
        for request in requests[self._sent :]:
            text = _line_of(request)
            if self._sent and len(text) > _MOST_AHEAD:
                return  # Deadlock risk: both sides could wait for the other to read.
            self._send(text)
            self._sent += 1

    def _start(self) -> None:
        terms = self._terms
        self._rest = b""
        process = subprocess.Popen(
            # -P: keeps Python from importing modules from the working folder.
            [sys.executable, "-P", "-m", "leglab.jobs.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            bufsize=0,
            start_new_session=True,  # Ctrl-C shall interrupt the parent process only.
            env={**os.environ, **_THREADS},
        )
        self._process = process
        if self._closed:
            raise DiedError("nothing more is asked of it")
        start = {"work": terms.work, "luggage": terms.luggage, "memory": terms.memory}
        try:
            self._send(_line_of({**start, "user": os.getpid()}))
            found = self._line(_START_TIME)
        except (DiedError, TimedOutError) as error:
            if self._closed:
                raise DiedError("nothing more is asked of it") from error
            found = {"refused": str(error) or f"it said nothing for {_START_TIME:g} s"}
        if "refused" in found:
            problem = f"a process cannot be started: {found['refused']}"
        elif found.get("code") != terms.code:
            problem = (
                f"{os.uname().nodename}: the leglab there is of other code than the one here: "
                "install the same version with the same plug-ins"
            )
        else:
            return
        self._end()
        raise SimulationError(problem)

    def _send(self, content: bytes) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        text = memoryview(content)
        try:
            while text:
                text = text[self._process.stdin.write(text) or 0 :]
        except OSError as error:
            raise DiedError(self._death()) from error

    def _line(self, timeout: float) -> dict[str, Any]:
        """Returns the next answer of the process, one line of JSON."""
        assert self._process is not None
        assert self._process.stdout is not None
        end = time.monotonic() + timeout
        parts = [self._rest]
        size = len(self._rest)
        while b"\n" not in parts[-1]:
            left = end - time.monotonic()
            try:
                ready = left > 0 and select.select([self._process.stdout], [], [], left)[0]
                if not ready:
                    raise TimedOutError
                part = os.read(self._process.stdout.fileno(), 1 << 20)
            except OSError as error:
                raise DiedError(self._death()) from error
            size += len(part)
            if not part or size > _MOST_ANSWER:
                raise DiedError(self._death())
            parts.append(part)
        line, _, self._rest = b"".join(parts).partition(b"\n")
        try:
            found = parse_json(line)
            if not isinstance(found, dict):
                raise ValueError("it is no object")
        except ValueError as error:
            text = f"the process that made it gave no answer that can be read: {error}"
            raise DiedError(text) from error
        return found

    def _death(self) -> str:
        process = self._process
        assert process is not None
        try:
            status = process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            return "the process that made it closed its output"
        if status < 0:
            name = signal.Signals(-status).name if -status in set(signal.Signals) else ""
            what = f"the process that made it was ended by signal {-status} {name}".rstrip()
        else:
            what = f"the process that made it ended with status {status}"
        last = self._last_words()
        return f"{what}: {last}" if last else what

    def _last_words(self) -> str:
        size = self._errors.seek(0, os.SEEK_END)
        self._errors.seek(max(size - 2000, 0))
        lines = self._errors.read().decode(errors="replace").strip().splitlines()
        return " ".join(lines[-1].split())[:300] if lines else ""

    def _end(self) -> None:
        process, self._process, self._sent = self._process, None, 0
        if process is None:
            return
        process.kill()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                stream.close()
        process.wait()
        self._errors.truncate(0)


def _line_of(content: dict[str, Any]) -> bytes:
    return json.dumps(content).encode() + b"\n"
