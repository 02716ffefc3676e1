"""Terminal tables that are printed in full, however narrow the terminal is."""

import io

from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

# The character that rich inserts where it truncates text.
_CUT = "\N{HORIZONTAL ELLIPSIS}"


def print_whole(console: Console, table: Table, *, usual: int = 0) -> None:
    """Prints a table without truncated cells or broken words.

    If the console is too narrow, the lines are longer than its width: a terminal wraps them, a file
    gets them unchanged.

    Args:
        console: The output.
        table: The table.
        usual: Width that the table may have even if the console is narrower [characters].
    """
    unbound = console.options.update_width(1_000_000)
    wanted = Measurement.get(console, unbound, table)
    own = _cuts(console, table, wanted.maximum)
    for width in (max(console.width, usual), wanted.minimum, 2 * wanted.minimum, wanted.maximum):
        if width >= wanted.minimum and _cuts(console, table, width) <= own:
            break
    before, console.width = console.width, max(width, 1)
    try:
        console.print(table)
    finally:
        console.width = before


def _cuts(console: Console, table: Table, width: int) -> int:
    """Counts ellipses in a table of this width; the text of cells may contain some as well."""
    trial = Console(file=io.StringIO(), width=max(width, 1), color_system=None)
    trial.print(table)
    return trial.file.getvalue().count(_CUT)  # type: ignore[attr-defined]
