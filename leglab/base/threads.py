"""Number of threads of one process."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits


def threads_allowed() -> int:
    """Returns OMP_NUM_THREADS, or if unset the number of cores that the process may use."""
    told = os.environ.get("OMP_NUM_THREADS", "")
    return int(told) if told.isdigit() and int(told) else len(os.sched_getaffinity(0))


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limits BLAS to one thread, for code that solves many small problems in threads of its own.

    Threads of BLAS in these threads take 2.5 times the run time on two cores. With one BLAS thread
    the rounding also does not depend on the number of cores.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        yield
