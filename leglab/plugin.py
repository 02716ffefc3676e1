"""Loads the MuJoCo plugin library, once a process."""

import ctypes
import functools
from collections.abc import Iterable
from pathlib import Path

import mujoco

import leglab._native


def library_path() -> Path:
    """Path of the shared library with leglab's MuJoCo plugins."""
    # An editable install keeps the sources and the compiled parts in different folders.
    for folder in leglab._native.__path__:
        path = Path(folder) / "libleglab_plugin.so"
        if path.exists():
            return path
    folders = ", ".join(leglab._native.__path__)
    raise FileNotFoundError(f"libleglab_plugin.so is not in {folders}: run `pip install .`")


@functools.cache
def load() -> None:
    """Registers leglab's plugins with MuJoCo; further calls do nothing."""
    mujoco.mj_loadPluginLibrary(str(library_path()))


def slots(names: Iterable[str]) -> dict[int, str]:
    """Registration slots of plugins, as in `MjModel.plugin`, by number."""
    load()
    # MuJoCo's Python bindings do not expose mjp_getPlugin.
    (path,) = Path(mujoco.__path__[0]).glob("libmujoco.so.*")
    look_up = ctypes.CDLL(str(path)).mjp_getPlugin
    look_up.restype = ctypes.c_void_p
    found = {}
    for name in names:
        slot = ctypes.c_int(-1)
        if look_up(name.encode(), ctypes.byref(slot)):
            found[slot.value] = name
    return found


def text_attribute(model: mujoco.MjModel, instance: int, index: int = 0) -> str:
    """Text of an attribute of a plugin instance by its place among the plugin's attributes."""
    start = int(model.plugin_attradr[instance])
    return bytes(model.plugin_attr[start:]).split(b"\0", index + 1)[index].decode()
