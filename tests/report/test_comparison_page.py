"""The page of a comparison: the table of the terminal, its intervals drawn, every run."""

import html
import json
import math
import re
import shlex

import pytest
import typer

from leglab.base.errors import LeglabError
from leglab.cli.app import app
from leglab.report.comparison.page import page
from leglab.report.comparison.words import rows, untold
from leglab.report.folder_index import write_index
from tests.cli.test_cli import leglab
from tests.helpers.comparison_folders import write_comparison
from tests.helpers.report_folders import HOSTILE, Elements
from tests.report.test_sweeps_page import tables

COMMANDS = typer.main.get_command(app).commands


def test_a_comparison_gets_its_page_beside_it_and_the_index_leads_there(tmp_path, capsys):
    folder = tmp_path / "compare"
    write_comparison(folder)
    status, printed, _ = leglab("report", folder, capsys=capsys)
    assert (status, printed) == (0, f"written to {folder / 'report.html'}\n")
    assert "exists; remove it" in leglab("report", folder, capsys=capsys)[2]
    other = ("report", folder, "--out", tmp_path / "o", "--json")
    status, printed, _ = leglab(*other, capsys=capsys)
    assert json.loads(printed) == {"page": str(tmp_path / "o" / "report.html")}
    assert 'href="./../compare/runs/' in (tmp_path / "o" / "report.html").read_text()
    template = tmp_path / "templates" / "report.html"  # of a page, and no page
    template.parent.mkdir()
    template.write_text('<meta name="generator" content="leglab {{ kind }}" />')
    entries, _ = write_index(tmp_path, tmp_path / "index.html")
    (entry,) = [e for e in entries if e.kind == "comparison"]
    assert entry.link == "./compare/report.html"
    assert entry.told == "3 seeds; seal_wear: bsnn_arx 2.02 ± 0.05 mrad"
    assert [e.kind for e in entries] == ["comparison", "report"]  # that in "o"


def test_reasons_of_missing_figures_are_told_once_for_all_controllers():
    late, nothing = "the change is too late", "nothing changes"
    cells = {"pd": {"untold": [late], "runs": 1}, "arx": {"untold": [late], "runs": 2}}
    rest = {"pd": {"untold": [nothing], "runs": 1}, "arx": {"runs": 2}}
    assert untold({"results": {"seal_wear": cells, "nominal": rest}}) == [
        f"seal_wear, pd and arx (1 runs): what was undone cannot be told: {late}"
    ]


def test_the_table_is_that_of_the_terminal_and_every_run_is_linked(tmp_path):
    folder = tmp_path / "c"
    summary = write_comparison(folder, failed=("static_feedforward",), missing=("pd",))
    text = page(folder)
    found = tables(text)
    numbers = next(table for caption, table in found.items() if caption.startswith("RMS tracking"))
    assert numbers[1:] == [[s, c, *cells] for s, c, cells in rows(summary)]
    runs = next(table for caption, table in found.items() if caption.startswith("Every run"))
    assert len(runs) == 1 + 9
    assert runs[1][2:4] == ["seed 0", "its file is not there"]
    assert runs[4][3] == "it blew up"
    assert runs[9][-2:] == ["90", "0.5"]
    links = [html.unescape(x) for x in re.findall(r'<td><a href="([^"]*)"', text)]
    assert len(links) == 6
    assert all((folder / link).is_file() for link in links)
    assert "static_feedforward: 1 of 3 runs failed: it blew up." in html.unescape(text)


def test_intervals_are_drawn_where_their_numbers_are(tmp_path):
    summary = write_comparison(tmp_path / "c")
    text = page(tmp_path / "c")
    first = text[text.index('class="intervals"') :].partition("</figure>")[0]
    marks = re.findall(r'<b style="left: ([\d.]+)%; width: ([\d.]+)%', first)
    dots = [float(x) for x in re.findall(r'<em style="left: ([\d.]+)%', first)]
    cells = [cell["after_rad"] for cell in summary["results"]["seal_wear"].values()]
    ends = [(c["mean"] - c["half_width"], c["mean"] + c["half_width"]) for c in cells]
    low, high = min(e[0] for e in ends), max(e[1] for e in ends)
    # The axis is logarithmic: the errors span a factor of twenty.
    span = math.log(high / low)
    for cell, (a, b), (left, width), dot in zip(cells, ends, marks, dots, strict=True):
        for value, shown in (
            (a, float(left)),
            (b, float(left) + float(width)),
            (cell["mean"], dot),
        ):
            inner = (shown - 100 * 0.04 / 1.08) * 1.08 / 100
            assert inner == pytest.approx(math.log(value / low) / span, abs=2e-3)
    assert dots == sorted(dots, reverse=True)
    assert text.count("data:image/png") == 1  # the error over time, of one scenario


def test_controllers_whose_intervals_overlap_are_not_told_apart(tmp_path):
    summary = write_comparison(tmp_path / "c")
    assert '<h1 id="summary">Closest to the reference: bsnn_arx in seal_wear.</h1>' in page(
        tmp_path / "c"
    )
    cells = summary["results"]["seal_wear"]
    cells["static_feedforward"]["after_rad"] |= {"mean": 0.0022, "half_width": 0.0002}
    (tmp_path / "c" / "compare.json").write_text(json.dumps(summary))
    told = html.unescape(re.sub("<[^>]*>", "", page(tmp_path / "c")))
    assert "No controller is clearly the closest in seal_wear." in told
    assert (
        "bsnn_arx 2.02 ± 0.05 mrad, not told apart from static_feedforward 2.20 ± 0.20 mrad; "
        "pd 40.40 ± 0.99 mrad." in told
    )


def test_one_seed_has_no_intervals_and_says_so(tmp_path):
    write_comparison(tmp_path / "c", seeds=1, controllers=("pd",))
    words = " ".join(Elements(page(tmp_path / "c")).texts)
    assert "One seed says nothing about the scatter" in words
    assert "±" not in words


def test_its_commands_make_the_same_runs(tmp_path):
    summary = write_comparison(tmp_path / "c")
    changed = {"severity": 4.0, "element": "it's knee", "duration": 6.5, "vary": True}
    (tmp_path / "c" / "compare.json").write_text(json.dumps({**summary, **changed}))
    text = html.unescape(re.search(r"<pre>(.*?)</pre>", page(tmp_path / "c"), re.DOTALL)[1])
    (line,) = text.strip().splitlines()
    program, name, *arguments = shlex.split(line)
    assert program == "leglab"
    parsed = COMMANDS[name].make_context(name, arguments).params
    assert parsed["controllers"] == "pd,static_feedforward,bsnn_arx"
    wanted = {"scenario": "seal_wear", "model": "knee_bench", "seed": 0, **changed}
    assert {key: parsed[key] for key in wanted} == wanted
    # A ramp is no option of that command.
    (tmp_path / "c" / "compare.json").write_text(json.dumps({**summary, "ramp_duration": 1.0}))
    assert "<pre>" not in page(tmp_path / "c")


@pytest.mark.parametrize(
    "spoil",
    [
        lambda content: content.pop("seeds"),
        lambda content: content["results"]["seal_wear"].pop("pd"),
        lambda content: content["results"]["seal_wear"]["pd"].update(after_rad={"mean": "x"}),
    ],
)
def test_a_damaged_comparison_gets_one_line(tmp_path, capsys, spoil):
    content = write_comparison(tmp_path / "c")
    spoil(content)
    (tmp_path / "c" / "compare.json").write_text(json.dumps(content))
    status, _, told = leglab("report", tmp_path / "c", capsys=capsys)
    assert status == 2
    assert told.count("\n") == 1
    assert "compare.json does not have the form of a comparison" in told
    with pytest.raises(LeglabError):
        page(tmp_path / "missing")


def test_hostile_names_stay_text(tmp_path):
    content = json.dumps(write_comparison(tmp_path / "c"))
    hostile = json.loads(content.replace('"pd"', json.dumps(HOSTILE)))
    (tmp_path / "c" / "compare.json").write_text(json.dumps(hostile))
    text = page(tmp_path / "c")
    assert HOSTILE not in text
    assert "<script" not in text
