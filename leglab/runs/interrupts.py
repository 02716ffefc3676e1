"""Ctrl-C during a run: noted instead of raised, so that what was recorded is kept and written."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Hold:
    """State of a held-back Ctrl-C.

    Attributes:
        begun: Whether the first one is noted from now on; until then it interrupts at once.
    """

    def __init__(self) -> None:
        self.begun = False
        self._noted = False

    def take(self) -> bool:
        """Returns whether there was one that nobody has taken yet, and takes it."""
        noted, self._noted = self._noted, False
        return noted

    def _handle(self, number: int, frame: Any) -> None:
        # The second one in a row is meant: it interrupts whatever is going on.
        if not self.begun or self._noted:
            raise KeyboardInterrupt
        self._noted = True


_present: Hold | None = None


@contextmanager
def held(*, later: bool = False) -> Iterator[Hold]:
    """Holds Ctrl-C back to the end of the block, or of the outermost of such blocks.

    Args:
        later: Whether holding begins only with a block inside that is not later.

    Yields:
        Tells whether there was one. In a thread, or where Ctrl-C is handled by others, never.

    Raises:
        KeyboardInterrupt: At the end, if nobody has taken one that came; at once for the second.
    """
    global _present
    if _present is not None:
        _present.begun |= not later
        yield _present
        return
    hold = Hold()
    hold.begun = not later
    ours = threading.current_thread() is threading.main_thread() and (
        signal.getsignal(signal.SIGINT) is signal.default_int_handler
    )
    if not ours:
        yield hold
        return
    _present = hold
    signal.signal(signal.SIGINT, hold._handle)
    try:
        yield hold
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _present = None
    if hold.take():
        raise KeyboardInterrupt
