"""What a command tells while it works, in a terminal and in a pipe."""

import io
import os
import pty
import subprocess
import sys

import pytest

from leglab.cli import terminal


@pytest.fixture
def clock(monkeypatch):
    """A clock that a test turns [s]."""
    now = [0.0]
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now[0])
    return now


def test_a_pipe_gets_a_line_with_counts_and_time_left_every_half_a_minute(clock, monkeypatch):
    text = io.StringIO()
    monkeypatch.setattr(terminal.errors, "_file", text)  # `file` would keep the stream of now

    def make(progress):
        progress(3, 28, "")  # which were there
        for done in range(4, 28):
            clock[0] += 8.0
            progress(done, 28, f"seal_wear · pd · seed {done}")
        return "made"

    assert terminal.make_many("comparing", 28, make) == "made"
    lines = text.getvalue().splitlines()
    assert lines[0] == "seal_wear · pd · seed 7: 7 of 28 runs, 3 min left"
    assert len(lines) == 6
    assert lines[-1] == "seal_wear · pd · seed 27: 27 of 28 runs, 8 s left"


def test_a_quick_command_tells_a_pipe_nothing(clock, monkeypatch):
    text = io.StringIO()
    monkeypatch.setattr(terminal.errors, "_file", text)  # `file` would keep the stream of now
    with terminal.progress("nominal · pd", 20.0) as show:
        for second in range(20):
            clock[0] += 1.0
            show(completed=second)
    assert text.getvalue() == ""


@pytest.mark.slow("a comparison in a terminal")
def test_a_comparison_counts_its_runs_in_a_terminal(tmp_path):
    own, other = pty.openpty()
    arguments = ("compare", "nominal", "--model", "knee_bench", "--duration", "1", "--seeds", "2")
    process = subprocess.Popen(
        [sys.executable, "-m", "leglab", *arguments, "--no-figures", "--out", str(tmp_path / "c")],
        stdout=subprocess.DEVNULL,
        stderr=other,
        env={**os.environ, "TERM": "xterm", "COLUMNS": "100"},
    )
    os.close(other)
    seen = b""
    try:
        while part := os.read(own, 4096):
            seen += part
    except OSError:  # The end of a terminal.
        pass
    assert process.wait() == 0
    assert b"of 4 runs" in seen
