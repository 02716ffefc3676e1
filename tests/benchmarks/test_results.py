"""The registry of benchmarks, and docs/data: what every file says of itself."""

import json
import re
import subprocess
import sys

import numpy as np
import pytest

from benchmarks import __main__ as command_line
from benchmarks import results
from benchmarks.registry import BENCHMARKS, DATA, shown

FILES = sorted(DATA.glob("*.json"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_file_says_where_its_results_come_from(path):
    record = json.loads(path.read_text())
    absent = [name for name in results.RECORD if name not in record]
    assert not absent, f"{path.name} has no {', '.join(absent)}: make results"
    assert record["command"] == BENCHMARKS[path.stem].command, "not by `make results`"
    assert re.fullmatch(r"\d{4}-\d{2}-\d{2}", record["date"])
    assert {"leglab", "mujoco", "numpy"} <= record["versions"].keys()
    assert re.fullmatch(r"[0-9a-f]{7,40}\+?", record["commit"])
    assert re.fullmatch(r"\d+ cores, load [\d.]+ before, [\d.]+ after", record["machine"])


def test_every_file_is_of_a_benchmark_and_shown():
    kept = [one for one in BENCHMARKS.values() if one.kept]
    assert sorted(one.file for one in kept) == FILES
    # What no page shows is a ratio of `bench`.
    assert {one.name for one in kept} - shown().keys() == {"diagnosis_rollouts"}
    assert BENCHMARKS["diagnosis_rollouts"].quick
    assert shown().keys() <= BENCHMARKS.keys()
    assert all(one.minutes for one in kept)


def test_every_script_can_be_run_by_its_name():
    scripts = {p for p in DATA.parents[1].glob("benchmarks/*.py") if p.stem[0] != "_"}
    helpers = {
        *("adaptation_faults", "data_sets", "measured", "registry", "results", "specimens"),
        *("simulated_machines", "structure_peers"),
    }
    assert {one.path for one in BENCHMARKS.values()} == {
        p for p in scripts if p.stem not in helpers
    }
    for path in {one.path for one in BENCHMARKS.values()}:
        assert re.search(r"^def (main|measure)\(", path.read_text(), re.MULTILINE), path.name


def command(monkeypatch, capsys, *words):
    """Status and what is printed."""
    monkeypatch.setattr(sys, "argv", ["benchmarks", *words])
    status = 0
    try:
        command_line.main()
    except SystemExit as ended:
        status = ended.code or 0
    return status, *capsys.readouterr()


def test_benchmarks_are_listed_with_minutes_and_files(monkeypatch, capsys):
    _, out, _ = command(monkeypatch, capsys)
    assert re.search(r"^speed +0\.2 min +docs/data/speed\.json +One cylinder's update", out, re.M)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["speeed"], "unknown benchmark 'speeed'.*did you mean 'speed'"),
        (["results", "speeed"], "unknown benchmark 'speeed'"),
        (["results", "speed", "soak"], "docs/data keeps no soak"),
        (["adaptation_tables", "long"], "no table 'long'; allowed: short, "),
    ],
)
def test_what_cannot_be_run_is_refused(monkeypatch, capsys, words, message):
    status, _, errors = command(monkeypatch, capsys, *words)
    assert status == 2
    assert re.search(message, " ".join(errors.split()))


def test_kept_results_name_command_commit_and_both_loads(monkeypatch, capsys, tmp_path):
    loads = iter([0.25, 1.5])
    monkeypatch.setattr("os.getloadavg", lambda: (next(loads), 9.0, 9.0))
    monkeypatch.setattr(
        "benchmarks.never_worse.measure",
        lambda options: {"ns": options.specimens / 3, "lost": np.nan},
    )
    monkeypatch.setattr("benchmarks.never_worse.tables", lambda found: f"{found['ns']:.3f}")
    file = tmp_path / "kept.json"
    words = ("never_worse", "--specimens", "1")
    _, out, _ = command(monkeypatch, capsys, *words, "--write", str(file))
    record = json.loads(file.read_text())
    assert record["command"] == "python -m benchmarks never_worse --specimens 1"
    assert re.fullmatch(r"\d+ cores, load 0.2 before, 1.5 after", record["machine"])
    assert record["results"] == {"ns": 0.333333, "lost": None}
    line = out.splitlines()[-1]
    assert out.startswith("0.333\n")
    assert line.startswith(f"`{record['command']}`, {record['date']}, commit {record['commit']}")
    assert line.endswith("load 0.2 before, 1.5 after.")
    _, again, _ = command(monkeypatch, capsys, "never_worse", "--render", str(file))
    assert again == out


def test_commit_marks_changed_code_alone(tmp_path):
    def git(*words):
        who = ("-c", "user.name=a", "-c", "user.email=a@b")
        subprocess.run(["git", "-C", tmp_path, *who, *words], check=True, capture_output=True)

    assert results.commit(tmp_path) == "unknown"
    git("init")
    (tmp_path / "leglab").mkdir()
    (tmp_path / "leglab" / "code.py").write_text("1\n")
    git("add", ".")
    git("commit", "-m", "Add code")
    clean = results.commit(tmp_path)
    assert re.fullmatch("[0-9a-f]{10}", clean)
    (tmp_path / "notes.md").write_text("no code\n")
    assert results.commit(tmp_path) == clean
    assert results.commit(tmp_path / "leglab") == "unknown"
    (tmp_path / "leglab" / "code.py").write_text("2\n")
    assert results.commit(tmp_path) == f"{clean}+"
