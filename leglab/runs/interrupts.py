"""Deferred handling of Ctrl-C during a run, so that the samples recorded so far are kept."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Hold:
    """State of a deferred Ctrl-C.

    Attributes:
        begun: Whether the first Ctrl-C is deferred; if False, it interrupts at once.
    """

    def __init__(self) -> None:
        self.begun = False
        self._noted = False

    def take(self) -> bool:
        """Returns whether a Ctrl-C is pending, and clears it."""
        noted, self._noted = self._noted, False
        return noted

    def _handle(self, number: int, frame: Any) -> None:
        # A second Ctrl-C interrupts at once.
        if not self.begun or self._noted:
            raise KeyboardInterrupt
        self._noted = True


_present: Hold | None = None


@contextmanager
def held(*, later: bool = False) -> Iterator[Hold]:
    """Defers Ctrl-C to the end of the block, or of the outermost of nested blocks.

    Args:
        later: Whether deferring begins only in a nested block with `later=False`.

    Yields:
        State of the deferral. Outside the main thread or with another handler nothing is deferred.

    Raises:
        KeyboardInterrupt: At the end, if a Ctrl-C is still pending; at once for a second Ctrl-C.
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
