"""Window that shows a session in real time in MuJoCo's interactive viewer."""

import queue
import time

from leglab.machine.display import LiveWindow, check_display
from leglab.viewer.display import Display
from leglab.viewer.session import Session

HELP = """\
keys       Space      pause, go on
           Enter      fault of the scenario on or off
           Backspace  start again
           Home       ghost of the reference on or off
           Tab        options of MuJoCo's viewer
sliders    click "Control" on the right: seal leak, oil temperature, payload
mouse      double-click a body, then Ctrl + right button pushes it
close the window to end"""

# GLFW's codes of the keys.
SPACE, ENTER, BACKSPACE, HOME = 32, 257, 259, 268
_FRAME = 1.0 / 60.0
# A frame may simulate for as long as the previous frame took, within these bounds [s]. Control
# periods for which the time does not suffice are not caught up later.
_BUDGET = (0.25, 1.0)


def check_window() -> None:
    """Raises `LeglabError` if the viewer cannot open a window."""
    check_display("the viewer", "leglab run, then leglab video")


class Window:
    """The window of a session.

    Args:
        session: Session to show.
        model: Name of its model or path of the file.

    Attributes:
        display: Display model.
        handle: MuJoCo's handle of the window.

    Raises:
        LeglabError: If no window can be opened; the message names commands that need no window.
    """

    def __init__(self, session: Session, model: str) -> None:
        check_window()
        self._session = session
        self.display = Display(session, model)
        self._keys: queue.SimpleQueue[int] = queue.SimpleQueue()
        self._paused, self._ghost = False, True
        # The window's thread calls the callback, hence the queue.
        self._window = LiveWindow(
            self.display.model,
            self.display.data,
            camera="three_quarter",
            key_callback=self._keys.put,
            show_left_ui=False,
        )
        self.handle = self._window.handle

    def run(self, duration: float | None = None) -> None:
        """Shows the session in real time until the window is closed.

        Args:
            duration: Longest time [s]; None for no limit.
        """
        begin = clock = time.monotonic()
        while self.handle.is_running() and (duration is None or clock - begin < duration):
            now = time.monotonic()
            self.frame(now - clock)
            clock = now
            time.sleep(max(0.0, _FRAME - (time.monotonic() - now)))

    def frame(self, elapsed: float) -> None:
        """Advances the session by `elapsed` [s] and shows it."""
        session = self._session
        self._use_keys()
        until = session.time + elapsed
        deadline = time.monotonic() + min(max(elapsed, _BUDGET[0]), _BUDGET[1])
        while not self._paused and session.time < until and not session.failure:
            session.step()
            if time.monotonic() > deadline:
                break
        handle = self.handle
        with handle.lock():
            self.display.show()
            if self._ghost:
                self.display.draw_ghost(handle.user_scn, self.display.eye(handle.cam))
            else:
                handle.user_scn.ngeom = 0
        handle.set_texts((None, None, *self.display.texts(paused=self._paused)))
        if handle.viewport is not None:
            handle.set_figures(self.display.figures(handle.viewport))
        handle.sync()
        with handle.lock():
            if self.display.take_over():
                self._restart()

    def close(self) -> None:
        """Closes the window."""
        self._window.close()
        self._session.close()

    def _use_keys(self) -> None:
        while not self._keys.empty():
            key = self._keys.get()
            if key == SPACE:
                self._paused = not self._paused
            elif key == ENTER:
                self._session.switch_fault()
            elif key == BACKSPACE:
                self._restart()
            elif key == HOME:
                self._ghost = not self._ghost

    def _restart(self) -> None:
        self._session.restart()
        self.display.reset_sliders()
        self.display.show()
