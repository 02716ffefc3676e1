"""What MuJoCo does for onlookers alone, left out while nobody looks."""

import contextlib
import ctypes
import functools
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import mujoco


@functools.cache
def library() -> ctypes.CDLL:
    """MuJoCo's shared library, for what its Python bindings do not expose."""
    (path,) = Path(mujoco.__path__[0]).glob("libmujoco.so.*")
    return ctypes.CDLL(str(path))


class _Away:
    """Something of the whole process, gone as long as any thread wants it gone."""

    def __init__(self, take: Callable[[], Callable[[], None]]) -> None:
        self._take = take
        self._give = _nothing
        self._count = 0
        self._lock = threading.Lock()

    @contextlib.contextmanager
    def __call__(self) -> Iterator[None]:
        with self._lock:
            if self._count == 0:
                self._give = self._take()
            self._count += 1
        try:
            yield
        finally:
            with self._lock:
                self._count -= 1
                if self._count == 0:
                    self._give()


def _nothing() -> None:
    pass


def _take_warnings() -> Callable[[], None]:
    mujoco.set_mju_user_warning(lambda warning: None)
    return lambda: mujoco.set_mju_user_warning(None)


def _take_clock() -> Callable[[], None]:
    # The bindings set a clock that their `set_mjcb_time` does not take away.
    clock = ctypes.c_void_p.in_dll(library(), "mjcb_time")
    taken, clock.value = clock.value, None

    def give() -> None:
        clock.value = taken

    return give


_warnings_away, _clock_away = _Away(_take_warnings), _Away(_take_clock)


def without_warnings() -> contextlib.AbstractContextManager[None]:
    """MuJoCo would write its warnings to a log file: whoever steps checks what they warn of."""
    return _warnings_away()


@contextlib.contextmanager
def headless(model: mujoco.MjModel) -> Iterator[None]:
    """Steps a model without warnings, its sensors and the times that MuJoCo takes of itself.

    The motion is the same, to the bit, in about four fifths of the time.
    """
    flags = model.opt.disableflags
    with without_warnings(), _clock_away():
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
        try:
            yield
        finally:
            model.opt.disableflags = flags
