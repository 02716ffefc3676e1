"""The one error that users see as a line, not as a traceback."""

import difflib
from collections.abc import Iterable


class LeglabError(ValueError):
    """Bad input: the message names what is wrong, where, and what is allowed."""


def unknown_name(kind: str, name: object, known: Iterable[str]) -> LeglabError:
    """Builds the error for a name that is not among the known ones.

    Args:
        kind: What the name stands for, for instance "scenario".
        name: The name that was asked for.
        known: The names that exist; all are listed, the closest one is suggested.
    """
    choices = sorted(known)
    close = difflib.get_close_matches(str(name), choices, n=1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    return LeglabError(f"unknown {kind} {name!r}: choose one of {', '.join(choices)}{hint}")
