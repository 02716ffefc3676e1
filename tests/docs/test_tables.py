"""Tables and pages in README.md and docs/ are what their commands print."""

import pytest

from tests.tables import Made, difference, made, pages, printed, write

# The table of docs/concepts/physics.md has its test beside the checks that it shows, in
# test_conformance.py.
MADE = [part for part in made() if "physics_table" not in part.command]


def _part(part):
    # What scripts measure or have kept are figures of our own.
    marks = pytest.mark.slow("our own figures") if part.command.startswith("python ") else ()
    return pytest.param(part, marks=marks, id=str(part))


@pytest.mark.parametrize("part", [_part(part) for part in MADE])
def test_it_is_what_its_command_prints(part):
    changed = difference(part, printed(part.command))
    assert not changed, f"{changed}\nif this change is wanted: python -m tests.tables --write"


def test_every_marker_is_closed():
    for page in pages():
        text = page.read_text()
        closed = sum(1 for part in made([page]) if part.text != text)
        for mark in ("<!-- made by:", "<!-- end -->"):
            found = sum(line.startswith(mark) for line in text.splitlines())
            assert found == closed, f"{page}: {found} lines begin with {mark}, {closed} are pairs"


def test_a_table_can_be_made_anew(tmp_path, monkeypatch):
    monkeypatch.setattr("tests.tables.ROOT", tmp_path)
    page = tmp_path / "page.md"
    command = "python answer.py"
    (tmp_path / "answer.py").write_text("print(6 * 7)")
    page.write_text(f"before\n<!-- made by: {command} -->\nold\n<!-- end -->\nafter\n")
    (part,) = made([page])
    assert part == Made(page="page.md", command=command, text="old\n")
    now = printed(part.command)
    assert "+42" in difference(part, now)
    write(part, now)
    (again,) = made([page])
    assert again.text == "42\n"
    assert not difference(again, now)
    assert page.read_text().startswith("before\n")
    assert page.read_text().endswith("after\n")


@pytest.mark.parametrize(
    ("command", "message"),
    [("rm -r docs", "starts with 'rm'"), ("leglab run nothing", "ended with status 2")],
)
def test_a_command_that_fails_is_said(command, message):
    with pytest.raises(ValueError, match=message):
        printed(command)
