"""What can go wrong as a file is read."""

from leglab.base.errors import LeglabError


class LeftOut(dict[str, str]):
    """Why columns of a file cannot be read: reasons by column, or by topic where nobody knows them.

    Args:
        partial: Whether such columns are left out; else the file is refused for the first one.
    """

    def __init__(self, partial: bool) -> None:
        super().__init__()
        self.partial = partial

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
