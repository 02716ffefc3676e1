"""Output: whole or not at all, by one process at a time, whatever kills or fills the disk."""

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from html import unescape
from pathlib import Path

import pytest

from leglab import data
from leglab.base.errors import LeglabError
from leglab.base.output import claimed_folder, new_file, new_folder, write_atomically
from leglab.runs.folder import default_folder
from leglab.runs.preparation import RunSettings
from tests.cli.test_cli import leglab
from tests.helpers.made_up_diagnosis import diagnosis
from tests.helpers.report_folders import write_folder

RUN = ("run", "nominal", "--model", "knee_bench", "--duration", "2", "--no-figures")
BENCH = Path(__file__).parents[1] / "data" / "knee_bench_walk.parquet"


def start(*arguments, cwd, **options) -> subprocess.Popen:
    """Starts a command as a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "leglab", *map(str, arguments)],
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def wait_for(condition, process: subprocess.Popen) -> None:
    """Waits until a process has come so far."""
    end = time.monotonic() + 60
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.005)


def hidden(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.name.startswith("."))


def test_of_two_runs_into_one_folder_the_second_is_told_by_whom(tmp_path):
    arguments = (*RUN, "--duration", "20", "--out", "a", "--overwrite", "--seed")
    first = start(*arguments, 1, cwd=tmp_path)
    lock = tmp_path / ".a.lock"
    # Whoever holds it writes who that is.
    wait_for(lambda: lock.exists() and lock.stat().st_size, first)
    first.send_signal(signal.SIGSTOP)
    try:
        second = start(*arguments, 2, cwd=tmp_path)
        told = second.communicate()[1]
    finally:
        first.send_signal(signal.SIGCONT)
    assert second.returncode == 2
    assert f"error: a: process {first.pid} on " in told
    assert (first.communicate()[1], first.returncode) == ("", 0)
    assert json.loads((tmp_path / "a" / "run.json").read_text())["settings"]["seed"] == 1
    assert hidden(tmp_path) == []


def test_a_place_is_claimed_before_any_work_and_the_owner_is_named(tmp_path):
    with (
        new_folder(tmp_path / "a", mark="m", made=()) as partial,
        pytest.raises(LeglabError, match=rf"a: process {os.getpid()} on .* is writing it; wait"),
        new_folder(tmp_path / "a", mark="m", made=()),
    ):
        pass
    assert not partial.exists()
    with (
        claimed_folder(tmp_path / "b"),
        pytest.raises(LeglabError, match="b: process"),
        claimed_folder(tmp_path / "b"),
    ):
        pass
    with (
        new_file(tmp_path / "c.mp4") as partial,
        pytest.raises(LeglabError, match=r"c\.mp4: process"),
        new_file(tmp_path / "c.mp4"),
    ):
        pass
    assert partial.suffix == ".mp4"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "c.mp4"]


def test_a_run_that_is_told_no_folder_has_one_for_what_decides_it():
    names = {
        str(default_folder(RunSettings(scenario="seal_wear", **settings)))
        for settings in (
            {},
            {"severity": 2.0},
            {"ramp_duration": 0.5},
            {"reference": "step"},
            {"duration": 3.0},
            {"tolerance": 0.1},
            {"tolerance": 0.1 + 1e-12},
            {"timestep": 1e-4},
            {"vary": True},
        )
    }
    assert len(names) == 9
    assert "runs/seal_wear-pd-leg-0" in names
    assert "runs/seal_wear-pd-leg-0-severity2" in names


@pytest.mark.slow("a killed process")
def test_a_killed_run_leaves_nothing_that_hinders_the_next(tmp_path):
    process = start(*RUN, "--out", "a", cwd=tmp_path)
    wait_for(lambda: any(name.endswith(".partial") for name in hidden(tmp_path)), process)
    process.kill()
    process.communicate()
    assert not (tmp_path / "a").exists()
    assert hidden(tmp_path)
    again = start(*RUN, "--out", "a", cwd=tmp_path)
    assert again.communicate()[1] == ""
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_an_earlier_folder_stays_until_the_new_one_is_whole(tmp_path):
    folder = tmp_path / "a"
    folder.mkdir()
    (folder / "m").write_text("earlier")
    (folder / "page.html").write_text("earlier")
    (folder / "own" / "deep").mkdir(parents=True)
    (folder / "own" / "deep" / "notes").write_text("kept")
    kind = {"mark": "m", "made": ("page.html", "plot.png")}
    with pytest.raises(KeyboardInterrupt), new_folder(folder, **kind, overwrite=True):
        raise KeyboardInterrupt
    assert (folder / "m").read_text() == "earlier"
    # A kill between the two renames.
    folder.rename(tmp_path / ".a.earlier")
    with pytest.raises(LeglabError, match="exists"), new_folder(folder, **kind):
        pass
    assert (folder / "m").read_text() == "earlier"
    with new_folder(folder, **kind, overwrite=True) as partial:
        (partial / "m").write_text("new")
    assert (folder / "m").read_text() == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    # What the user put beside the results stays; pages and plots of the earlier ones go.
    assert sorted(path.name for path in folder.iterdir()) == ["m", "own"]
    assert (folder / "own" / "deep" / "notes").read_text() == "kept"


def test_a_path_that_ends_above_the_folder_does_not_empty_it(tmp_path, capsys):
    (tmp_path / "prev" / "sub").mkdir(parents=True)
    (tmp_path / "prev" / "metrics.json").write_text("{}")
    (tmp_path / "prev" / "notes").write_text("kept")
    status, _, told = leglab(
        *RUN, "--out", tmp_path / "prev" / "sub" / "..", "--overwrite", capsys=capsys
    )
    assert status == 0, told
    assert (tmp_path / "prev" / "recording.parquet").exists()
    assert (tmp_path / "prev" / "notes").read_text() == "kept"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["prev"]


def test_the_working_folder_is_not_replaced(tmp_path, capsys, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for out in (".", ".."):
        status, _, told = leglab(*RUN, "--out", out, capsys=capsys)
        assert (status, told) == (
            2,
            f"error: output folder '{out}' exists; remove it or give --overwrite\n",
        )
    status, _, told = leglab(*RUN, "--out", ".", "--overwrite", capsys=capsys)
    assert (status, told) == (
        2,
        "error: '.' is or holds the working folder: give another one\n",
    )


def test_a_link_to_a_folder_stays_a_link(tmp_path, capsys):
    write_folder(tmp_path / "real")
    (tmp_path / "link").symlink_to("real")
    status, _, told = leglab(*RUN, "--out", tmp_path / "link", "--overwrite", capsys=capsys)
    assert status == 0, told
    assert (tmp_path / "link").is_symlink()
    assert json.loads((tmp_path / "real" / "metrics.json").read_text())["scenario"] == "nominal"


def test_a_place_that_cannot_be_written_is_said_before_the_run(tmp_path, capsys, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr("leglab.runs.run.Loop", lambda settings: pytest.fail("it ran"))
    for out in (tmp_path / "file" / "a", tmp_path / ("n" * 300)):
        status, _, told = leglab(*RUN, "--out", out, capsys=capsys)
        assert status == 2
        assert told.count("\n") == 1
        assert "cannot be written: " in told


@pytest.mark.parametrize("name", ["thesis.txt", "film.mp4"])
def test_a_film_replaces_films_alone(tmp_path, capsys, name):
    folder = write_folder(tmp_path / "a")
    (tmp_path / name).write_text("three years of work")
    status, _, told = leglab("video", folder, "--out", tmp_path / name, capsys=capsys)
    assert status == 2
    assert told.count("\n") == 1
    assert (tmp_path / name).read_text() == "three years of work"
    assert hidden(tmp_path) == []


def test_pipes_and_devices_are_not_replaced(tmp_path, capsys):
    os.mkfifo(tmp_path / "pipe.csv")
    status, _, told = leglab("convert", BENCH, tmp_path / "pipe.csv", "--overwrite", capsys=capsys)
    assert (status, told) == (
        2,
        f"error: {tmp_path}/pipe.csv: cannot be written: it is no regular file\n",
    )
    assert (tmp_path / "pipe.csv").is_fifo()
    os.mkfifo(tmp_path / "film.mp4")
    status, _, told = leglab(
        "video", write_folder(tmp_path / "a"), "--out", tmp_path / "film.mp4", capsys=capsys
    )
    assert status == 2
    assert told.endswith("film.mp4: cannot be written: it is no regular file\n")


def test_a_link_to_a_file_stays_a_link(tmp_path):
    (tmp_path / "real").write_text("earlier")
    (tmp_path / "link").symlink_to("real")
    write_atomically(tmp_path / "link", lambda stream: stream.write(b"new"))
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_text() == "new"


@pytest.mark.slow("a killed process")
def test_what_a_killed_report_left_goes_with_the_next(tmp_path):
    folder = write_folder(tmp_path / "a")
    code = (
        "import sys, time; from pathlib import Path; import leglab.report.film as film;"
        "film.render_film = lambda folders, path, **_: (path.write_bytes(b'x'), time.sleep(60));"
        f"from leglab.cli import main; main(['report', {str(folder)!r}])"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)
    wait_for(
        lambda: any(".report.mp4" in str(p) or p.name == "report.mp4" for p in folder.glob(".*/*")),
        process,
    )
    process.kill()
    process.wait()
    assert hidden(folder)
    done = start("report", folder, "--no-video", cwd=tmp_path)
    assert done.communicate()[1] == ""
    assert hidden(folder) == []
    assert (folder / "report.html").exists()


def test_a_diagnosis_that_breaks_off_leaves_no_folder(tmp_path, capsys, monkeypatch):
    def full(*_, **__):
        raise LeglabError("x: cannot be written: No space left on device")

    monkeypatch.setattr("leglab.diagnosis.verdict.output.write_diagnosis", full)
    monkeypatch.setattr(
        "leglab.diagnosis.verdict.verdict.diagnose", lambda *_, **__: (diagnosis(model=""), None)
    )
    monkeypatch.setattr("leglab.diagnosis.improve.improved_model", lambda *_: None)
    monkeypatch.setattr("leglab.report.diagnosis.page.write_page", lambda *_, **__: None)
    shutil.copy(BENCH, tmp_path / "one.parquet")
    shutil.copy(BENCH, tmp_path / "two.parquet")
    recordings = (tmp_path / "one.parquet", tmp_path / "two.parquet")
    arguments = ("diagnose", "knee_bench", *recordings, "--out", tmp_path / "out")
    for _ in range(2):
        status, _, told = leglab(*arguments, capsys=capsys)
        assert (status, told) == (2, "error: x: cannot be written: No space left on device\n")
        assert not (tmp_path / "out").exists()
        assert hidden(tmp_path) == []


class _Better:
    learned, errors = "", ()

    def write(self, folder):
        raise LeglabError("improved.xml: the model is refused")


def test_what_cannot_be_made_costs_no_diagnosis(tmp_path, capsys, monkeypatch):
    def broken(*_, **__):
        raise KeyError("channel")

    monkeypatch.setattr(
        "leglab.diagnosis.verdict.verdict.diagnose", lambda *_, **__: (diagnosis(model=""), None)
    )
    monkeypatch.setattr("leglab.diagnosis.improve.improved_model", lambda *_: _Better())
    monkeypatch.setattr("leglab.report.diagnosis.figures.gap_picture", broken)
    broken.__name__ = "gap_picture"
    shutil.copy(BENCH, tmp_path / "one.parquet")
    out = tmp_path / "out"
    status, shown, _ = leglab(
        "diagnose", "knee_bench", tmp_path / "one.parquet", "--out", out, capsys=capsys
    )
    assert status == 0
    missing = {
        "improved.xml": "the model is refused",
        "figures/gap*.png": "KeyError: 'channel'",
    }
    kept = json.loads((out / "diagnosis.json").read_text())
    assert kept["missing"] == missing
    assert (kept["model"], kept["verdict"]) == (None, "named")
    assert not (out / "improved.xml").exists()
    assert (out / "figures" / "ranking.png").exists()
    page = (out / "diagnosis.html").read_text()
    for name, reason in missing.items():
        told = f"{name} is missing: {reason}"
        assert told in " ".join(shown.split())
        assert told in unescape(page)
    monkeypatch.setattr("leglab.report.diagnosis.page.write_page", broken)
    again = ("diagnose", "knee_bench", tmp_path / "one.parquet", "--out", out, "--overwrite")
    assert leglab(*again, capsys=capsys)[0] == 0
    assert "diagnosis.html" in json.loads((out / "diagnosis.json").read_text())["missing"]


def test_a_folder_with_the_recordings_is_not_replaced(tmp_path, capsys):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "diagnosis.json").write_text("{}")
    shutil.copy(BENCH, tmp_path / "out" / "one.parquet")
    status, _, told = leglab(
        *("diagnose", "knee_bench", tmp_path / "out" / "one.parquet"),
        *("--out", tmp_path / "out", "--overwrite"),
        capsys=capsys,
    )
    assert status == 2
    assert "one.parquet lies in the output folder" in told


def test_a_full_disk_leaves_the_earlier_file(tmp_path):
    recording = data.read(BENCH)
    data.write(recording, tmp_path / "a.csv")
    before = (tmp_path / "a.csv").read_bytes()
    code = f"from leglab import data; data.write(data.read({str(BENCH)!r}), 'a.csv')"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        preexec_fn=_little_space,
    )
    assert "FileError: a.csv: cannot be written: File too large" in done.stderr
    assert (tmp_path / "a.csv").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]


def _little_space() -> None:
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
