"""Search for recordings that are not part of this project."""

import os
from pathlib import Path

import leglab
from leglab.base.errors import FileError


def shared_data(part: str) -> Path:
    """Finds a path below $LEGLAB_DATA or, if unset, below shared/data next to or in the sources.

    Args:
        part: Path relative to that folder, for instance "knee_bench/nominal".

    Raises:
        LeglabError: None of the folders, which the message names, has the path.
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
