"""Every example of the tutorial and the how-to pages, run in order as it stands there."""

import json
import os
import re
import shlex
import subprocess
import sys

import pytest
import typer

from benchmarks.newcomer import PAGE, sections
from leglab import RunSettings, data, run_scenario, scenario_names
from leglab.cli.app import app
from leglab.runs.folder import default_folder
from tests.helpers.pages import ROOT, agrees, blocks, steps
from tests.tables import pages

NAMES = ("controller", "effect", "from_your_tool", "model", "reference", "scenario")
HOW_TO = [f"docs/guides/{name}.md" for name in NAMES]
PAGES = (
    "docs/start/first_hour.md",
    "docs/start/tutorial.md",
    "docs/guides/sweeps.md",
    "docs/reference/errors.md",
    *HOW_TO,
)
# Their shell lines take hours or install things: commands are only looked up, Python runs.
OTHERS = ("README.md", "docs/start/getting_started.md")
INSTALLATION = (
    "git clone URL-OF-THIS-REPOSITORY leglab && cd leglab",
    "make demo",
    "source .venv/bin/activate",
)
NUMBERS = ("fifteen", "sixteen", "seventeen", "eighteen", "nineteen", "twenty", "twenty-one")


# Of each kind one.
QUICK = ("docs/guides/scenario.md", "docs/reference/errors.md")


def _from_end_to_end(page, *options):
    marks = () if page in QUICK else pytest.mark.slow("a page from end to end")
    return pytest.param(page, options, marks=marks, id=page)


@pytest.mark.parametrize(
    ("page", "options"),
    [
        *(_from_end_to_end(page) for page in PAGES),
        _from_end_to_end(OTHERS[1], "--only", "python"),
    ],
)
def test_the_page_does_what_it_says(page, options, tmp_path):
    folder = tmp_path / "page"
    if page == "docs/start/first_hour.md":  # its reader stands in the clone
        folder.mkdir()
        for part in ("docs", "examples"):
            (folder / part).symlink_to(ROOT / part)
    # A process of its own: pages register effects, scenarios and controllers.
    arguments = [str(ROOT / page), "--keep", str(folder), *options]
    done = subprocess.run(
        [sys.executable, "-m", "tests.helpers.pages", *arguments],
        cwd=ROOT,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow("a page from end to end")
def test_the_formats_page_does_what_it_says(tmp_path):
    pytest.importorskip("nonlinear_benchmarks")
    settings = RunSettings(scenario="nominal", model="knee_bench", duration=0.5)
    run = run_scenario(settings)
    data.write(run.recording, tmp_path / "run.parquet")
    page = ROOT / "docs/reference/data_formats.md"
    arguments = [str(page), "--keep", str(tmp_path), "--only", "python"]
    done = subprocess.run(
        [sys.executable, "-m", "tests.helpers.pages", *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_step_of_the_newcomer_is_run():
    """Here, on another page, or, what takes minutes, in the benchmark that timed this very page."""
    parts = sections(PAGE.read_text())
    kept = json.loads((ROOT / "docs/data/newcomer.json").read_text())["results"]
    assert [step["commands"] for step in kept] == [part.commands for part in parts]
    typed = {b.text for b in blocks(PAGE.read_text()) if b.language == "console"}
    others = [block for page in PAGES for block, _ in steps((ROOT / page).read_text())]
    run = "".join(block.text for block in others if block.language == "sh")
    left = [line for text in typed for line in text.splitlines() if line not in run.splitlines()]
    assert sorted(left) == sorted([*INSTALLATION, "python examples/train_residual.py"])
    saved = {block.file: block.text for block in others if block.file}
    columns = next(b for b in blocks(PAGE.read_text()) if b.file == "columns.toml")
    assert saved["columns.toml"] == columns.text


def test_the_readme_counts_the_scenarios():
    told = re.search(r"(\S+) scenarios degrade the machine", (ROOT / "README.md").read_text())
    assert told is not None
    faults = len(scenario_names()) - 1  # all but nominal
    assert told[1].lower() == NUMBERS[faults - 15]


def _commands():
    for path in pages():
        for block in blocks(path.read_text()):
            for line in block.text.replace("\\\n", " ").splitlines():
                if block.language == "console" and line.startswith("leglab "):
                    yield f"{path.name}:{block.line}", line


@pytest.mark.parametrize(("where", "line"), list(_commands()))
def test_commands_and_options_exist(where, line):
    name, *arguments = shlex.split(line, comments=True)[1:]
    group = typer.main.get_command(app)
    assert name in group.commands, f"{where}: no command {name!r}"
    group.commands[name].make_context(name, arguments)


@pytest.mark.parametrize("page", OTHERS)
def test_a_run_that_a_command_takes_was_made_by_one_before(page):
    made, run = set(), typer.main.get_command(app).commands["run"]
    text = "".join(b.text for b in blocks((ROOT / page).read_text()) if b.language == "console")
    for line in text.splitlines():
        words = shlex.split(line, comments=True)
        out = words[words.index("--out") + 1] if "--out" in words else ""
        taken = [word for word in words if word.startswith("runs/") and word != out]
        assert not [path for path in taken if not path.startswith(tuple(made))], line
        if words[:2] == ["leglab", "run"]:
            given = run.make_context("run", words[2:]).params
            settings = RunSettings(scenario=words[2], controller=given["controller"] or "pd")
            made.add(str(default_folder(settings)))


@pytest.mark.parametrize("page", PAGES)
def test_every_example_is_run(page):
    text = (ROOT / page).read_text()
    assert any(said for _, said in steps(text)), "no block says what it prints"
    run = {block.start for block, _ in steps(text)}
    said = [b for b in blocks(text) if b.language == "text"]
    assert len(said) == sum(1 for _, s in steps(text) if s), "a text block follows no example"
    for block in blocks(text):
        # Commands that take hours or a cluster are checked by name and option alone, see below.
        shown = block.language in ("text", "console", "none")
        assert block.start in run or shown, f"line {block.line} is not run"


@pytest.mark.parametrize(
    ("said", "printed", "same"),
    [
        ("lap 0.0386", "lap 0.0387\n", True),
        ("lap 0.0386", "lap 0.0412\n", False),
        ("verdict: named ...", "verdict: named\n┃ 3 ┃ x", True),
        ("verdict: named ...", "verdict: partial", False),
        ("a ... b", "a 1 b 2 b", True),
        ("a b", "a b c", False),
        ("unexplained ...", "unexplained", False),
        ("12 of 12", "12 of 13", False),
    ],
)
def test_what_counts_as_the_same(said, printed, same):
    assert agrees(said, printed) is same
