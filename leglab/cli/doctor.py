"""`leglab doctor`: what a report of a bug needs to know of this installation."""

import importlib.metadata
import importlib.util
import os
import platform
import re
import subprocess
import sys
from pathlib import Path

import typer

from leglab import __version__
from leglab.cli.options import Json, Load
from leglab.cli.terminal import FAILED, print_json, tell

# Packages besides leglab on which results depend.
_VERSIONS = ("mujoco", "numpy", "scipy", "control", "pydantic", "pyarrow", "duckdb", "matplotlib")
_VARIABLES = ("MUJOCO_GL", "OMP_NUM_THREADS", "DISPLAY", "LEGLAB_DATA", "LEGLAB_CACHE")


def doctor(as_json: Json = False, load: Load = None) -> None:
    """Shows versions, OpenGL, cores, the plugin, extras and caches; status 1 where one fails."""
    usable = len(os.sched_getaffinity(0))
    given = [f"{name}={os.environ[name]}" for name in _VARIABLES if name in os.environ]
    found = {
        "leglab": f"{__version__}, {Path(__file__).parents[1]}",
        "python": f"{platform.python_version()}, {platform.platform()}",
        **{name: _version(name) or "missing" for name in _VERSIONS},
        "cores": f"{os.cpu_count()}, {usable} for this process; {platform.machine()}",
        "environment": " ".join(given) or f"none of {', '.join(_VARIABLES)}",
        "plugin": _plugin(),
        "opengl": _opengl(),
        "extras": _extras(),
        "packages": _packages(),
        "cache": _cache(),
    }
    if as_json:
        print_json(found)
    else:
        width = max(map(len, found))
        for name, told in found.items():
            tell(f"{name:{width}}  {told}")
    if any(told.startswith(("missing", "fails")) for told in found.values()):
        raise typer.Exit(FAILED)


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return ""


def _plugin() -> str:
    from leglab.machine.plugin import library_path, load_plugin
    from leglab.machine.simulation import load_model

    try:
        path = library_path()
        load_plugin()
        load_model("knee_bench", visual=False)
    except (OSError, ValueError) as error:
        return f"fails: {error}"
    return f"{path} loads, and knee_bench with it"


def _opengl() -> str:
    """Tests MuJoCo's OpenGL backends on this machine, in the order in which films try them."""
    from leglab.report.film.produce import BACKENDS

    script = "import mujoco; mujoco.GLContext(16, 16).make_current()"
    told = []
    for backend in BACKENDS:
        tried = subprocess.run(
            [sys.executable, "-c", script],
            env={**os.environ, "MUJOCO_GL": backend},
            capture_output=True,
            timeout=60,
        )
        told.append(f"{backend} {'opens' if tried.returncode == 0 else 'does not open'}")
    return ", ".join(told)


def _extras() -> str:
    """Returns the extras of leglab, each with its packages that are missing."""
    told = []
    metadata = importlib.metadata.metadata("leglab")
    wanted = importlib.metadata.requires("leglab") or []
    for extra in metadata.get_all("Provides-Extra") or ():
        marked = re.compile(rf"extra == ['\"]{re.escape(extra)}['\"]")
        names = [re.split(r"[^\w.-]", line)[0] for line in wanted if marked.search(line)]
        missing = [name for name in names if not _version(name)]
        told.append(f"{extra} lacks {', '.join(missing)}" if missing else extra)
    return "; ".join(told)


def _packages() -> str:
    """Returns the entry points of other packages, and why some could not be loaded."""
    from leglab.base import plugins
    from leglab.cli.catalogue import summaries

    summaries()
    names = [f"{kind}: {name}" for kind in plugins.KINDS for name in plugins.entry_points(kind)]
    return "; ".join([*names, *plugins.failures()]) or "none offers controllers or the like"


def _cache() -> str:
    from leglab.runs.fault_simulation import cache_folder

    folder = cache_folder()
    files = [path for path in folder.glob("*") if path.is_file()]
    size = sum(path.stat().st_size for path in files)
    return f"{folder}: {len(files)} files, {size / 1e6:.1f} MB"
