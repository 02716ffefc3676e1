"""The errors that users see as a line, not as a traceback."""

import difflib
import inspect
import traceback
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self

_MOST_LISTED = 60  # names in a message


class LeglabError(ValueError):
    """Bad input: the message names what is wrong, where, and what is allowed.

    A subclass says of what kind the input is; this class itself is raised where the computer lacks
    something, such as a package or a display.

    Args:
        message: One line; where it ends with a space, `allowed` follows, names with commas.
        given: As the attribute.
        allowed: As the attribute.

    Attributes:
        given: The name, value or path that was refused; None where there is not one alone.
        allowed: The names to choose from as a tuple, or a text such as "0 or more"; None where
            nothing of the kind can be told.
    """

    def __init__(
        self, message: str, *, given: object = None, allowed: Iterable[str] | None = None
    ) -> None:
        listed = allowed if allowed is None or isinstance(allowed, str) else tuple(allowed)
        if listed is not None and message.endswith(" "):
            message += listed if isinstance(listed, str) else ", ".join(listed)
        super().__init__(message)
        self.given = given
        self.allowed = listed

    @classmethod
    def unknown(cls, kind: str, name: object, known: Iterable[str]) -> Self:
        """Builds the error for a name that is not among the known ones.

        Args:
            kind: What the name stands for, for instance "scenario".
            name: The name that was asked for.
            known: The names that exist; the closest one is suggested, and all are listed, or those
                that are close where there are many.
        """
        choices = sorted(set(known))
        close = difflib.get_close_matches(str(name), choices, n=1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        listed = f"choose one of {', '.join(choices)}"
        if len(choices) > _MOST_LISTED:
            near = difflib.get_close_matches(str(name), choices, n=5, cutoff=0.3)
            listed = f"none of {len(choices)} names" + (
                f", near are {', '.join(near)}" * bool(near)
            )
        message = f"unknown {kind} {name!r}: {listed}{hint}"
        return cls(message, given=name, allowed=choices)

    def at(self, place: object) -> Self:
        """Builds the same error with its place, a file or its folder, before the message."""
        known = str(self).startswith((f"{place}: ", f"{place}/"))
        message = str(self) if known else f"{place}: {self}"
        error = type(self)(message, given=self.given)
        error.allowed = self.allowed
        return error


class ModelError(LeglabError):
    """A model, its MJCF, a plugin of MuJoCo or the machine that they describe does not fit."""


class RecordingError(LeglabError):
    """Measured data or their columns cannot be used."""


class SettingsError(LeglabError):
    """A setting, an option, a name or an argument is not allowed."""


class SimulationError(LeglabError):
    """A run fails or diverges: the message says when and which state."""


class FileError(LeglabError):
    """A file or folder is not there, cannot be read or written, or has another format."""


@contextmanager
def plugged_in(what: str, code: object, kind: type["LeglabError"] | None = None) -> Iterator[None]:
    """Turns an exception of anybody's code into an error with its file and line.

    Args:
        what: Whose code runs, for instance "controller 'pd'".
        code: Its class or function.
        kind: Of the error; None for `SettingsError`.

    Raises:
        LeglabError: The code raised an exception, or asked to exit.
    """
    try:
        yield
    except LeglabError:
        raise
    except (Exception, SystemExit) as error:
        told = f"{what} failed: {type(error).__name__}: {error} ({origin(error, code)})"
        raise (kind or SettingsError)(told) from error


def origin(error: BaseException, code: object = None) -> str:
    """Returns file and line of an error: the last line in the file of `code`, else of all."""
    try:
        file = inspect.getsourcefile(code)  # type: ignore[arg-type]
    except TypeError:  # an object that has no source
        file = None
    frames = traceback.extract_tb(error.__traceback__)
    at = next((frame for frame in reversed(frames) if frame.filename == file), frames[-1])
    return f"{Path(at.filename).name}, line {at.lineno}"
