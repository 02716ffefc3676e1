"""The notebooks of docs/start/notebooks run, and show what is kept in them."""

import pytest

from tests.helpers.pages import agrees

pytest.importorskip("nbclient", reason="notebooks run with nbclient and ipykernel")
pytest.importorskip("ipykernel", reason="notebooks run with nbclient and ipykernel")

import nbformat

from tests.helpers.notebooks import NOTEBOOKS, executed, texts

LARGEST = 250_000  # bytes of a notebook: GitHub shows it at once


@pytest.mark.slow("notebooks from end to end")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_shows_what_is_kept_in_it(path, tmp_path):
    kept = texts(nbformat.read(path, as_version=4))
    made = texts(executed(path, tmp_path))
    for number, (said, printed) in enumerate(zip(kept, made, strict=True)):
        assert agrees(said, printed), (
            f"{path.name}, cell {number} keeps\n{said}\nand printed\n{printed}\n"
            "if this change is wanted: python -m tests.helpers.notebooks --write"
        )


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_can_be_read_on_a_page(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert path.stat().st_size < LARGEST
    assert notebook.cells[0].source.startswith("# ")
    kinds = {
        kind
        for cell in notebook.cells
        for o in cell.get("outputs", ())
        for kind in o.get("data", ())
    }
    assert {"image/png", "text/html"} <= kinds
    assert not [
        o for cell in notebook.cells for o in cell.get("outputs", ()) if o.output_type == "error"
    ]


def test_there_are_three():
    assert [path.stem for path in NOTEBOOKS] == [
        "diagnosis_of_a_csv",
        "first_run",
        "own_controller",
    ]
