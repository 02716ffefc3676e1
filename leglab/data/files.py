"""Common parts of all formats: a record of unreadable columns, and metadata as JSON text."""

import json
from collections.abc import Mapping
from typing import Any

from leglab.base.errors import LeglabError


class LeftOut(dict[str, str]):
    """Reasons why columns cannot be read, by column, or by topic if its columns are unknown.

    Args:
        partial: Whether such columns are left out; if not, the first column's error is raised.
        salvage: Whether the intact parts of a broken file are read; else the file is rejected.
    """

    def __init__(self, partial: bool, *, salvage: bool = False) -> None:
        super().__init__()
        self.partial, self.salvage = partial, salvage

    def add(self, column: str, error: LeglabError) -> None:
        """Records that a column is left out because of an error.

        Raises:
            LeglabError: The error, if nothing may be left out (`partial` is false).
        """
        if not self.partial:
            raise error
        self[column] = str(error)


def first_line(error: Exception) -> str:
    """Returns the first line of an error's message, or the error's type if it has no message."""
    return next(iter(str(error).splitlines()), "") or type(error).__name__


def to_json(metadata: Mapping[str, Any]) -> str:
    """Returns metadata as JSON with sorted keys.

    Raises:
        ValueError: A number is not finite, which JSON cannot hold.
    """
    return json.dumps(dict(metadata), allow_nan=False, sort_keys=True)
