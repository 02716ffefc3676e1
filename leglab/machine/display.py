"""Whether a window can be opened."""

import os
import warnings

from leglab.base.errors import LeglabError


def check_display(what: str, without: str) -> None:
    """Raises where no window can be opened.

    MuJoCo's viewer opens its window in a thread of its own and would wait there for ever.

    Args:
        what: What needs the window, for the message.
        without: The way without one, for the message.

    Raises:
        LeglabError: Names DISPLAY and the way without a window.
    """
    where = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if not where:
        raise LeglabError(
            f"{what} needs a display, but DISPLAY is not set; without a display: {without}"
        )
    import glfw

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        window = None
        if glfw.init():
            glfw.window_hint(glfw.VISIBLE, glfw.FALSE)
            window = glfw.create_window(16, 16, "leglab", None, None)
            glfw.default_window_hints()
    if not window:
        raise LeglabError(
            f"{what} cannot open a window on DISPLAY={where}; without a display: {without}"
        )
    glfw.destroy_window(window)
