"""Tables of the command line where there is little room."""

import io

import pytest
from rich.console import Console
from rich.table import Table

from leglab.base.tables import print_whole
from leglab.cli import terminal
from leglab.cli.terminal import plain_table
from tests.cli.test_cli import leglab


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


@pytest.mark.parametrize("width", [20, 60, 80, 200])
def test_a_narrow_terminal_breaks_no_word_and_cuts_no_cell(width):
    table = Table("effect", "parameter", "value", title="verdict: named")
    table.columns[1].no_wrap = True
    table.add_row("leakage at knee_valve", "internal_leakage in SI", "1.7e-12 … 2e-12")
    console = Console(width=width, file=io.StringIO())
    print_whole(console, table)
    text = console.file.getvalue()
    assert console.width == width
    assert text.count("…") == 1
    for word in ("internal_leakage in SI", "knee_valve", "1.7e-12"):
        assert word in text
    if width >= 80:
        assert max(map(len, text.splitlines())) <= width


@pytest.mark.parametrize("arguments", [("list",), ("parameters",), ("list", "bsnn_arx_bank")])
def test_commands_show_all_in_forty_columns(arguments, capsys, monkeypatch):
    monkeypatch.setattr(terminal.output, "width", 200)
    wide = set(leglab(*arguments, capsys=capsys)[1].split())
    monkeypatch.setattr(terminal.output, "width", 40)
    narrow = set(leglab(*arguments, capsys=capsys)[1].split())
    assert {word for word in wide - narrow if word.isidentifier()} == set()
