"""Recordings that are not part of this project: a measured axis and a rough bench."""

import os
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from benchmarks.registry import ROOT
from leglab import data
from leglab.base.errors import FileError
from leglab.base.recording import Recording

EMPS_MODEL = ROOT / "rigs" / "emps.xml"
EMPS_HELD_OUT = "DATA_EMPS_PULSES"
_FORCE = 35.15065  # N/V


def shared_data(part: str) -> Path:
    """Finds a path below $LEGLAB_DATA or, if unset, below shared/data next to or in the sources.

    Args:
        part: Path relative to that folder, for instance "knee_bench/nominal".

    Raises:
        LeglabError: None of the folders, which the message names, has the path.
    """
    named = os.environ.get("LEGLAB_DATA")
    beside = [ROOT.parent / "shared" / "data", ROOT / "shared" / "data"]
    folders = [Path(named)] if named else beside
    for folder in folders:
        if (folder / part).exists():
            return folder / part
    raise FileError(
        f"no {part} in {', '.join(map(str, folders))}: the data are not part of this project; "
        "set LEGLAB_DATA to the folder that has them",
        given=part,
    )


def emps() -> dict[str, Recording]:
    """The measured ball-screw axis: a recording to fit, and one with pulses."""
    found = {}
    for name in ("DATA_EMPS", EMPS_HELD_OUT):
        raw = loadmat(shared_data("emps") / f"{name}.mat")
        t, q, u = (np.asarray(raw[k], dtype=float).ravel() for k in ("t", "qm", "vir"))
        found[name] = Recording(time=t, columns={"slide_position": q, "drive_command": _FORCE * u})
    return found


def rough_bench(specimen: str) -> tuple[dict[str, Recording], tuple[str, ...]]:
    """Recordings of a specimen that is off everywhere, and the names of all but the healthy."""
    place = shared_data(f"rough_bench/{specimen}")
    later = {p.name: data.read(p) for p in sorted(place.glob("*.parquet"))}
    healthy = sorted((place / "healthy").glob("*.parquet"))
    return {f"healthy/{p.name}": data.read(p) for p in healthy} | later, tuple(later)
