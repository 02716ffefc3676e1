"""SIGKILL at random steps of a report and of a diagnosis: nothing half, and the next one works.

Sweeps have their thirty kills in `test_sweeps.py`. Here the process that writes is killed just
before it opens, moves or removes a file, at steps drawn by a seed.
"""

import multiprocessing
import os
import random
import shutil
import signal
import sys

from leglab.base.output import new_folder
from leglab.cli import main
from leglab.diagnosis.verdict.output import write_diagnosis
from leglab.report.diagnosis.page import write_page
from tests.helpers.made_up_diagnosis import diagnosis
from tests.helpers.report_folders import write_folder

# What Python tells of before it does it, of a path first.
_STEPS = {"open", "os.rename", "os.mkdir", "os.rmdir", "os.remove", "os.chmod"}


def _ends(command, place, last, steps):
    """Runs a command, killed before its step number `last` below a folder; tells how many."""
    for stream in (1, 2):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)

    def watch(event, arguments):
        if event in _STEPS and str(arguments[0]).startswith(str(place)):
            steps.value += 1
            if steps.value == last:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(watch)
    command()


def steps_of(command, place, last=-1):
    """Runs a command in a process of its own; returns the steps that it took, and its status."""
    context = multiprocessing.get_context("fork")
    steps = context.Value("i", 0)
    process = context.Process(target=_ends, args=(command, place, last, steps))
    process.start()
    process.join()
    return steps.value, process.exitcode


def content(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def hidden(folder):
    return [path.name for path in folder.rglob(".*")]


def test_a_report_that_is_killed_is_written_by_the_same_command(tmp_path):
    run, chance = write_folder(tmp_path / "run"), random.Random(7)
    page = run / "report.html"

    def report():
        main(["report", str(run), "--no-video", "--overwrite"])

    count, status = steps_of(report, run)
    assert status == 0
    whole = page.read_bytes()
    for last in (chance.randint(1, count), count):
        before = chance.choice((b"an earlier page", whole))
        page.write_bytes(before)
        assert steps_of(report, run, last)[1] == -signal.SIGKILL
        assert page.read_bytes() in (before, whole)
    page.write_bytes(b"an earlier page")
    assert steps_of(report, run)[1] == 0
    assert page.read_bytes() == whole
    assert hidden(run) == []


def test_a_diagnosis_that_is_killed_while_it_is_written_is_made_anew(tmp_path, monkeypatch):
    # As `leglab diagnose` writes; the result is made up by hand, and no picture is drawn.
    monkeypatch.setattr("leglab.report.diagnosis.page.pictures", lambda _: [])
    chance, out, result = random.Random(3), tmp_path / "out", diagnosis()

    def write():
        with new_folder(out, mark="diagnosis.json", made=(), overwrite=True) as partial:
            write_diagnosis(result, partial)
            write_page(result, partial, model="knee_bench")

    count, status = steps_of(write, tmp_path)
    assert (status, hidden(tmp_path)) == (0, [])
    whole = content(out)
    shutil.rmtree(out)
    for number in range(10):
        there = number >= 5
        if number == 5:
            assert steps_of(write, tmp_path)[1] == 0
        assert steps_of(write, tmp_path, chance.randint(1, count))[1] == -signal.SIGKILL
        place = tmp_path / ".out.earlier" if there and not out.exists() else out
        assert place.exists() or not there
        if place.exists():
            assert content(place) == whole
    assert steps_of(write, tmp_path)[1] == 0
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
