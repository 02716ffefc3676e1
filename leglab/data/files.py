"""Errors of files that cannot be read."""

from leglab.base.errors import LeglabError


def refuse(column: str, error: LeglabError, left_out: dict[str, str] | None) -> None:
    """Refuses a file for one of its columns, or leaves the column out.

    Args:
        column: The column, or the topic whose columns nobody knows.
        error: Why it cannot be read.
        left_out: Gets the reason by column; None: the file is refused.

    Raises:
        LeglabError: The error, where nothing may be left out.
    """
    if left_out is None:
        raise error
    left_out[column] = str(error)


def first_line(error: Exception) -> str:
    """Returns the first line of an error's message, or its type where there is no message."""
    return next(iter(str(error).splitlines()), "") or type(error).__name__
