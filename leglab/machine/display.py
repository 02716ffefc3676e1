"""MuJoCo's window: a test for a usable display, and a viewer whose thread ends on closing."""

import os
import threading
import warnings
from typing import Any

from leglab.base.errors import LeglabError


def has_display() -> bool:
    """Tests whether the environment names a display; `check_display` tries to use it."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def check_display(what: str, without: str) -> None:
    """Raises an error if no window can be opened.

    MuJoCo's viewer opens its window in a separate thread, and would wait for a window for ever.

    Args:
        what: Name of the feature that needs the window, for the message.
        without: Alternative without a window, for the message.

    Raises:
        LeglabError: No window can be opened; names DISPLAY and the alternative.
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


class LiveWindow:
    """MuJoCo's viewer in a separate thread.

    Args:
        model: `mujoco.MjModel` to show.
        data: `mujoco.MjData` of the model.
        camera: Name of the camera; the free camera if the model has none of this name.
        options: Options of `mujoco.viewer.launch_passive`.

    Attributes:
        handle: MuJoCo's handle of the window.
    """

    # Longest time that `close` waits for the end of the window's thread [s].
    _FAREWELL = 10.0

    def __init__(self, model: Any, data: Any, *, camera: str, **options: Any) -> None:
        import mujoco.viewer

        threads = set(threading.enumerate())
        self.handle = mujoco.viewer.launch_passive(model, data, **options)
        self._threads = set(threading.enumerate()) - threads
        number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, camera)
        if number >= 0:
            self.handle.cam.type = mujoco.mjtCamera.mjCAMERA_FIXED
            self.handle.cam.fixedcamid = number

    def close(self) -> None:
        """Closes the window and waits for its thread."""
        self.handle.close()
        # A process that ends while this thread still draws gets an error from the X server.
        for thread in self._threads:
            thread.join(self._FAREWELL)
