"""Tables in a terminal: in full, however narrow it is."""

import io

from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

# What rich puts in the place of what it cuts off.
_CUT = "\N{HORIZONTAL ELLIPSIS}"


def print_whole(console: Console, table: Table, *, usual: int = 0) -> None:
    """Prints a table of which no cell is cut and no word broken.

    Where the console is too narrow for that, lines are longer than it is: the terminal goes on with
    them below, and a file has them as they are.

    Args:
        console: Where to.
        table: What.
        usual: Width that the table may have in any case [characters].
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
    """Number of signs of a cut in a table of this width; cells may have some of their own."""
    trial = Console(file=io.StringIO(), width=max(width, 1), color_system=None)
    trial.print(table)
    return trial.file.getvalue().count(_CUT)  # type: ignore[attr-defined]
