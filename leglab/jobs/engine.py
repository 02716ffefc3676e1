"""Makes what is missing: in this process, in several of this machine, or on a Dask cluster.

A piece of work that ends its process, hangs or takes too much memory is answered like one that
raises: with an error and its kind. Nothing else is lost, and what is kept is not made again.
"""

import os
import queue
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import Any, Protocol

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
_HERE = os.uname().nodename


class Store(Protocol):
    """Results by key: those that are there are not made again."""

    def __contains__(self, key: Any, /) -> bool:
        """Whether there is a result that counts."""

    def add(self, key: Any, answer: dict[str, Any], by: str, /) -> str | None:
        """Keeps an answer of `leglab.jobs.work.answer_of`, or returns why it does not count."""


class Results(dict[Any, Any]):
    """Results by key: those found, and those that `keep` returns, given key and result."""

    def __init__(self, found: Mapping[Any, Any], keep: Callable[[Any, Any], Any]) -> None:
        super().__init__(found)
        self._keep = keep

    def add(self, key: Any, answer: dict[str, Any], _: str) -> str | None:
        """As `Store.add`."""
        if "result" not in answer:
            return str(answer.get("error"))
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
) -> dict[Any, str]:
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
    problems: dict[Any, str] = {}
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
        return Processes(count, terms.limited(count))
    from leglab.jobs.cluster import Cluster

    return Cluster(scheduler, terms)


def _answered_here(work: Work, requests: Iterator[Task]) -> Iterator[Answered]:
    for number, content in requests:
        yield number, answer_of(partial(work, content)), _HERE


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
        by = f"{_HERE}, process {number}"
        try:
            for run, answer in runner.answers(iter(self._next, None)):
                if self._over.is_set():
                    break
                self._answers.put((run, answer, by))
            self._answers.put(None)
        except BaseException as error:
            self._answers.put(error)
