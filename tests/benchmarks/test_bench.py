"""`python -m benchmarks bench`: ratios from real results, the history, the check, and the page."""

import html
import json
import re
from dataclasses import replace

import pytest

from benchmarks.bench import main
from benchmarks.registry import DATA, Benchmark
from benchmarks.suite import history, suite
from benchmarks.suite.history import Entry, add, change, kept_value, read_history, worse
from benchmarks.suite.page import markdown_tables
from benchmarks.suite.suite import PARTS, RATIOS, Measured, Value, values
from leglab.base.errors import LeglabError

LOW = next(r for r in RATIOS if r.name == "cylinder_over_bare_loop")
HIGH = next(r for r in RATIOS if r.name == "batch_of_bare_residual")
SLOW = next(r for r in RATIOS if r.name == "thousand_runs_s")


def command_line(capsys, *words) -> tuple[int, str, str]:
    """Exit status and what is printed."""
    status = 0
    try:
        main([str(word) for word in words])
    except SystemExit as ended:
        status = int(ended.code or 0)
    return status, *capsys.readouterr()


def entry(machine="here", **ratios) -> Entry:
    return Entry(commit=f"{len(ratios)}abc", date="2026-11-22", machine=machine, ratios=ratios)


def test_every_ratio_has_a_part_and_a_name_of_its_own():
    assert {ratio.part for ratio in RATIOS} <= {part.name for part in PARTS}
    assert len({ratio.name for ratio in RATIOS}) == len(RATIOS)


def test_ratios_are_those_of_the_kept_results():
    stored = {v.ratio.name: v.median for v in values(suite.stored(PARTS))}
    data = {p.stem: json.loads(p.read_text()) for p in DATA.glob("*.json")}
    loops = data["speed"]["results"]
    assert stored["cylinder_over_bare_loop"] == loops["cylinder_ns"] / loops["straight_line_ns"]
    batch = data["environment_speed"]["results"]["all_cores"]
    machines, bare = (
        batch[name]["steps_per_s"]
        for name in (
            "`make_batch(64)`, residual on `static_feedforward`",
            "bare `mj_step`, without shapes, one process a core",
        )
    )
    assert stored["batch_of_bare_residual"] == pytest.approx(machines / bare, rel=1e-4)
    short = data["sweeps"]["results"]["knee bench, 1 s simulated"]
    assert stored["thousand_runs_s"] == 1000 * short["ways"]["two processes"]["wall"] / 1000
    # What the pages of docs keep can be drawn from; only what no file keeps is missing.
    unknown = {r.name for r in RATIOS} - stored.keys()
    assert {r.part for r in RATIOS if r.name in unknown} <= {
        "bsnn_arx_speed", "identification_peers", "leg_speed",
    }  # fmt: skip


def test_results_without_a_figure_give_no_ratio():
    empty = Measured(part="speed", record={"results": {"cylinder_ns": 1.0}}, tables="")
    assert values([empty]) == []
    failed = Measured(part="speed", record={}, tables="", problem="no compiler")
    assert values([failed]) == []


def test_a_ratio_that_is_ten_percent_worse_than_the_last_kept_ones_fails():
    entries = [entry(cylinder_over_bare_loop=x) for x in (9.0, 1.0, 1.1, 1.2, 1.3, 1.4)]
    assert kept_value(LOW, entries, "here") == 1.2  # of the last five
    assert not worse([Value(ratio=LOW, values=(1.31,))], entries, "here")
    (line,) = worse([Value(ratio=LOW, values=(1.33,))], entries, "here")
    assert line.startswith("cylinder_over_bare_loop: 1.33, 11 % worse than 1.2")
    entries = [entry(batch_of_bare_residual=0.8)]
    assert not worse([Value(ratio=HIGH, values=(0.73, 0.1, 0.9))], entries, "here")
    assert worse([Value(ratio=HIGH, values=(0.71,))], entries, "here")
    assert change(Value(ratio=HIGH, values=(0.88,)), 0.8) == pytest.approx(0.1)
    assert change(Value(ratio=LOW, values=(0.9,)), 1.0) == pytest.approx(0.1)


def test_figures_of_another_machine_are_not_compared():
    entries = [entry("there", thousand_runs_s=10.0, cylinder_over_bare_loop=1.0)]
    assert kept_value(SLOW, entries, "here") is None
    assert kept_value(SLOW, entries, "there") == 10.0
    assert kept_value(LOW, entries, "here") == 1.0


def test_the_history_keeps_a_line_a_commit_and_says_what_is_wrong_with_it(tmp_path):
    path = tmp_path / "h.jsonl"
    assert read_history(path) == []
    first = Entry(commit="abc", date="2026-11-22", machine="here", ratios={"a": 1.0})
    add(first, path)
    add(replace(first, ratios={"b": 2.0}, date="2026-11-23"), path)
    add(replace(first, commit="def"), path)
    assert [(e.commit, e.ratios) for e in read_history(path)] == [
        ("abc", {"a": 1.0, "b": 2.0}),
        ("def", {"a": 1.0}),
    ]
    path.write_text(path.read_text() + '{"commit": "x"}\n')
    with pytest.raises(LeglabError, match=r"h\.jsonl, line 3: is no entry"):
        read_history(path)


def test_the_kept_history_can_be_read_and_compared_with():
    entries = read_history()
    known = {ratio.name for ratio in RATIOS}
    assert entries
    assert all(e.ratios.keys() <= known for e in entries)


def test_tables_of_markdown_are_read():
    (table,) = markdown_tables("words\n| a `b` | c |\n|---|---|\n| 1 | 2 |\n| | 3 |\nend\n")
    assert (table.caption, list(table.head), list(table.rows)) == (
        "a b",
        ["a b", "c"],
        [["1", "2"], ["", "3"]],
    )


@pytest.mark.slow("a benchmark")
def test_a_part_is_measured_kept_and_shown(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(history, "FILE", (tmp_path / "h.jsonl"))
    out = tmp_path / "out"
    options = ("--part", "speed", "--repeat", "1", "--out", out)
    status, _, errors = command_line(capsys, *options, "--keep")
    assert (status, errors) == (0, "")
    content = json.loads((out / "bench.json").read_text())
    measured = content["ratios"]["cylinder_over_bare_loop"]
    assert measured["range"] == [measured["median"]] * 2
    results = content["parts"][0]["results"]
    assert measured["median"] == results["cylinder_ns"] / results["straight_line_ns"]
    page = (out / "bench.html").read_text()
    text = html.unescape(re.sub("<[^>]*>", " ", page))
    assert "0 of 0 ratios reach what is asked" in text
    assert "straight-line C++ loop" in text
    assert "t90 median, s" in text  # of what docs/data keeps
    assert "<script" not in page
    assert "script-src 'none'" in html.unescape(page)
    # From a history in which it was far better: the check fails, and says so.
    (kept,) = read_history(tmp_path / "h.jsonl")
    assert kept.ratios["cylinder_over_bare_loop"] == pytest.approx(measured["median"], rel=1e-3)
    add(replace(kept, ratios={"cylinder_over_bare_loop": 0.5}), tmp_path / "h.jsonl")
    check = ("--part", "speed", "--stored", "--check", "--out", out)
    status, _, errors = command_line(capsys, *check)
    assert status == 1
    assert "cylinder_over_bare_loop: " in errors


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--part", "sped"), "unknown part of the benchmark 'sped'.*did you mean 'speed'"),
        (("--repeat", "0"), "repeat is 0; allowed: 1 to 100"),
        (("--quick", "--keep"), "--keep is for figures of whole measurements"),
    ],
)
def test_what_cannot_be_measured_is_refused(tmp_path, capsys, options, message):
    status, _, errors = command_line(capsys, *options, "--out", tmp_path / "o")
    assert status == 2
    assert re.search(message, " ".join(errors.split()))
    assert not (tmp_path / "o").exists()


def test_a_part_that_fails_is_named_and_stops_nothing(tmp_path, monkeypatch):
    broken = Benchmark(name="speed", quick="--no-such-option")
    (found,) = suite.measure([broken], tmp_path, repeat=1, quick=True)
    assert found.record == {}
    assert "no-such-option" in found.problem
