"""Ctrl-C at any time: one line, status 130, and what was recorded is kept."""

import json
import signal
import subprocess
import sys
import time

import pytest

from leglab import data
from leglab.runs.interrupts import held

# What stands still, with a mark, until the interrupt has come.
STILL = """
import sys, time
from pathlib import Path
def still(*_, **__):
    Path("here").touch()
    time.sleep(0.7)
"""
PLACES = {
    "while it runs": (
        "from leglab.controllers.pd import Pd as P; old = P.command\n"
        "def command(self, m, r):\n"
        "    if m.time > 0.1 and not Path('here').exists(): still()\n"
        "    return old(self, m, r)\n"
        "P.command = command",
        "interrupted at 0.2",
    ),
    "while it is summed up": (
        "import leglab.runs.run as r; old = r._metrics\n"
        "r._metrics = lambda *a: (still(), old(*a))[1]",
        "interrupted when the run was over",
    ),
    "while it is drawn": (
        "import leglab.report.figures as f; f.draw_run = still",
        "interrupted when the run was over",
    ),
}


@pytest.mark.parametrize(
    "where",
    [
        "while it runs",
        *(
            pytest.param(where, marks=pytest.mark.slow("more interrupted commands"))
            for where in list(PLACES)[1:]
        ),
    ],
)
def test_an_interrupted_run_keeps_what_was_recorded(tmp_path, where):
    patch, told = PLACES[where]
    code = f"{STILL}\n{patch}\nfrom leglab.cli import main\nmain(sys.argv[1:])"
    arguments = ("run", "nominal", "--model", "knee_bench", "--duration", "1", "--out", "a")
    process = subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        cwd=tmp_path,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    end = time.monotonic() + 60
    while not (tmp_path / "here").exists():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    errors = process.communicate()[1]
    assert process.returncode == 130, errors
    assert errors.startswith(f"error: {told}")
    assert errors.endswith("what was recorded is in a\n")
    assert data.read(tmp_path / "a" / "recording.parquet").duration >= 0.1
    assert json.loads((tmp_path / "a" / "metrics.json").read_text())["phases"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "here"]


def test_an_interrupt_while_the_program_is_loaded_is_one_line(tmp_path):
    code = (
        "import os, runpy, signal, sys, threading;"
        "threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT)).start();"
        "sys.argv[1:] = ['list'];"
        "runpy.run_module('leglab', run_name='__main__')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "interrupted\n")


def test_an_interrupt_is_held_once_and_taken_or_raised():
    def interrupt():
        signal.raise_signal(signal.SIGINT)

    with held() as hold:
        interrupt()
        assert hold.take()
        interrupt()
        with pytest.raises(KeyboardInterrupt):
            interrupt()
        assert hold.take()
    with pytest.raises(KeyboardInterrupt), held():
        interrupt()
    with held(later=True) as outer:
        with pytest.raises(KeyboardInterrupt):
            interrupt()
        with held() as inner:
            interrupt()
        assert inner is outer
        interrupt_taken = outer.take()
    assert interrupt_taken
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
