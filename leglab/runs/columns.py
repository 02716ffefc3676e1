"""Values of a run that come a row at a time and are kept by column."""

import numpy as np

from leglab._native.loop import Rows

# Rows that are kept together before they become columns.
_BLOCK = 1024


class Columns:
    """Values that are taken a row at a time and kept by column.

    A recording takes over a column that is an array of its own; one of a table it has to copy.

    Args:
        source: Array that the values come from.
        index: Where they are in it, (columns,).
        count: Most rows.
    """

    def __init__(self, source: np.ndarray, index: np.ndarray, count: int) -> None:
        self._block = np.empty((min(_BLOCK, count), len(index)))
        self._columns = [np.empty(count) for _ in index]
        self._take = Rows(source, index, self._block).take
        self._row, self._kept = 0, 0

    def take(self, number: int) -> None:
        """Keeps the present values; rows come one after the other, from number 0 on."""
        self._take(self._row)
        self._row += 1
        if self._row == len(self._block):
            self._keep()

    def first(self, rows: int) -> list[np.ndarray]:
        """Returns the first rows of every column, read-only; no row can be taken after it."""
        self._keep()
        for column in self._columns:
            column.resize(rows, refcheck=False)
            column.setflags(write=False)
        return self._columns

    def _keep(self) -> None:
        end = self._kept + self._row
        for column, values in zip(self._columns, self._block.T, strict=True):
            column[self._kept : end] = values[: self._row]
        self._row, self._kept = 0, end
