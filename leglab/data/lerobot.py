"""Datasets of LeRobot, layouts v2.1 and v3: episodes in Parquet files, names in meta/info.json.

Layout: huggingface.co/docs/lerobot/lerobot-dataset-v3. An episode becomes a recording with
`timestamp` as time; an element of a list becomes a column `<feature>/<name>`.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from leglab.base.errors import FileError
from leglab.base.input import read_json
from leglab.data import parquet
from leglab.data.files import LeftOut

# Index columns: they locate an episode's rows in the dataset and are not part of the recording.
_COUNTERS = frozenset(("index", "frame_index", "episode_index", "task_index"))
# Types of features that are not numeric.
_PICTURES = ("image", "video", "string", "language")


def read_tables(path: Path, left_out: LeftOut) -> dict[str, tuple[dict, dict]]:
    """Reads the episodes of a dataset (its folder), or of one file of its folder `data`.

    Returns:
        Columns and metadata of each episode, by `episode_<number>`.

    Raises:
        LeglabError: A file is broken, or there is none.
    """
    features = _features(path)
    files = sorted(path.glob("data/*/*.parquet")) if path.is_dir() else [path]
    if not files:
        raise FileError("a dataset of LeRobot without files data/chunk-*/*.parquet", given=path)
    pictures = frozenset(name for name, f in features.items() if f.get("dtype") in _PICTURES)
    found: dict[int, dict[str, np.ndarray]] = {}
    for file in files:
        table, _ = parquet.read_table(file, left_out, without=pictures)
        for name, given in features.items():
            _rename(table, name, _names(given.get("names")))
        owner = table["episode_index"]
        for number in np.unique(owner[np.isfinite(owner)]).astype(int).tolist():
            part = {n: x[owner == number] for n, x in table.items() if n not in _COUNTERS}
            if number in found:  # An episode may continue in another file.
                part = {n: np.concatenate([found[number][n], x]) for n, x in part.items()}
            found[number] = part
    return {f"episode_{number}": (found[number], {}) for number in sorted(found)}


def is_dataset(path: Path) -> bool:
    """Tests whether a Parquet file belongs to a dataset, by its folder or by its columns."""
    if _description(path).is_file():
        return True
    try:
        return {"episode_index", "frame_index", "timestamp"} <= set(pq.read_schema(path).names)
    except (pa.ArrowException, OSError, UnicodeDecodeError):
        return False


def _description(path: Path) -> Path:
    """Returns `meta/info.json` of a dataset, given its folder or a file in its folder `data`."""
    return (path if path.is_dir() else path.resolve().parent.parent.parent) / "meta/info.json"


def _features(path: Path) -> dict[str, dict[str, Any]]:
    place = _description(path)
    if not place.is_file():
        return {}
    features = read_json(place).get("features")
    if not isinstance(features, dict) or not all(isinstance(f, dict) for f in features.values()):
        raise FileError(f"{place}: describes no dataset of LeRobot: no object 'features'")
    return features


def _names(given: Any) -> list[str]:
    """Returns element names, given as a list, lists by group {"motors": [...]}, or name: index."""
    if isinstance(given, dict) and all(isinstance(place, int) for place in given.values()):
        return sorted(given, key=lambda name: given[name])
    parts = given.values() if isinstance(given, dict) else [given or ()]
    return [str(name) for part in parts for name in part]


def _rename(table: dict[str, np.ndarray], feature: str, names: list[str]) -> None:
    # A feature with one element is stored as a number, not as a list.
    places = [place for place in table if place == feature or place.startswith(f"{feature}[")]
    if len(places) == len(set(names)) == len(names):
        for place, name in zip(places, names, strict=True):
            table[f"{feature}/{name}"] = table.pop(place)
