"""Runs tests of the compiled core under AddressSanitizer and UndefinedBehaviourSanitizer.

`python -m tests.sanitize` (`make sanitize`) compiles the core with `-DLEGLAB_SANITIZE=ON` into
build/sanitize and runs the tests below with it: readings and writings out of bounds, uses of freed
memory, and undefined arithmetic end the run with a report. Leaks are not looked for: CPython keeps
memory until it ends. `--valgrind` steps a leg with the usual build under valgrind's memcheck
instead, which also notices values that were never set.
"""

import argparse
import importlib.util
import os
import re
import subprocess
import sys
import sysconfig
from pathlib import Path

ROOT = Path(__file__).parents[1]
BUILD = ROOT / "build" / "sanitize"
# After runs of `tests/sanitized_run.py`: hydraulics, plugins and wrong input to them, identifiers
# and damaged states of them, the feed-forward, the monitor of faults, the rough bench.
TESTS = (
    "tests/machine/test_hydraulics_core.py",
    "tests/machine/test_plugin_errors.py",
    "tests/machine/test_plugin_play.py",
    "tests/machine/test_plugin_delay.py",
    "tests/machine/test_plugin_joint_friction.py",
    "tests/machine/test_plugin_residual.py",
    "tests/identification/test_identification_input.py",
    "tests/identification/test_identification_storage.py",
    "tests/rigs/test_rough_bench.py",
    "tests/control/test_feedforward_core.py",
    "tests/control/test_monitor_core.py",
)
_OURS = re.compile(r"(at|by) 0x.*(leglab::|libleglab_plugin|/_native/)")
# Python finds the compiled modules of `folder` before those that are installed.
_SITE = """
import sys
from importlib.machinery import PathFinder
from importlib.util import spec_from_file_location

class Sanitized:
    def find_spec(name, path=None, target=None):
        if name == "leglab._native":
            where = [{folder!r}, {sources!r}]
            return spec_from_file_location(
                name, {sources!r} + "/__init__.py", submodule_search_locations=where
            )
        if name.startswith(("leglab._native.", "rigs._native.")):
            return PathFinder.find_spec(name, [{folder!r}])

sys.meta_path.insert(0, Sanitized)
"""


def build(folder: Path) -> None:
    """Compiles the core with sanitizers; a second call compiles what has changed."""
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps"]
    if importlib.util.find_spec("scikit_build_core"):
        command.append("--no-build-isolation")  # Else pip fetches what builds, CMake too.
    for setting in (
        f"build-dir={folder}",
        "cmake.build-type=Debug",
        "cmake.define.LEGLAB_SANITIZE=ON",
        "cmake.define.LEGLAB_RIGS=ON",
    ):
        command += ["-C", setting]
    subprocess.run([*command, "--wheel-dir", folder / "wheel", ROOT], check=True)


def sanitized(folder: Path) -> dict[str, str]:
    """Environment variables with which Python takes the modules compiled with sanitizers."""
    site = folder / "site"
    site.mkdir(exist_ok=True)
    sources = str(ROOT / "leglab" / "_native")
    code = _SITE.format(folder=str(folder), sources=sources)
    (site / "sitecustomize.py").write_text(code, encoding="utf-8")
    compiler = sysconfig.get_config_var("CXX").split()[0]
    found = [
        subprocess.check_output([compiler, f"-print-file-name={name}"], text=True).strip()
        for name in ("libasan.so", "libubsan.so", "libstdc++.so")
    ]
    return {
        **os.environ,
        "PYTHONPATH": f"{site}:{ROOT}",
        # Python is not built with sanitizers: their library must be there before it starts.
        "LD_PRELOAD": " ".join(found),
        "ASAN_OPTIONS": "detect_leaks=0:abort_on_error=0:exitcode=66",
        "UBSAN_OPTIONS": "print_stacktrace=1:halt_on_error=1:exitcode=66",
        "LEGLAB_SANITIZED": str(folder),
        "PYTHONMALLOC": "malloc",  # each object of Python a block of its own
    }


def valgrind() -> int:
    """Steps a leg under memcheck; returns the number of errors that our library is part of."""
    command = ["valgrind", "--leak-check=no", "--num-callers=30", sys.executable]
    command += ["-m", "tests.sanitized_run"]
    env = {**os.environ, "PYTHONMALLOC": "malloc"}
    done = subprocess.run(command, cwd=ROOT, env=env, stderr=subprocess.PIPE, text=True)
    # Blocks of lines, each an error: "==123== Invalid read of size 8", then where.
    blocks = re.split(r"^==\d+== *$", done.stderr, flags=re.MULTILINE)
    ours = [block for block in blocks if _OURS.search(block)]
    print("".join(ours), done.stderr.splitlines()[-1], f"{len(ours)} with leglab in them", sep="\n")
    return done.returncode or len(ours)


def main() -> int:
    """Builds, runs and tells; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--valgrind", action="store_true", help="memcheck on a run of the leg")
    parser.add_argument("--build", type=Path, default=BUILD, help="folder of the build")
    parser.add_argument("tests", nargs="*", default=TESTS, help="tests, as pytest takes them")
    asked = parser.parse_args()
    if asked.valgrind:
        return valgrind()
    build(asked.build.resolve())
    env = sanitized(asked.build.resolve())
    moves = [sys.executable, "-P", "-m", "tests.sanitized_run", "controlled"]
    failed = subprocess.run(moves, cwd=ROOT, env=env).returncode
    command = [sys.executable, "-P", "-m", "pytest", "-q", "-p", "no:cacheprovider"]
    command += ["--import-mode=importlib", *asked.tests]
    return failed or subprocess.run(command, cwd=ROOT, env=env).returncode


if __name__ == "__main__":
    sys.exit(main())
