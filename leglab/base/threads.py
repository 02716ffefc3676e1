"""Threads that one process uses."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits


def threads_allowed() -> int:
    """OMP_NUM_THREADS, or one a core that the process may use where that is not set."""
    told = os.environ.get("OMP_NUM_THREADS", "")
    return int(told) if told.isdigit() and int(told) else len(os.sched_getaffinity(0))


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Linear algebra on one thread, where many small problems are solved on several of our own.

    Threads of both kinds wait for each other: two and a half times the time on two cores. Bits do
    not depend on the machine's number of cores either.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        yield
