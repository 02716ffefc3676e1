"""Fixtures that several files share, and what holds for all tests: one cache, who runs what."""

import os
import re
import shutil
import signal
import subprocess
import tempfile
from collections import Counter
from functools import cache

import pytest

# Whoever runs the tests in the background, or by nohup, has these ignored, and the processes that
# the tests start would inherit it.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)


def pytest_configure(config):
    """Keeps what leglab keeps, banks of faults for one, beside the tests' cache."""
    if not hasattr(config, "workerinput"):
        cached = config.pluginmanager.hasplugin("cacheprovider")
        place = config.cache.mkdir("leglab") if cached else tempfile.mkdtemp(prefix="leglab-")
        os.environ["LEGLAB_CACHE"] = str(place)


def pytest_collection_modifyitems(items):
    """Puts long tests first: none begins when all others are done."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Keeps the tests of a file that share what they make on one worker."""
    from xdist.scheduler import LoadScopeScheduling

    @cache
    def shared(file):
        text = (config.rootpath / file).read_text()
        return re.search(r'scope="module"|^@(functools\.)?cache$', text, re.MULTILINE) is not None

    class Scheduler(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            file = nodeid.partition("::")[0]
            return file if shared(file) else nodeid

    return Scheduler(config, log)


# Packages of Debian and of Python in the reasons of skips.
_WANTED = re.compile(r"(?:apt-get install -y|pip install) ([\w-]+)|could not import '([\w.]+)'")


def pytest_unconfigure(config):
    """Says in the last line what was not tested, and for want of what."""
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    skipped = reporter.stats.get("skipped", ()) if reporter else ()
    reasons = [report.longrepr[2] for report in skipped]
    wants = Counter()
    for reason in reasons:
        found = _WANTED.search(reason)
        wants[found[found.lastindex] if found else reason.removeprefix("Skipped: ")] += 1
    if wants:
        told = ", ".join(f"{count} for want of {what}" for what, count in wants.most_common())
        reporter.write_line(f"not tested: {told}")


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
