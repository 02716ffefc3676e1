"""docs/data: what every file says of itself, and the one command that makes all of them."""

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FILES = sorted((ROOT / "docs" / "data").glob("*.json"))


@pytest.fixture(autouse=True)
def _benchmarks(monkeypatch):
    """Scripts of benchmarks/ are no package: they find each other beside themselves."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_file_says_where_its_results_come_from(path):
    from make_results import JOBS
    from results import RECORD

    record = json.loads(path.read_text())
    absent = [name for name in RECORD if name not in record]
    assert not absent, f"{path.name} has no {', '.join(absent)}: make results"
    program, script, *options = shlex.split(record["command"])
    assert program == "python"
    assert (ROOT / script).is_file()
    (job,) = [job for job in JOBS if job.name == path.stem]
    assert shlex.split(job.command)[:-2] == [program, script, *options], "not by `make results`"
    assert re.fullmatch(r"\d{4}-\d{2}-\d{2}", record["date"])
    assert {"leglab", "mujoco", "numpy"} <= record["versions"].keys()
    assert re.fullmatch(r"[0-9a-f]{7,40}\+?", record["commit"])
    assert re.fullmatch(r"\d+ cores, load [\d.]+ before, [\d.]+ after", record["machine"])


def test_make_results_makes_every_file_once():
    from make_results import JOBS

    assert sorted(job.name for job in JOBS) == [path.stem for path in FILES]
    for job in JOBS:
        _, script, *_, option, target = shlex.split(job.command)
        assert (ROOT / script).is_file()
        assert option == "--write"
        assert (ROOT / target).is_file()
        assert job.minutes > 0


def test_jobs_are_listed_with_their_minutes():
    done = subprocess.run(
        [sys.executable, "benchmarks/make_results.py", "--list"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert "`python benchmarks/speed.py --write docs/data/speed.json`" in done.stdout


def test_a_job_that_is_not_known_is_refused(monkeypatch, capsys):
    import make_results

    monkeypatch.setattr(sys, "argv", ["make_results.py", "speeed"])
    with pytest.raises(SystemExit):
        make_results.main()
    assert "speeed: allowed are speed" in capsys.readouterr().err


def test_kept_results_name_command_commit_and_both_loads(monkeypatch):
    import results

    loads = iter([0.25, 1.5])
    monkeypatch.setattr("os.getloadavg", lambda: (next(loads), 9.0, 9.0))
    origin = results.origin_of("python benchmarks/speed.py")
    record = results.kept(origin, {"ns": 1 / 3, "lost": float("nan")})
    assert record["command"] == "python benchmarks/speed.py"
    assert re.fullmatch(r"\d+ cores, load 0.2 before, 1.5 after", record["machine"])
    assert record["results"] == {"ns": 0.333333, "lost": None}
    line = results.origin_line(record)
    assert line.startswith(f"`python benchmarks/speed.py`, {record['date']}, commit ")
    assert record["commit"] in line
    assert line.endswith("load 0.2 before, 1.5 after.")


def test_commit_marks_changed_code_alone(tmp_path):
    import results

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
