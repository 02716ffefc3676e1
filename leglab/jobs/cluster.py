"""Execution of tasks on an existing Dask cluster, in subprocesses of its workers.

The subprocesses protect a worker from tasks that end their process, hang or use too much memory.
Arguments and results are sent as JSON text.
"""

import itertools
import json
import logging
import threading
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from functools import partial
from typing import Any
from uuid import uuid4

from leglab.base.errors import LeglabError, SettingsError, SimulationError
from leglab.base.input import parse_json
from leglab.jobs.runner import Answered, Executor, Runner, Task, Terms

# Number of batches submitted per thread of the cluster, of which one runs and the others wait.
_AHEAD = 3
_PATIENCE = 60.0  # maximum wait for the scheduler and for its first worker [s]
# Approximate total duration [s] and maximum number of the short tasks that form a batch.
_TOGETHER, _MOST_TOGETHER = 0.3, 50
# Number of answered batches between two queries of the cluster's number of threads.
_LOOK = 50

# Batches without an answer: task numbers and future, by Dask key.
Waiting = dict[str, tuple[list[int], Any]]
# Idle subprocesses of this worker, by their `Terms` as JSON.
_idle: defaultdict[str, list[Runner]] = defaultdict(list)
_lock = threading.Lock()


def answers(requests: str, terms: str) -> str:
    """Runs tasks in a subprocess of this Dask worker.

    Args:
        requests: List of the function's arguments, as JSON.
        terms: The `Terms` of the process, as JSON.

    Returns:
        JSON with `answers` in the order of the requests, and the worker's address as `by`.

    Raises:
        LeglabError: The process cannot be started, or has another version of the code.
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
    found = [answer for _, answer in runner.answers(enumerate(json.loads(requests)))]
    with _lock:
        _idle[terms].append(runner)
    return json.dumps({"answers": found, "by": worker.address})


@contextmanager
def cluster(address: str, terms: Terms) -> Iterator[Executor]:
    """Connects to an existing Dask cluster.

    Args:
        address: Address of its scheduler.
        terms: Conditions under which the processes work.

    Yields:
        An executor that runs tasks on the cluster's workers; it may be called repeatedly.

    Raises:
        LeglabError: The package distributed is missing, or no scheduler or worker responds.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise LeglabError(
            "--scheduler needs the package distributed: pip install 'leglab[cluster]'"
        ) from error
    # Silences the package's log of lost connections, because errors report them in one line.
    log = logging.getLogger("distributed")
    level = log.level
    log.setLevel(logging.CRITICAL + 1)
    waiting: Waiting = {}
    try:
        try:
            client = Client(address, timeout=_PATIENCE, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise SettingsError(
                f"scheduler {address!r} cannot be reached: {error}; allowed: ",
                given=address,
                allowed="for instance tcp://127.0.0.1:8786",
            ) from error
        try:
            try:
                client.wait_for_workers(1, timeout=_PATIENCE)
            except TimeoutError as error:
                text = f"scheduler {address!r} has no workers"
                raise SettingsError(text, given=address) from error
            yield partial(_answers, client, address, json.dumps(asdict(terms)), waiting)
        finally:
            with suppress(Exception):  # The scheduler may be gone; keep the original exception.
                client.cancel([future for _, future in waiting.values()], force=True)
            with suppress(Exception):
                client.close(timeout=5)
    finally:
        log.setLevel(level)


def _answers(
    client: Any, address: str, terms: str, waiting: Waiting, requests: Iterator[Task]
) -> Iterator[Answered]:
    from distributed import as_completed

    arriving = as_completed(loop=client.loop, raise_errors=False)
    token, count, most, together = uuid4().hex, 0, 0, 1
    while True:
        try:
            if count % _LOOK == 0:  # The number of workers may change.
                most = _AHEAD * max(sum(client.nthreads().values()), 1)
            while len(waiting) < most:
                tasks = list(itertools.islice(requests, together))
                if not tasks:
                    break
                key = f"leglab-{token}-{tasks[0][0]}"
                text = json.dumps([request for _, request in tasks])
                future = client.submit(answers, text, terms, key=key)
                waiting[key] = [number for number, _ in tasks], future
                arriving.add(future)
            if not waiting:
                return
            future = next(arriving)
            numbers, _ = waiting.pop(str(future.key))
            found, by = _found(future, len(numbers), address)
        except (OSError, CancelledError) as error:
            message = f"scheduler {address!r} is gone: the same command goes on from here"
            raise SimulationError(message, given=address) from error
        for number, answer in zip(numbers, found, strict=True):
            yield number, answer, by
        walls = [one["wall_s"] for one in found if isinstance(one.get("wall_s"), float)]
        if walls:
            mean = max(sum(walls) / len(walls), 1e-3)
            together = max(1, min(int(_TOGETHER / mean), _MOST_TOGETHER))
        count += 1


def _found(future: Any, count: int, address: str) -> tuple[list[dict[str, Any]], str]:
    """Returns the `count` answers of a future and the worker that made them."""
    from distributed import KilledWorker

    if future.status == "cancelled":
        raise CancelledError
    if future.status == "error":
        problem = future.exception()
        if isinstance(problem, KilledWorker):
            told = {"error": "the workers that made it ended each time", "kind": "died"}
            return [told] * count, address
        reason = f"scheduler {address!r}: a worker cannot work: {problem}"
        raise SimulationError(reason, given=address) from problem
    text = future.result()
    try:
        content = parse_json(text)
        found = [dict(answer) for answer in content["answers"]]
        if len(found) != count:
            raise ValueError(f"it has {len(found)} answers to {count} requests")
        return found, str(content["by"])
    except (ValueError, LookupError, TypeError) as error:
        told = {"error": f"it gave no answer that can be read: {error}", "kind": "died"}
        return [told] * count, address
