"""Files: read with a clear error, written as a whole or not at all."""

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from leglab.base.errors import LeglabError


def write_atomically(path: str | Path, write: Callable[[BinaryIO], object]) -> None:
    """Writes a file through a temporary neighbour that takes its place at the end.

    Args:
        path: The file.
        write: Writes the content into the binary stream that it is given.

    Raises:
        LeglabError: The folder does not exist or cannot be written to, or the disk is full.
    """
    path = Path(path)
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise LeglabError(f"{path}: cannot be written: {error.strerror}") from error
    try:
        with os.fdopen(handle, "wb") as stream:
            write(stream)
        # mkstemp makes private files; a result is as readable as any other new file.
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(temporary, 0o666 & ~mask)
        os.replace(temporary, path)
    except BaseException as error:
        os.unlink(temporary)
        if isinstance(error, OSError) and error.strerror:
            raise LeglabError(f"{path}: cannot be written: {error.strerror}") from error
        raise


def read_bytes(path: Path) -> bytes:
    """Returns the content of a file.

    Raises:
        LeglabError: It cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise LeglabError(f"{path}: cannot be read: {error.strerror}") from error


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
