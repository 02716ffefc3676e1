"""Finds recordings that are not part of this project."""

import os
from pathlib import Path

import leglab
from leglab.base.errors import FileError


def shared_data(part: str) -> Path:
    """Finds a file or folder below $LEGLAB_DATA; unset, below shared/data beside or in the sources.

    Args:
        part: Its place there, for instance "knee_bench/nominal".

    Raises:
        LeglabError: It is in none of them; names the folders.
    """
    root, named = Path(leglab.__file__).resolve().parents[1], os.environ.get("LEGLAB_DATA")
    beside = [root.parent / "shared" / "data", root / "shared" / "data"]
    folders = [Path(named)] if named else beside
    for folder in folders:
        if (folder / part).exists():
            return folder / part
    raise FileError(
        f"no {part} in {', '.join(map(str, folders))}: the data are not part of this project; "
        "set LEGLAB_DATA to the folder that has them",
        given=part,
    )
