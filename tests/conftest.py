"""Fixtures that several files share."""

import os
import shutil
import signal
import subprocess

import pytest

# Whoever runs the tests in the background, or by nohup, has these ignored, and the processes that
# the tests start would inherit it.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.fixture
def screen():
    """Number of a virtual display with nothing on it."""
    if shutil.which("Xvfb") is None:
        pytest.skip("Xvfb is missing: sudo apt-get install -y xvfb")
    read, write = os.pipe()
    arguments = ["Xvfb", "-displayfd", str(write), "-screen", "0", "960x720x24"]
    server = subprocess.Popen(arguments, pass_fds=[write], stderr=subprocess.DEVNULL)
    os.close(write)
    with os.fdopen(read) as answer:
        number = answer.readline().strip()
    yield f":{number}"
    server.terminate()
    server.wait()
