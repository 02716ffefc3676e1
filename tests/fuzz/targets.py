"""Readers of data that comes from outside, each as a function of the bytes of a file.

Whatever the bytes are, a reader returns or raises a `LeglabError` of one line that names the file.
"""

import functools
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from leglab import data
from leglab.base.errors import LeglabError
from leglab.identification import load
from leglab.machine.simulation import Simulation, load_model
from leglab.runs.record import RunConfiguration, RunMetrics, read
from leglab.runs.run_settings import read_settings
from leglab.runs.sweeps.plan import read_plan

CORPUS = Path(__file__).parent / "corpus"


@dataclass(frozen=True, kw_only=True)
class Target:
    """A reader.

    Attributes:
        read: Reads a file.
        suffix: Of the file's name.
        modules: Packages whose branches guide the fuzzer.
    """

    read: Callable[[Path], Any]
    suffix: str
    modules: tuple[str, ...] = ("leglab.data", "leglab.base")


def _identifier(path: Path) -> None:
    model = load(path)
    joints = (model.joints,) if model.joints > 1 else ()
    inputs = (model.inputs,) if model.inputs > 1 else ()
    if model.joints <= 100:
        model.run(np.full((3, *joints, *inputs), 0.3), np.full((3, *joints), 0.3))


def _model(path: Path) -> None:
    simulation = Simulation(load_model(path, visual=False))
    simulation.reset()
    simulation.step()


def _either(path: Path) -> None:
    for partial in (False, True):
        try:
            for table in data.read_tables(path, partial=partial).values():
                data.summarise(*table)
        except LeglabError:
            if partial:
                raise
    data.read(path, partial=True)


_RUNS = ("leglab.runs", "leglab.base")
TARGETS = {
    "csv": Target(read=_either, suffix=".csv"),
    "parquet": Target(read=_either, suffix=".parquet"),
    "matlab": Target(read=_either, suffix=".mat"),
    "mcap": Target(read=_either, suffix=".mcap", modules=("leglab.data", "mcap", "mcap_ros2")),
    "sysid": Target(read=_either, suffix=".npz"),
    "column_map": Target(read=data.read_column_map, suffix=".toml"),
    "sweep": Target(read=read_plan, suffix=".toml", modules=_RUNS),
    "settings": Target(read=read_settings, suffix=".toml", modules=_RUNS),
    "run_json": Target(read=functools.partial(read, RunConfiguration), suffix=".json"),
    "metrics_json": Target(read=functools.partial(read, RunMetrics), suffix=".json"),
    "identifier": Target(read=_identifier, suffix=".id", modules=("leglab.identification",)),
    "model": Target(read=_model, suffix=".xml", modules=("leglab.machine", "leglab.base")),
}


@functools.cache
def _folder() -> tempfile.TemporaryDirectory:
    return tempfile.TemporaryDirectory(prefix="leglab-fuzz-")


def one_input(name: str, content: bytes) -> bool:
    """Has a reader read a file; returns whether it did not refuse it.

    Raises:
        AssertionError: The refusal does not name the file or has more than a line.
        Exception: Whatever else than a `LeglabError` the reader raises.
    """
    target = TARGETS[name]
    path = Path(_folder().name) / f"input{target.suffix}"
    path.write_bytes(content)
    try:
        target.read(path)
    except LeglabError as error:
        told = str(error)
        assert "\n" not in told, told
        assert path.name in told, told
        return False
    return True
