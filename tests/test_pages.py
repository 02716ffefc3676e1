"""Every example of the tutorial and the how-to pages, run in order as it stands there."""

import os
import subprocess
import sys

import pytest

from tests.pages import ROOT, agrees, blocks, steps

PAGES = ("docs/tutorial.md", *sorted(f"docs/how_to/{p.name}" for p in ROOT.glob("docs/how_to/*.md")))


@pytest.mark.parametrize("page", PAGES)
def test_the_page_does_what_it_says(page, tmp_path):
    # A process of its own: pages register effects, scenarios and controllers.
    done = subprocess.run(
        [sys.executable, "-m", "tests.pages", str(ROOT / page), "--keep", str(tmp_path / "page")],
        cwd=ROOT,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("page", PAGES)
def test_every_example_is_run(page):
    text = (ROOT / page).read_text()
    assert any(said for _, said in steps(text)), "no block says what it prints"
    run = {block.start for block, _ in steps(text)}
    said = [b for b in blocks(text) if b.language == "text"]
    assert len(said) == sum(1 for _, s in steps(text) if s), "a text block follows no example"
    for block in blocks(text):
        assert block.start in run or block.language == "text", f"line {block.line} is not run"


@pytest.mark.parametrize(
    ("said", "printed", "same"),
    [
        ("lap 0.0386", "lap 0.0387\n", True),
        ("lap 0.0386", "lap 0.0412\n", False),
        ("verdict: named ...", "verdict: named\n┃ 3 ┃ x", True),
        ("verdict: named ...", "verdict: partial", False),
        ("a ... b", "a 1 b 2 b", True),
        ("a b", "a b c", False),
        ("12 of 12", "12 of 13", False),
    ],
)
def test_what_counts_as_the_same(said, printed, same):
    assert agrees(said, printed) is same
