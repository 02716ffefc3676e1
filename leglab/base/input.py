"""Reading of regular files, with one-line errors for files that cannot be read."""

import json
import math
import os
import stat
import tomllib
from pathlib import Path
from typing import Any

from leglab.base.errors import FileError, LeglabError


def read_bytes(path: str | Path, most: int = -1) -> bytes:
    """Returns the content of a file, or its first `most` bytes.

    Raises:
        FileError: The file cannot be read or is not regular; reading a pipe would block.
    """
    try:
        # O_NONBLOCK: opening a pipe must not block before the file type is checked.
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(handle, "rb") as stream:
            if not stat.S_ISREG(os.fstat(handle).st_mode):
                raise FileError(f"{path}: cannot be read: it is no regular file", given=path)
            return stream.read(most)
    except OSError as error:
        reason = error.strerror or error
        raise FileError(f"{path}: cannot be read: {reason}", given=path) from error
    except MemoryError as error:
        reason = "it does not fit into memory"
        raise FileError(f"{path}: cannot be read: {reason}", given=path) from error


def no_file(path: str | Path) -> str:
    """Returns why a path is not a usable file: it does not exist, or is not regular."""
    there = os.path.exists(path)
    return "it is no regular file" if there else "there is no such file"


def read_json(path: str | Path) -> Any:
    """Returns the content of a JSON file.

    Raises:
        FileError: The file cannot be read, is not JSON, is nested too deeply, or holds NaN or inf.
    """
    try:
        return parse_json(read_bytes(path))
    except ValueError as error:
        if isinstance(error, LeglabError):
            raise
        raise FileError(f"{path}: cannot be read: {error}", given=path) from error


def parse_json(text: str | bytes) -> Any:
    """Returns the value of a JSON text.

    Raises:
        ValueError: The text is not JSON, is nested too deeply, or holds a number that is not
            finite, which Python's `json` would accept.
    """
    try:
        return json.loads(text, parse_constant=_finite, parse_float=_finite)
    except RecursionError:
        raise ValueError("it is nested too deep") from None


def parse_toml(text: str | bytes) -> dict[str, Any]:
    """Returns the content of a TOML text.

    Raises:
        ValueError: The text is not TOML in UTF-8, is nested too deeply, or has a too long number.
    """
    try:
        return tomllib.loads(text.decode() if isinstance(text, bytes) else text)
    except RecursionError:
        raise ValueError("it is nested too deep") from None


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text[:20]} is not a finite number")
    return number
