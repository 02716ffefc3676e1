"""The runs of a sweep on an existing Dask cluster; each worker's threads have processes make them.

A run that ends its process, hangs or takes too much memory so leaves the cluster's workers alone.
What travels is text: settings there, figures back.
"""

import json
import logging
import threading
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import asdict, replace
from typing import Any
from uuid import uuid4

from leglab.base.errors import LeglabError
from leglab.base.input import parse_json
from leglab.runs.sweeps.runner import Runner, Terms

# Runs that the cluster knows of, for each of its threads: one is made, the others are at hand.
_AHEAD = 3
_PATIENCE = 60.0  # s, for the scheduler and its first worker
# Looks at how many threads there are, in answers.
_LOOK = 50

# Processes of this worker that make no run just now, by their terms.
_idle: defaultdict[str, list[Runner]] = defaultdict(list)
_lock = threading.Lock()


def answer(request: str, terms: str) -> str:
    """Has a run made by a process beside this worker of a cluster.

    Args:
        request: As JSON, of `leglab.runs.sweeps.worker.answer`.
        terms: As JSON, on what terms.

    Returns:
        The answer as JSON, with the worker's address as `by`.

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
    found = runner.answer(json.loads(request))
    with _lock:
        _idle[terms].append(runner)
    return json.dumps({**found, "by": worker.address})


class Cluster(AbstractContextManager[Iterator[Any]]):
    """The workers of an existing Dask cluster.

    Args:
        address: Of its scheduler.
        terms: On what terms processes make runs.
    """

    def __init__(self, address: str, terms: Terms) -> None:
        self._address, self._terms = address, json.dumps(asdict(terms))
        # Number of the run and future, by key.
        self._waiting: dict[str, tuple[int, Any]] = {}
        self._closing = ExitStack()

    def __call__(self, requests: Iterator[tuple[int, dict[str, Any]]]) -> "Cluster":
        """Sets what is to be answered."""
        self._requests = requests
        return self

    def __enter__(self) -> Iterator[tuple[int, dict[str, Any], str]]:
        """Connects.

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
            return self._connected()
        except BaseException:
            self._closing.close()
            raise

    def _connected(self) -> Iterator[tuple[int, dict[str, Any], str]]:
        from distributed import Client

        try:
            self._client = Client(self._address, timeout=_PATIENCE, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise LeglabError(
                f"scheduler {self._address!r} cannot be reached: {error}; allowed: for instance "
                "tcp://127.0.0.1:8786"
            ) from error
        try:
            self._client.wait_for_workers(1, timeout=_PATIENCE)
        except TimeoutError as error:
            self._client.close()
            raise LeglabError(f"scheduler {self._address!r} has no workers") from error
        return self._answers()

    def __exit__(self, *_: object) -> None:
        """Forgets what has not been made."""
        with suppress(Exception):  # It may be gone, and something else is being raised.
            self._client.cancel([future for _, future in self._waiting.values()], force=True)
        with suppress(Exception):
            self._client.close(timeout=5)
        self._closing.close()

    def _answers(self) -> Iterator[tuple[int, dict[str, Any], str]]:
        from distributed import as_completed

        arriving = as_completed(loop=self._client.loop, raise_errors=False)
        token, count, most = uuid4().hex, 0, 0
        while True:
            with self._reached():
                if count % _LOOK == 0:  # Workers come and go.
                    most = _AHEAD * max(sum(self._client.nthreads().values()), 1)
                while len(self._waiting) < most and (task := next(self._requests, None)):
                    key = f"leglab-{token}-{task[0]}"
                    future = self._client.submit(answer, json.dumps(task[1]), self._terms, key=key)
                    self._waiting[key] = task[0], future
                    arriving.add(future)
                if not self._waiting:
                    return
                future = next(arriving)
                number, _ = self._waiting.pop(str(future.key))
                found = self._found(future)
            yield number, found, str(found.pop("by", self._address))
            count += 1

    @contextmanager
    def _reached(self) -> Iterator[None]:
        """Tells in one line that the scheduler is gone, however that shows."""
        try:
            yield
        except (OSError, CancelledError) as error:
            raise LeglabError(
                f"scheduler {self._address!r} is gone: the same command goes on from here"
            ) from error

    def _found(self, future: Any) -> dict[str, Any]:
        from distributed import KilledWorker

        if future.status == "cancelled":
            raise CancelledError
        if future.status == "error":
            problem = future.exception()
            if isinstance(problem, KilledWorker):
                return {"error": "the workers that made it ended each time", "kind": "died"}
            raise LeglabError(
                f"scheduler {self._address!r}: a worker cannot make runs: {problem}"
            ) from problem
        text = future.result()
        try:
            found = parse_json(text)
            if not isinstance(found, dict):
                raise ValueError("it is no object")
        except ValueError as error:
            return {"error": f"it gave no answer that can be read: {error}", "kind": "died"}
        return found
