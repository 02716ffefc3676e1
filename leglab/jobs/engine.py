"""Has many pieces of work done: in this process, in several of this machine, or on a Dask cluster.

A piece that ends its process, hangs or takes too much memory is answered like one that raises: with
an error and its kind. Nothing else is lost.
"""

import os
import queue
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from functools import partial
from typing import Any

from leglab.base import plugins
from leglab.base.errors import SettingsError
from leglab.jobs.fingerprint import fingerprint
from leglab.jobs.runner import Answered, Runner, Task, Terms
from leglab.jobs.work import Work, answer_of, name_of

# Told after each result: how many are there, how many there will be, which one came.
Progress = Callable[[int, int, str], None]

# Has requests answered, several at a time; yields answers as they come. May be called again.
Executor = Callable[[Iterator[Task]], Iterator[Answered]]

# A piece may take so long [s].
TIMEOUT = 3600.0


def terms_of(work: Work, timeout: float = TIMEOUT, memory: float | None = None) -> Terms:
    """Terms for work by this code, with the plug-ins that are loaded here.

    Args:
        work: Defined at the top of a module or file.
        timeout: Wall time that a piece may take [s].
        memory: Memory that a process may take [MB]; None for its share of its machine.

    Raises:
        LeglabError: As `name_of`.
    """
    return Terms(
        work=name_of(work),
        luggage=plugins.carried(),
        code=fingerprint(),
        timeout=timeout,
        memory=memory,
    )


def executor(workers: int, scheduler: str | None, terms: Terms) -> AbstractContextManager[Executor]:
    """Returns what has requests answered, as long as it is entered.

    Args:
        workers: Processes of this machine at a time; -1 is one a core. Not with a scheduler.
        scheduler: Address of a Dask scheduler, for instance "tcp://10.0.0.1:8786"; or None.
        terms: On what terms processes work.

    Raises:
        LeglabError: Both workers and a scheduler are given.
    """
    if scheduler is None:
        count = (os.cpu_count() or 1) if workers == -1 else workers
        return Processes(count, terms.limited(count))
    if workers != -1:
        raise SettingsError("workers are processes of this machine: they go without a scheduler")
    from leglab.jobs.cluster import Cluster

    return Cluster(scheduler, terms)


def answers(
    work: Work,
    given: Iterable[tuple[int, dict[str, Any]]],
    *,
    workers: int = -1,
    scheduler: str | None = None,
    timeout: float = TIMEOUT,
) -> Iterator[Answered]:
    """Yields answers in the order in which they are found.

    Args:
        work: Defined at the top of a module or file, unless there is one worker.
        given: Number of each piece and what the function is given, as JSON can hold it.
        workers: As `executor`; 1 is this process, without limits of time and memory.
        scheduler: As `executor`.
        timeout: Wall time that a piece may take [s].

    Raises:
        LeglabError: As `executor` and `name_of`, a process cannot be started, or the scheduler
            cannot be reached.
        KeyboardInterrupt: The user interrupts; the processes are ended.
    """
    if workers == 1 and scheduler is None:
        for number, content in given:
            yield number, answer_of(partial(work, content)), this_machine()
        return
    with executor(workers, scheduler, terms_of(work, timeout)) as answered:
        yield from answered(iter(given))


def this_machine() -> str:
    """Name of this machine."""
    return os.uname().nodename


class Processes(AbstractContextManager[Executor]):
    """Processes of this machine, each asked by a thread of this one; they stay between calls.

    Args:
        count: How many.
        terms: On what terms.
    """

    def __init__(self, count: int, terms: Terms) -> None:
        self._runners = [Runner(terms) for _ in range(count)]
        self._threads: list[threading.Thread] = []
        self._lock, self._over = threading.Lock(), threading.Event()
        # Bounded: whoever keeps the rows may be slower for a while.
        self._answers: queue.Queue[Answered | BaseException | None] = queue.Queue(1000)

    def __enter__(self) -> Executor:
        """Returns what has requests answered."""
        return self._answered

    def __exit__(self, *_: object) -> None:
        """Ends all processes, in the middle of a run as well."""
        self._over.set()
        for runner in self._runners:
            runner.stop()
        while any(thread.is_alive() for thread in self._threads):
            try:  # A thread may wait for room.
                self._answers.get(timeout=0.05)
            except queue.Empty:
                continue
        for runner in self._runners:
            runner.close()

    def _answered(self, requests: Iterator[Task]) -> Iterator[Answered]:
        self._requests = requests
        self._threads = [
            threading.Thread(target=self._serve, args=(runner, number), daemon=True)
            for number, runner in enumerate(self._runners)
        ]
        for thread in self._threads:
            thread.start()
        serving = len(self._threads)
        while serving:
            found = self._answers.get()
            if isinstance(found, BaseException):
                raise found
            if found is None:
                serving -= 1
            else:
                yield found

    def _next(self) -> Task | None:
        with self._lock:
            return None if self._over.is_set() else next(self._requests, None)

    def _serve(self, runner: Runner, number: int) -> None:
        by = f"{this_machine()}, process {number}"
        try:
            for run, answer in runner.answers(iter(self._next, None)):
                if self._over.is_set():
                    break
                self._answers.put((run, answer, by))
            self._answers.put(None)
        except BaseException as error:
            self._answers.put(error)
