"""Work on an existing Dask cluster; each worker's threads have processes do it.

What ends its process, hangs or takes too much memory so leaves the cluster's workers alone.
What travels is text: what a function is given there, results back.
"""

import itertools
import json
import logging
import threading
from collections import defaultdict
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import asdict, replace
from typing import Any
from uuid import uuid4

from leglab.base.errors import LeglabError, SettingsError, SimulationError
from leglab.base.input import parse_json
from leglab.jobs.runner import Answered, Runner, Task, Terms

# Batches of work that the cluster knows of, for each of its threads: one is being done.
_AHEAD = 3
_PATIENCE = 60.0  # s, for the scheduler and its first worker
# Pieces that are shorter travel together, about so long in all [s].
_TOGETHER, _MOST_TOGETHER = 0.3, 50
# Looks at how many threads there are, in answers.
_LOOK = 50

# Processes of this worker that have nothing to do just now, by their terms.
_idle: defaultdict[str, list[Runner]] = defaultdict(list)
_lock = threading.Lock()


def answers(requests: str, terms: str) -> str:
    """Has work done by a process beside this worker of a cluster.

    Args:
        requests: As JSON, a list of what the function is given.
        terms: As JSON, on what terms.

    Returns:
        The answers in their order and the worker's address as `by`, as JSON.

    Raises:
        LeglabError: The process cannot be started, or has other code.
    """
    from distributed import get_worker

    worker = get_worker()
    with _lock:
        runner = _idle[terms].pop() if _idle[terms] else None
    if runner is None:
        wanted = Terms(**json.loads(terms))
        limit = worker.memory_manager.memory_limit
        if wanted.memory is None and limit:
            wanted = replace(wanted, memory=limit / 1e6 / worker.state.nthreads)
        runner = Runner(wanted)
    found = [answer for _, answer in runner.answers(iter(list(enumerate(json.loads(requests)))))]
    with _lock:
        _idle[terms].append(runner)
    return json.dumps({"answers": found, "by": worker.address})


class Cluster(AbstractContextManager[Any]):
    """The workers of an existing Dask cluster.

    Args:
        address: Of its scheduler.
        terms: On what terms processes work.
    """

    def __init__(self, address: str, terms: Terms) -> None:
        self._address, self._terms = address, json.dumps(asdict(terms))
        # Numbers of the pieces and future, by key.
        self._waiting: dict[str, tuple[list[int], Any]] = {}
        self._closing = ExitStack()

    def __enter__(self) -> Callable[[Iterator[Task]], Iterator[Answered]]:
        """Connects, and returns what has requests answered; it may be called again.

        Raises:
            LeglabError: distributed is missing, or there is no scheduler or no worker.
        """
        try:
            import distributed  # noqa: F401
        except ImportError as error:
            raise LeglabError(
                "--scheduler needs the package distributed: pip install 'leglab[cluster]'"
            ) from error
        # What it would log of lost connections is told in one line.
        log = logging.getLogger("distributed")
        self._closing.callback(log.setLevel, log.level)
        log.setLevel(logging.CRITICAL + 1)
        try:
            self._connect()
        except BaseException:
            self._closing.close()
            raise
        return self._answers

    def _connect(self) -> None:
        from distributed import Client

        try:
            self._client = Client(self._address, timeout=_PATIENCE, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise SettingsError(
                f"scheduler {self._address!r} cannot be reached: {error}; allowed: ",
                given=self._address,
                allowed="for instance tcp://127.0.0.1:8786",
            ) from error
        try:
            self._client.wait_for_workers(1, timeout=_PATIENCE)
        except TimeoutError as error:
            self._client.close()
            told = f"scheduler {self._address!r} has no workers"
            raise SettingsError(told, given=self._address) from error

    def __exit__(self, *_: object) -> None:
        """Forgets what has not been made."""
        with suppress(Exception):  # It may be gone, and something else is being raised.
            self._client.cancel([future for _, future in self._waiting.values()], force=True)
        with suppress(Exception):
            self._client.close(timeout=5)
        self._closing.close()

    def _answers(self, requests: Iterator[Task]) -> Iterator[Answered]:
        from distributed import as_completed

        arriving = as_completed(loop=self._client.loop, raise_errors=False)
        token, count, most, together = uuid4().hex, 0, 0, 1
        while True:
            with self._reached():
                if count % _LOOK == 0:  # Workers come and go.
                    most = _AHEAD * max(sum(self._client.nthreads().values()), 1)
                while len(self._waiting) < most:
                    tasks = list(itertools.islice(requests, together))
                    if not tasks:
                        break
                    key = f"leglab-{token}-{tasks[0][0]}"
                    text = json.dumps([request for _, request in tasks])
                    future = self._client.submit(answers, text, self._terms, key=key)
                    self._waiting[key] = [number for number, _ in tasks], future
                    arriving.add(future)
                if not self._waiting:
                    return
                future = next(arriving)
                numbers, _ = self._waiting.pop(str(future.key))
                found, by = self._found(future, len(numbers))
            for number, answer in zip(numbers, found, strict=True):
                yield number, answer, by
            walls = [one["wall_s"] for one in found if isinstance(one.get("wall_s"), float)]
            if walls:
                mean = max(sum(walls) / len(walls), 1e-3)
                together = max(1, min(int(_TOGETHER / mean), _MOST_TOGETHER))
            count += 1

    @contextmanager
    def _reached(self) -> Iterator[None]:
        """Tells in one line that the scheduler is gone, however that shows."""
        try:
            yield
        except (OSError, CancelledError) as error:
            told = f"scheduler {self._address!r} is gone: the same command goes on from here"
            raise SimulationError(told, given=self._address) from error

    def _found(self, future: Any, count: int) -> tuple[list[dict[str, Any]], str]:
        """So many answers, and what made them."""
        from distributed import KilledWorker

        if future.status == "cancelled":
            raise CancelledError
        if future.status == "error":
            problem = future.exception()
            if isinstance(problem, KilledWorker):
                told = {"error": "the workers that made it ended each time", "kind": "died"}
                return [told] * count, self._address
            reason = f"scheduler {self._address!r}: a worker cannot work: {problem}"
            raise SimulationError(reason, given=self._address) from problem
        text = future.result()
        try:
            content = parse_json(text)
            found = [dict(answer) for answer in content["answers"]]
            if len(found) != count:
                raise ValueError(f"it has {len(found)} answers to {count} requests")
            return found, str(content["by"])
        except (ValueError, LookupError, TypeError) as error:
            told = {"error": f"it gave no answer that can be read: {error}", "kind": "died"}
            return [told] * count, self._address
