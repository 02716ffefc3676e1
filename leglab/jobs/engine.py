"""Makes what is missing: in this process, in several of this machine, or on a Dask cluster.

A piece of work that ends its process, hangs or takes too much memory is answered like one that
raises: with an error and its kind. Nothing else is lost, and what is kept is not made again.
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

# Told after each result: how many are there, how many there will be, which one came.
Progress = Callable[[int, int, str], None]

# A piece may take so long [s].
TIMEOUT = 3600.0
_HERE = os.uname().nodename


class Store(Protocol):
    """Results by key: those that are there are not made again."""

    def __contains__(self, key: Any, /) -> bool:
        """Whether there is a result that counts."""

    def add(self, key: Any, answer: dict[str, Any], by: str, /) -> LeglabError | None:
        """Keeps an answer of `leglab.jobs.work.answer_of`, or returns why it does not count."""


class Results(dict[Any, Any]):
    """Results by key: those found, and those that `keep` returns, given key and result."""

    def __init__(self, found: Mapping[Any, Any], keep: Callable[[Any, Any], Any]) -> None:
        super().__init__(found)
        self._keep = keep

    def add(self, key: Any, answer: dict[str, Any], _: str) -> LeglabError | None:
        """As `Store.add`."""
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
    """Has the results made that a store lacks, and keeps each as soon as it comes.

    So after an end at any moment the same call makes exactly what is missing.

    Args:
        made_by: From `executor`; not entered where nothing is missing.
        keys: Of all results.
        store: Where they are kept.
        given: What the function is given for a key, as JSON can hold it.
        ready: Keys that can be made now; called again when they are made, until none is missing.
            None for all keys at once.
        told: What progress says of a key.
        progress: Called at the start and after each result.

    Returns:
        Why results do not count, by key.

    Raises:
        LeglabError: A process cannot be started, the scheduler cannot be reached, or a result
            cannot be kept.
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
    """Returns what has requests answered, as long as it is entered.

    Args:
        work: Defined at the top of a module or file, unless it is done in this process.
        workers: Processes of this machine at a time; -1 is one a core, 1 this process, without
            limits of time and memory. Not with a scheduler.
        scheduler: Address of a Dask scheduler, for instance "tcp://10.0.0.1:8786"; or None.
        timeout: Wall time that a piece may take [s].
        memory: Memory that a process may take [MB]; None for its share of its machine.
        apart: Whether one worker is a process of its own, too.

    Raises:
        LeglabError: Both workers and a scheduler are given, or as `name_of`.
    """
    if scheduler is not None and workers != -1:
        raise SettingsError("workers are processes of this machine: they go without a scheduler")
    if workers == 1 and not apart:
        return nullcontext(partial(_answered_here, work))
    code, luggage = fingerprint(), plugins.carried()
    terms = Terms(work=name_of(work), luggage=luggage, code=code, timeout=timeout, memory=memory)
    if scheduler is None:
        count = (os.cpu_count() or 1) if workers == -1 else workers
        if memory is None:  # What asks for too much ends before the system ends any process.
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
    """So many processes of this machine, each asked by a thread of this one."""
    runners = [Runner(terms) for _ in range(count)]
    threads: list[threading.Thread] = []
    lock, over = threading.Lock(), threading.Event()
    # Bounded: whoever keeps the rows may be slower for a while.
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
    finally:  # All processes end, in the middle of a run as well.
        over.set()
        for runner in runners:
            runner.stop()
        while any(thread.is_alive() for thread in threads):
            with suppress(queue.Empty):  # A thread may wait for room.
                answers.get(timeout=0.05)
        for runner in runners:
            runner.close()
