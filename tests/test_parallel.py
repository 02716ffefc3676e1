"""Processes that make results: they end with their user and take no code from where he is."""

import os
import signal
import subprocess
import sys
import time

import pytest

# Slow enough to be interrupted, and told by a file of its own that it has begun.
_SLEEP = """
import os, sys, time
from pathlib import Path
from leglab.runs.parallel import in_processes

def make(item):
    Path(f"begun-{os.getpid()}").touch()
    time.sleep(30)

if __name__ == "__main__":
    from leglab.cli import app
    import typer
    command = typer.Typer(cls=app.Commands)
    command.callback()(lambda: None)
    command.command("work")(lambda: list(in_processes(make, [1, 2], jobs=2)))
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


def test_workers_do_not_run_code_of_the_working_folder(tmp_path):
    here = tmp_path / "here"
    for name in ("joblib", "leglab", "numpy"):
        (here / name).mkdir(parents=True)
        (here / name / "__init__.py").write_text("open('ran', 'w'); raise SystemExit('ran')")
    code = "from leglab.runs.parallel import in_processes as f; print(sum(f(abs, [-1, 2], jobs=2)))"
    done = subprocess.run(
        [sys.executable, "-P", "-c", code], cwd=here, capture_output=True, text=True, check=False
    )
    assert (done.stdout, done.returncode) == ("3\n", 0), done.stderr
    assert not (here / "ran").exists()
    assert "PYTHONSAFEPATH" not in os.environ
