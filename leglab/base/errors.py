"""Exceptions that are shown to users as one line instead of a traceback."""

import difflib
import inspect
import traceback
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self


class LeglabError(ValueError):
    """Bad input: the message names what is wrong, where, and what is allowed.

    Each subclass stands for one kind of input; this class itself is raised if the computer lacks
    something, such as a package or a display.

    Args:
        message: One line; if it ends with a space, `allowed` is appended, names joined by commas.
        given: See the attribute.
        allowed: See the attribute.

    Attributes:
        given: The rejected name, value or path; None unless there is exactly one.
        allowed: The allowed names as a tuple, or a text such as "0 or more"; None if the allowed
            values cannot be listed or described.
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
    def unknown(cls, kind: str, name: object, known: Iterable[str], listed: str = "") -> Self:
        """Builds the error for a name that is not among the known ones.

        Args:
            kind: Kind of object that the name refers to, for instance "scenario".
            name: The unknown name.
            known: Existing names; the message lists them and suggests the closest one.
            listed: Text in place of the list, where the names are too many for a line.
        """
        choices = sorted(set(known))
        close = difflib.get_close_matches(str(name), choices, n=1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        listed = listed or f"choose one of {', '.join(choices)}"
        message = f"unknown {kind} {name!r}: {listed}{hint}"
        return cls(message, given=name, allowed=choices)

    def at(self, place: object) -> Self:
        """Returns a copy of the error whose message starts with a place: a file or its folder."""
        known = str(self).startswith((f"{place}: ", f"{place}/"))
        message = str(self) if known else f"{place}: {self}"
        error = type(self)(message, given=self.given)
        error.allowed = self.allowed
        return error


class ModelError(LeglabError):
    """A model, its MJCF file, a MuJoCo plugin or the described machine is not usable."""


class RecordingError(LeglabError):
    """Measured data or their columns cannot be used."""


class SettingsError(LeglabError):
    """A setting, an option, a name or an argument is not allowed."""


class SimulationError(LeglabError):
    """A run fails or diverges; the message names the time and the state."""


class FileError(LeglabError):
    """A file or folder does not exist, cannot be read or written, or has the wrong format."""


@contextmanager
def plugged_in(what: str, code: object) -> Iterator[None]:
    """Converts an exception in a controller's or reference's code to an error that names the line.

    Args:
        what: Kind and name of what runs, for instance "controller 'pd'".
        code: Class or function whose source file the reported line shall be in.

    Raises:
        SettingsError: The code raised an exception or called `sys.exit`.
    """
    try:
        yield
    except LeglabError:
        raise
    except (Exception, SystemExit) as error:
        text = f"{what} failed: {type(error).__name__}: {error} ({origin(error, code)})"
        raise SettingsError(text) from error


def origin(error: BaseException, code: object = None) -> str:
    """Returns file and line of an error's innermost frame in the file of `code`, or in any file."""
    try:
        file = inspect.getsourcefile(code)  # type: ignore[arg-type]
    except TypeError:  # an object without source code
        file = None
    frames = traceback.extract_tb(error.__traceback__)
    at = next((frame for frame in reversed(frames) if frame.filename == file), frames[-1])
    return f"{Path(at.filename).name}, line {at.lineno}"
