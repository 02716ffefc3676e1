"""`leglab report` and `leglab index`: what they write, and what they say where they cannot."""

import html
import json
import re
import resource

import pytest

from leglab.runs import folder as run_folders
from leglab.runs.run import record_scenario
from tests.cli.test_cli import leglab
from tests.helpers.comparison_folders import write_comparison
from tests.helpers.report_folders import Elements, write_folder


def test_a_full_disk_leaves_nothing_half_written(tmp_path, capsys):
    folder = write_folder(tmp_path / "a")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, hard))
    try:
        status, _, told = leglab(
            "report", folder, "--no-video", "--out", tmp_path / "out", capsys=capsys
        )
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert status == 2
    assert re.search(r"error: .*report\.html: cannot be written: File too large\n$", told)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda f: (f / "run.json").unlink(), "is not the folder of a run: it has no run.json"),
        (lambda f: (f / "metrics.json").write_text("{"), "metrics.json: cannot be read"),
        (lambda f: (f / "metrics.json").write_text("[" * 100000), "metrics.json: cannot be read"),
        (lambda f: (f / "run.json").write_text("{}"), "run.json: settings: field required"),
        (lambda f: (f / "recording.parquet").write_text("x"), "recording.parquet"),
    ],
)
def test_a_folder_that_is_no_run_gets_one_line(tmp_path, capsys, spoil, told):
    folder = write_folder(tmp_path / "a")
    spoil(folder)
    status, _, error = leglab("report", folder, "--no-video", capsys=capsys)
    assert status == 2
    assert told in error
    assert error.count("\n") == 1
    assert not (folder / "report.html").exists()


def test_the_command_writes_beside_the_run_and_replaces_only_when_asked(tmp_path, capsys):
    folder = write_folder(tmp_path / "a", stopped=8.0)
    status, out, told = leglab("report", folder, "--no-video", "--json", capsys=capsys)
    assert status == 0
    content = json.loads(out)
    assert content["page"] == str(folder / "report.html")
    assert content["runs"][0]["rms_rad"] == {"before": 0.02, "after": 0.03}
    assert "warning: pd stopped early: the knee blew up" in told
    first = (folder / "report.html").read_bytes()
    status, _, told = leglab("report", folder, "--no-video", capsys=capsys)
    assert (status, "--overwrite" in told) == (2, True)
    assert leglab("report", folder, "--no-video", "--overwrite", capsys=capsys)[0] == 0
    assert (folder / "report.html").read_bytes() == first  # same run, same bytes


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ((), "needs the folder of at least one run, or --scenario"),
        (("x", "--seed", "1"), "--seed says what to run: it needs --scenario"),
        (("x", "--scenario", "nominal"), "not both"),
        (("--scenario", "nominl"), "did you mean 'nominal'"),
        (("--scenario", "nominal", "--controllers", "pd,pd"), "'pd' is given twice"),
        (("--scenario", "nominal", "--controllers", "pdd"), "unknown controller 'pdd'"),
        (("--scenario", "nominal", "--jobs", "0"), "jobs is 0"),
    ],
)
def test_bad_requests_get_one_line(tmp_path, capsys, monkeypatch, arguments, told):
    monkeypatch.chdir(tmp_path)
    status, _, error = leglab("report", *arguments, capsys=capsys)
    assert status == 2
    assert told in error
    assert not list(tmp_path.iterdir())


def test_a_scenario_is_run_once_and_reported(tmp_path, capsys, monkeypatch):
    calls = []

    def counted(settings, path):
        calls.append(settings.controller)
        return record_scenario(settings, path)

    monkeypatch.setattr(run_folders, "record_scenario", counted)
    command = ["report", "--scenario", "seal_wear", "--model", "knee_bench", "--duration", "4"]
    command += ["--jobs", "1", "--no-video", "--out", tmp_path / "out", "--json", "--controllers"]
    status, out, _ = leglab(*command, "pd", capsys=capsys)
    assert status == 0
    metrics = json.loads((tmp_path / "out" / "runs" / "pd" / "metrics.json").read_text())
    assert json.loads(out)["runs"][0]["rms_rad"] == {
        phase["name"]: phase["rms_rad"]["all"] for phase in metrics["phases"]
    }
    kept = (tmp_path / "out" / "runs" / "pd" / "run.json").stat().st_mtime_ns
    assert leglab(*command, "pd,static_feedforward", capsys=capsys)[0] == 0
    assert calls == ["pd", "static_feedforward"]
    assert (tmp_path / "out" / "runs" / "pd" / "run.json").stat().st_mtime_ns == kept
    # Half a folder is made again, and so is one with other settings.
    (tmp_path / "out" / "runs" / "pd" / "recording.parquet").unlink()
    assert leglab(*command, "pd", capsys=capsys)[0] == 0
    assert leglab(*command, "pd", "--seed", "1", capsys=capsys)[0] == 0
    assert calls == ["pd", "static_feedforward", "pd", "pd"]


def test_the_index_lists_what_is_there_whole_or_not(tmp_path, capsys):
    write_folder(tmp_path / "whole run")
    write_folder(tmp_path / "deep" / "#half%41", "arx", stopped=3.0)
    (write_folder(tmp_path / "cut") / "recording.parquet").unlink()
    (write_folder(tmp_path / "bad") / "metrics.json").write_text("{}")
    write_folder(tmp_path / ".new.partial")
    write_comparison(tmp_path / "compare")
    (tmp_path / "diagnosis").mkdir()
    (tmp_path / "diagnosis" / "diagnosis.json").write_text(
        json.dumps({"verdict": "named", "effects": [{"name": "payload", "element": "<b>"}]})
    )
    assert leglab("report", tmp_path / "whole run", "--no-video", capsys=capsys)[0] == 0
    status, out, told = leglab("index", tmp_path, capsys=capsys)
    assert status == 0
    assert "7 listed" in out
    assert "3 of 7 cannot be read" in told
    text = (tmp_path / "index.html").read_text()
    shown = " ".join(" ".join(Elements(text).texts).split())
    assert "1 comparison, 1 diagnosis, 5 runs; 1 stopped half way; 3 cannot be read." in shown
    assert "stopped at 3.00 s: the knee blew up" in shown
    assert "has no recording.parquet" in shown
    assert "metrics.json: scenario: field required" in shown
    assert "was not written to its end" in shown
    assert "named: payload at <b>" in shown
    links = {a["href"] for a in Elements(text).all("a")}
    assert "./whole%20run/report.html" in links
    assert "./deep/%23half%2541/metrics.json" in links
    # Again, over its own page; but not over another.
    assert leglab("index", tmp_path, capsys=capsys)[0] == 0
    (tmp_path / "other.html").write_text("mine")
    status, _, told = leglab("index", tmp_path, "--out", tmp_path / "other.html", capsys=capsys)
    assert status == 2
    assert "is no index of leglab" in told
    assert leglab("index", tmp_path / "none", capsys=capsys)[0] == 2


def test_the_index_escapes_names_of_folders(tmp_path, capsys):
    name = html.escape("x") + "<img src=x onerror=hit()>"
    write_folder(tmp_path / name, "<script>hit()</script>")
    assert leglab("index", tmp_path, capsys=capsys)[0] == 0
    elements = Elements((tmp_path / "index.html").read_text())
    assert not elements.all("img")
    assert len(elements.all("script")) == 2
    assert any(name in text for text in elements.texts)
