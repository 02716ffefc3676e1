"""Tables of a page."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table whose first columns are words and the others numbers.

    Attributes:
        caption: What it shows, with the unit.
        head: Names of the columns.
        rows: Cells as text, as many a row as there are columns.
        words: Number of columns that are words.
        heads: Whether the first cell of each row names the row.
    """

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int = 1
    heads: bool = True
