"""Tables of the command line where there is little room."""

import io

import pytest
from rich.console import Console

from leglab.cli.terminal import plain_table


@pytest.mark.parametrize("length", [12, 200])
def test_a_table_that_is_too_wide_cuts_no_name(length):
    """Names that begin alike are told apart, and a long one does not push the numbers out."""
    names = [f"{'a' * length}_{end}" for end in ("bank", "paper")]
    table = plain_table(("name", *["a rather long head"] * 9), [[n, *["1.25"] * 9] for n in names])
    console = Console(width=120, file=io.StringIO())
    console.print(table)
    text = console.file.getvalue()
    assert "…" not in text
    assert "bank" in text
    assert "paper" in text
    assert text.count("1.25") == 18
