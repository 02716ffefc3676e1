"""What all formats share: columns that cannot be read, and metadata as JSON text."""

import json
from collections.abc import Mapping
from typing import Any

from leglab.base.errors import LeglabError


class LeftOut(dict[str, str]):
    """Why columns of a file cannot be read: reasons by column, or by topic where nobody knows them.

    Args:
        partial: Whether such columns are left out; else the file is refused for the first one.
        salvage: Whether what is whole of a broken file is read; else the file is refused.
    """

    def __init__(self, partial: bool, *, salvage: bool = False) -> None:
        super().__init__()
        self.partial, self.salvage = partial, salvage

    def add(self, column: str, error: LeglabError) -> None:
        """Leaves a column out.

        Raises:
            LeglabError: The error, where nothing may be left out.
        """
        if not self.partial:
            raise error
        self[column] = str(error)


def first_line(error: Exception) -> str:
    """Returns the first line of an error's message, or its type where there is no message."""
    return next(iter(str(error).splitlines()), "") or type(error).__name__


def to_json(metadata: Mapping[str, Any]) -> str:
    """Returns metadata as JSON with sorted keys.

    Raises:
        ValueError: A number is not finite, which JSON cannot hold.
    """
    return json.dumps(dict(metadata), allow_nan=False, sort_keys=True)
