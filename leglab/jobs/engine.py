"""Computation of missing results: in this process, in several local ones, or on a Dask cluster.

A task that ends its process, hangs or uses too much memory gets an error and its kind as answer, as
does a task that raises. Other tasks are not affected; stored results are not computed again.
"""

import os
import queue
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import replace
from functools import partial
from typing import Any, Protocol

from leglab.base import plugins
from leglab.base.errors import LeglabError, SettingsError
from leglab.jobs.fingerprint import fingerprint
from leglab.jobs.runner import Answered, Executor, Runner, Task, Terms
from leglab.jobs.work import Work, answer_of, error_of, name_of

# Called after each result with the number of results, the total number, and the latest one's name.
Progress = Callable[[int, int, str], None]

# Default time-out of a task [s].
TIMEOUT = 3600.0
_HERE = os.uname().nodename


class Store(Protocol):
    """Storage of results by key; stored results are not computed again."""

    def __contains__(self, key: Any, /) -> bool:
        """Tests whether there is a valid result."""

    def add(self, key: Any, answer: dict[str, Any], by: str, /) -> LeglabError | None:
        """Stores an answer of `leglab.jobs.work.answer_of`, or returns why it is not valid."""


class Results(dict[Any, Any]):
    """In-memory results by key: existing ones, and new ones as returned by `keep(key, result)`."""

    def __init__(self, found: Mapping[Any, Any], keep: Callable[[Any, Any], Any]) -> None:
        super().__init__(found)
        self._keep = keep

    def add(self, key: Any, answer: dict[str, Any], _: str) -> LeglabError | None:
        """Implements `Store.add`."""
        if "result" not in answer:
            return error_of(answer)
        self[key] = self._keep(key, answer["result"])
        return None


def make_missing(
    made_by: AbstractContextManager[Executor],
    keys: Sequence[Any],
    store: Store,
    given: Callable[[Any], dict[str, Any]],
    *,
    ready: Callable[[], Iterable[Any]] | None = None,
    told: Callable[[Any], str] = str,
    progress: Progress | None = None,
) -> dict[Any, LeglabError]:
    """Computes the results that a store lacks, and stores each as soon as it arrives.

    Therefore the same call, after an interruption at any moment, computes the missing results only.

    Args:
        made_by: Context manager from `executor`; not entered if no result is missing.
        keys: Keys of all results.
        store: Storage of the results.
        given: Returns the function's argument for a key, JSON-serialisable.
        ready: Function that returns the keys that can be computed now; called again when these are
            done, until it returns no missing key. None if all keys can be computed at once.
        told: Returns the text that progress shows for a key.
        progress: Called at the start and after each result.

    Returns:
        Errors of the results that are not valid, by key.

    Raises:
        LeglabError: A process cannot be started, the scheduler cannot be reached, or a result
            cannot be stored.
        KeyboardInterrupt: The user interrupts; the processes are ended.
    """
    problems: dict[Any, LeglabError] = {}
    done = sum(key in store for key in keys)
    if progress:
        progress(done, len(keys), "")
    if done == len(keys):
        return problems

    def missing() -> list[Any]:
        now = keys if ready is None else ready()
        return [key for key in now if key not in store and key not in problems]

    with made_by as answered:
        while todo := missing():
            for number, answer, by in answered((n, given(key)) for n, key in enumerate(todo)):
                if problem := store.add(todo[number], answer, by):
                    problems[todo[number]] = problem
                done += 1
                if progress:
                    progress(done, len(keys), told(todo[number]))
    return problems


def executor(
    work: Work,
    workers: int = -1,
    scheduler: str | None = None,
    *,
    timeout: float = TIMEOUT,
    memory: float | None = None,
    apart: bool = False,
) -> AbstractContextManager[Executor]:
    """Returns a context manager that yields an executor of tasks.

    Args:
        work: Function defined at the top level of a module or file, unless run in this process.
        workers: Number of local processes; -1 for one per core, 1 for this process, without
            limits of time and memory. Not with a scheduler.
        scheduler: Address of a Dask scheduler, for instance "tcp://10.0.0.1:8786"; or None.
        timeout: Maximum wall time of a task [s].
        memory: Maximum memory of a process [MB]; None for its share of the machine's memory.
        apart: Whether a single worker is also a separate process.

    Raises:
        LeglabError: Both workers and a scheduler are given, or `name_of` rejects `work`.
    """
    if scheduler is not None and workers != -1:
        raise SettingsError("workers are processes of this machine: they go without a scheduler")
    if workers == 1 and not apart:
        return nullcontext(partial(_answered_here, work))
    code, luggage = fingerprint(), plugins.carried()
    terms = Terms(work=name_of(work), luggage=luggage, code=code, timeout=timeout, memory=memory)
    if scheduler is None:
        count = (os.cpu_count() or 1) if workers == -1 else workers
        if memory is None:  # A task that uses too much fails before the system kills any process.
            total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e6
            terms = replace(terms, memory=max(0.9 * total / count, 1000.0))
        return _processes(count, terms)
    from leglab.jobs.cluster import cluster

    return cluster(scheduler, terms)


def _answered_here(work: Work, requests: Iterator[Task]) -> Iterator[Answered]:
    for number, content in requests:
        yield number, answer_of(partial(work, content)), _HERE


@contextmanager
def _processes(count: int, terms: Terms) -> Iterator[Executor]:
    """Yields an executor with `count` local processes, each served by a thread of this one."""
    runners = [Runner(terms) for _ in range(count)]
    threads: list[threading.Thread] = []
    lock, over = threading.Lock(), threading.Event()
    # Bounded, since the consumer that stores the rows may be slower for a while.
    answers: queue.Queue[Answered | BaseException | None] = queue.Queue(1000)

    def serve(number: int, requests: Iterator[Task]) -> None:
        def following() -> Task | None:
            with lock:
                return None if over.is_set() else next(requests, None)

        try:
            for run, answer in runners[number].answers(iter(following, None)):
                if over.is_set():
                    break
                answers.put((run, answer, f"{_HERE}, process {number}"))
            answers.put(None)
        except BaseException as error:
            answers.put(error)

    def answered(requests: Iterator[Task]) -> Iterator[Answered]:
        threads[:] = [
            threading.Thread(target=serve, args=(number, requests), daemon=True)
            for number in range(count)
        ]
        for thread in threads:
            thread.start()
        serving = count
        while serving:
            found = answers.get()
            if isinstance(found, BaseException):
                raise found
            if found is None:
                serving -= 1
            else:
                yield found

    try:
        yield answered
    finally:  # Ends all processes, also in the middle of a task.
        over.set()
        for runner in runners:
            runner.stop()
        while any(thread.is_alive() for thread in threads):
            with suppress(queue.Empty):  # A thread may wait for room in the queue.
                answers.get(timeout=0.05)
        for runner in runners:
            runner.close()
