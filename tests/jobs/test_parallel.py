"""Processes that work: they end with their user, take no code from where he is, and may fail."""

import os
import signal
import subprocess
import sys
import time

import pytest

from leglab.base.errors import LeglabError, SettingsError, SimulationError
from leglab.jobs.engine import Results, executor, make_missing
from leglab.jobs.work import WorkError, name_of, work_of

# Slow enough to be interrupted, and told by a file of its own that it has begun.
_SLEEP = """
import os, sys, time
from pathlib import Path
from leglab.jobs.engine import executor

def make(given):
    Path(f"begun-{os.getpid()}").touch()
    time.sleep(30)

if __name__ == "__main__":
    from leglab.cli import app
    import typer
    command = typer.Typer(cls=app.Commands)
    command.callback()(lambda: None)
    @command.command("work")
    def work():
        with executor(make, 2) as answered:
            list(answered(iter([(1, {}), (2, {})])))
    app.execute(command, ["work"])
"""


def alive(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat") as stream:
            return stream.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL, signal.SIGINT, signal.SIGHUP])
def test_workers_end_with_the_process_that_started_them(tmp_path, number):
    (tmp_path / "main.py").write_text(_SLEEP)
    process = subprocess.Popen(
        [sys.executable, "main.py"], cwd=tmp_path, stderr=subprocess.PIPE, text=True
    )
    end = time.monotonic() + 60
    while len(begun := list(tmp_path.glob("begun-*"))) < 2:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.02)
    process.send_signal(number)
    started = time.monotonic()
    told = process.communicate(timeout=10)[1]  # as long as anybody holds the stream
    workers = [int(path.name.removeprefix("begun-")) for path in begun]
    while any(map(alive, workers)):
        assert time.monotonic() - started < 10
        time.sleep(0.05)
    if number == signal.SIGINT:
        assert told.endswith("interrupted\n")
        assert process.returncode == 130
    elif number != signal.SIGKILL:
        assert (process.returncode, told) == (128 + number, "")


_SUM = """
from leglab.jobs.engine import executor

def size(given):
    return abs(given["x"])

if __name__ == "__main__":
    with executor(size, 2) as answered:
        found = answered((n, {"x": n}) for n in (-1, 2))
        print(sum(answer["result"] for _, answer, _ in found))
"""


def test_workers_do_not_run_code_of_the_working_folder(tmp_path):
    here = tmp_path / "here"
    for name in ("typing_extensions", "leglab", "numpy"):
        (here / name).mkdir(parents=True)
        (here / name / "__init__.py").write_text("open('ran', 'w'); raise SystemExit('ran')")
    (tmp_path / "main.py").write_text(_SUM)
    command = [sys.executable, "-P", str(tmp_path / "main.py")]
    done = subprocess.run(command, cwd=here, capture_output=True, text=True, check=False)
    assert (done.stdout, done.returncode) == ("3\n", 0), done.stderr
    assert not (here / "ran").exists()


def odd(given):
    """Fails in the way that it is told to."""
    kind = given["kind"]
    if kind == "dies":
        os.kill(os.getpid(), signal.SIGKILL)
    if kind == "hangs":
        time.sleep(60)
    if kind == "raises":
        raise ZeroDivisionError("by nought")
    if kind == "refuses":
        raise SettingsError("size is 3; allowed: ", given=3, allowed=("1", "2"))
    if kind == "says how":
        raise WorkError("ended early", "it blew up")
    if kind == "is infinite":
        return float("inf")
    return {"kind": kind, "process": os.getpid(), "threads": os.environ.get("OMP_NUM_THREADS")}


def answers(work, given, workers=-1, **terms):
    """All answers."""
    with executor(work, workers, **terms) as answered:
        return list(answered(iter(given)))


KINDS = ("dies", "hangs", "raises", "refuses", "says how", "is infinite", "works", "works")


def test_whatever_work_does_the_rest_is_done():
    given = ((number, {"kind": kind}) for number, kind in enumerate(KINDS))
    found = {n: answer for n, answer, _ in answers(odd, given, workers=2, timeout=5.0)}
    told = {KINDS[n]: (a["kind"], a["error"]) for n, a in found.items() if "error" in a}
    assert told["dies"][0] == "died"
    assert "signal 9 SIGKILL" in told["dies"][1]
    assert told["hangs"] == ("time-out", "it took longer than 5 s")
    kind, message = told["raises"]
    assert kind == "exception"
    assert message.startswith("ZeroDivisionError: by nought (test_parallel.py, line ")
    assert told["refuses"] == ("refused", "size is 3; allowed: 1, 2")
    assert told["says how"] == ("ended early", "it blew up")
    assert told["is infinite"] == ("ended early", "its figures are not finite")
    for number in (6, 7):
        result = found[number]["result"]
        assert result["kind"] == "works"
        assert result["process"] != os.getpid()
        assert result["threads"] == "1"
        assert found[number]["wall_s"] >= 0.0


def test_an_error_keeps_its_class_and_attributes_on_the_way_from_a_process():
    kept, kinds = Results({}, lambda _, result: result), {"a": "refuses", "b": "dies"}
    problems = make_missing(executor(odd, 2), ["a", "b"], kept, lambda key: {"kind": kinds[key]})
    told = {key: (type(error), error.given, error.allowed) for key, error in problems.items()}
    assert told == {"a": (SettingsError, 3, ("1", "2")), "b": (SimulationError, None, None)}


def test_one_worker_is_this_process_and_may_do_what_has_no_name():
    seen = []
    found = answers(lambda given: seen.append(given), [(7, {"a": 1})], workers=1)
    assert [(number, answer["result"]) for number, answer, _ in found] == [(7, None)]
    assert seen == [{"a": 1}]
    ((_, answer, _),) = answers(odd, [(0, {"kind": "raises"})], workers=1)
    assert answer["kind"] == "exception"
    with pytest.raises(LeglabError, match="cannot be called by another process"):
        executor(lambda given: None, 2)


def test_work_has_a_name_by_which_other_processes_find_it(tmp_path):
    assert name_of(odd) == f"{__name__}:odd"
    assert work_of(name_of(odd)) is odd
    script = tmp_path / "some_script.py"
    script.write_text("def make(given):\n    return 2 * given['x']\n")
    assert work_of(f"{script}:make")({"x": 4}) == 8
    with pytest.raises(LeglabError, match=r"some_script.py has no function 'mend'"):
        work_of(f"{script}:mend")


def test_workers_go_without_a_scheduler():
    with pytest.raises(LeglabError, match="workers are processes of this machine"):
        executor(odd, 2, "tcp://127.0.0.1:1")


def test_what_is_missing_is_made_once_and_told():
    kept, told = Results({"b": 1}, lambda _, result: result), []
    keys, given = ["a", "b", "c", "d"], {"a": {"x": 4}, "c": {"x": 0}, "d": {"x": 2}}

    def ready():  # Of d it is known what to do as soon as a is there.
        return (key for key in keys if key != "d" or "a" in kept)

    here = executor(lambda given: 8 / given["x"], 1)
    options = {"ready": ready, "progress": lambda *report: told.append(report)}
    problems = make_missing(here, keys, kept, given.__getitem__, **options)
    assert str(problems["c"]).startswith("ZeroDivisionError")
    assert list(problems) == ["c"]
    assert kept == {"a": 2, "b": 1, "d": 4}
    assert told == [(1, 4, ""), (2, 4, "a"), (3, 4, "c"), (4, 4, "d")]
    # What came to nothing is made again, nothing else is.
    assert make_missing(here, keys, kept, {"c": {"x": 1}}.__getitem__) == {}
    assert kept["c"] == 8
