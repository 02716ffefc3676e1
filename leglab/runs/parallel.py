"""Many results in parallel processes: each is kept as soon as it is there, the missing are made."""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import TypeVar

from joblib import Parallel, delayed
from joblib.externals.loky import get_reusable_executor

from leglab.base import plugins

Item = TypeVar("Item")
Result = TypeVar("Result")

_SAFE = "PYTHONSAFEPATH"
# Between two looks of a process at the one that started it [s].
_WATCH_PERIOD = 0.5

# Told after each result: how many are there, how many there will be, which one came.
Progress = Callable[[int, int, str], None]


def make_missing(
    items: Sequence[Item],
    make: Callable[[Item], str],
    *,
    is_made: Callable[[Item], bool],
    jobs: int = -1,
    progress: Progress | None = None,
) -> None:
    """Makes the results that are not there yet, so that an interrupted call can be repeated.

    Args:
        items: What results are of.
        make: Makes one and stores it as a whole or not at all, in a process of its own unless
            there is one job only; returns what to tell of it.
        is_made: Whether one is stored already.
        jobs: Processes at a time; -1 is one a core.
        progress: Called at the beginning and after each result.

    Raises:
        KeyboardInterrupt: The user interrupts; what is stored is kept.
    """
    todo = [item for item in items if not is_made(item)]
    done = len(items) - len(todo)
    if progress:
        progress(done, len(items), "")
    for label in in_processes(make, todo, jobs=min(jobs, max(len(todo), 1))):
        done += 1
        if progress:
            progress(done, len(items), label)


def in_processes(
    make: Callable[[Item], Result], items: Iterable[Item], *, jobs: int = -1
) -> Iterator[Result]:
    """Yields the results of a function in the order in which they are finished.

    Args:
        make: Runs in processes that ignore Ctrl-C, in this one where there is one job.
        items: Its arguments.
        jobs: Processes at a time; -1 is one a core.

    Raises:
        KeyboardInterrupt: The user interrupts; the processes are stopped.
    """
    worker = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)
    user = os.getpid()
    try:
        with _starting():
            luggage = plugins.carried()
            results = worker(delayed(_make)(make, item, user, luggage) for item in items)
        yield from results
    except BaseException:
        get_reusable_executor().shutdown(wait=False, kill_workers=True)
        raise


def _make(
    make: Callable[[Item], Result], item: Item, user: int, luggage: plugins.Carried
) -> Result:
    """Makes one result, in a process of its own or not."""
    end_with(user)
    # The names that users' own code registers may not be known here yet.
    plugins.carry(luggage)
    return make(item)


@cache
def end_with(user: int) -> None:
    """Has this process end soon after the one that started it, however that one ended.

    Args:
        user: Identifier of the process that started it; nothing happens if it is this one.
    """
    if os.getpid() == user:
        return

    def watch() -> None:
        while os.getppid() == user:
            time.sleep(_WATCH_PERIOD)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _starting() -> Iterator[None]:
    """Has processes that start inside ignore Ctrl-C, which reaches them as well.

    They find modules where this process does: Python would look into the working folder first.
    """
    safe = os.environ.get(_SAFE)
    os.environ[_SAFE] = "1"
    main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN) if main else None
    try:
        yield
    finally:
        if main:
            signal.signal(signal.SIGINT, handler)
        if safe is None:
            del os.environ[_SAFE]
        else:
            os.environ[_SAFE] = safe
