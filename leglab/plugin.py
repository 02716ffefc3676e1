"""Loads the MuJoCo plugin library, once a process."""

import functools
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
    raise FileNotFoundError(
        f"libleglab_plugin.so is not in {list(leglab._native.__path__)}: install with `pip install .`"
    )


@functools.cache
def load() -> None:
    """Registers leglab's plugins with MuJoCo; further calls do nothing."""
    mujoco.mj_loadPluginLibrary(str(library_path()))
