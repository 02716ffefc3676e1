"""Faults put into the compiled core one by one: `python -m benchmarks mutation_core --most 40`.

As `mutation.py` does for Python. A mutant has one operator, comparison or number of a header of
`leglab/csrc` changed in its text; the module of Python that is made of the header is compiled with
it, and its tests run until the first one fails. What does not compile is no mutant. Needs a C++
compiler and `pip install 'nanobind>=2.9'`.
"""

import argparse
import importlib.abc
import importlib.machinery
import importlib.util
import random
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from dataclasses import dataclass
from pathlib import Path

from benchmarks import mutation

SOURCES = mutation.ROOT / "leglab" / "csrc"


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part of the core."""

    module: str  #: Of `leglab._native`, made of it
    headers: str  #: Their folder
    sources: tuple[str, ...]  #: Of `bindings`, that see the headers
    tests: tuple[str, ...]  #: That run on the module
    others: tuple[str, ...] = ()  #: Sources of the module that do not; they are compiled once


PARTS = {
    "hydraulics": Part(
        module="hydraulics",
        headers="hydraulics",
        sources=("hydraulics",),
        tests=("tests/machine/test_hydraulics_core.py", "tests/machine/test_hydraulics_scheme.py"),
    ),
    "identification": Part(
        module="identification",
        headers="identification",
        sources=("identification", "feedforward"),
        tests=(
            "tests/identification/test_identification_oracle.py",
            "tests/identification/test_identification_basis.py",
            "tests/identification/test_identification_input.py",
        ),
    ),
    "feedforward": Part(
        module="identification",
        headers="feedforward",
        sources=("feedforward",),
        others=("identification",),
        tests=("tests/control/test_feedforward_core.py",),
    ),
    "monitor": Part(
        module="monitor",
        headers="monitor",
        sources=("monitor",),
        tests=("tests/control/test_monitor_core.py",),
    ),
}
_CHANGES = (
    (r" \+ ", " - "), (r" - ", " + "), (r" \* ", " / "), (r" / ", " * "), (r" < ", " <= "),
    (r" > ", " >= "), (r" <= ", " < "), (r" >= ", " > "), (r" == ", " != "), (r" != ", " == "),
    (r" && ", " || "), (r" \|\| ", " && "), (r"std::max", "std::min"), (r"std::min", "std::max"),
    (r" \+= ", " -= "), (r" -= ", " += "), (r"(?<=[(\s])!(?=\w)", ""),
    (r"(?<=[=(,?:] )-(?=\w)", ""),
)  # fmt: skip
_NUMBER = re.compile(r"(?<![\w.\"])(\d+\.\d*(?:e[-+]?\d+)?|\d+e[-+]?\d+|[1-9]\d*)(?![\w.\"])")
_NO_CODE = re.compile(r"//.*$|\"(\\.|[^\"])*\"")
# Lines without arithmetic; X( is a row of a table, whose bounds are listed in
# docs/reference/parameters.md.
_LEFT_OUT = ("#", "static_assert", "template", "using", "X(")
_FLAGS = (
    "-std=c++20", "-O1", "-fPIC", "-shared", "-fvisibility=hidden", "-ffp-contract=off",
    "-fno-math-errno", "-fno-strict-aliasing", "-DNDEBUG", "-w",
)  # fmt: skip


def mutants(text: str) -> list[tuple[str, str]]:
    """Returns line and change of every mutant of a header, and its text."""
    lines, found = text.split("\n"), []
    for row, line in enumerate(lines):
        blank = _NO_CODE.sub(lambda part: " " * len(part[0]), line)
        if blank.lstrip().startswith(_LEFT_OUT):
            continue
        places = [
            (m.start(), m.end(), new) for old, new in _CHANGES for m in re.finditer(old, blank)
        ]
        places += [(m.start(), m.end(), _more(m[0])) for m in _NUMBER.finditer(blank)]
        for start, end, new in places:
            other = line[:start] + new + line[end:]
            whole = "\n".join([*lines[:row], other, *lines[row + 1 :]])
            found.append((f"line {row + 1}: {line.strip()} -> {other.strip()}", whole))
    return found


def _more(number: str) -> str:
    """A number that is clearly another one: a tenth more, or the next whole one; one for nil."""
    return str(int(number) + 1) if number.isdigit() else repr(1.1 * float(number) or 1.0)


class _Compiled(importlib.abc.MetaPathFinder):
    """Gives Python another file for a compiled module."""

    def __init__(self, module: str, file: Path) -> None:
        self._module, self._file = f"leglab._native.{module}", str(file)

    def find_spec(self, name, path=None, target=None):
        if name != self._module:
            return None
        loader = importlib.machinery.ExtensionFileLoader(name, self._file)
        return importlib.util.spec_from_file_location(name, self._file, loader=loader)


class _Compiler:
    """Compiles modules from sources of their own, a copy that mutants are written into."""

    def __init__(self, folder: Path) -> None:
        try:
            import nanobind
        except ImportError:
            sys.exit("nanobind is missing; install it with: pip install 'nanobind>=2.9'")
        self.sources, self._folder = folder / "csrc", folder
        shutil.copytree(SOURCES, self.sources)
        inside = Path(nanobind.__file__).parent
        places = (inside / "include", inside / "ext" / "robin_map" / "include", self.sources)
        self._command = [sysconfig.get_config_var("CXX").split()[0], *_FLAGS]
        self._command += [f"-I{place}" for place in (*places, sysconfig.get_path("include"))]
        self._count = 0
        self._common = self._object(inside / "src" / "nb_combined.cpp")

    def _object(self, source: Path) -> Path:
        """Returns what a source without mutants compiles to, once."""
        file = self._folder / f"{source.stem}.o"
        if not file.exists():
            flags = [word for word in self._command if word != "-shared"]
            subprocess.run([*flags, "-c", source, "-o", file], check=True)
        return file

    def module(self, part: Part) -> Path | None:
        """Returns the compiled module; None if it does not compile."""
        self._count += 1  # A name of its own: Python loads a file of the same name once.
        file = self._folder / f"{part.module}{self._count}{sysconfig.get_config_var('EXT_SUFFIX')}"
        bindings = self.sources / "bindings"
        inputs = [bindings / f"{name}.cc" for name in part.sources]
        inputs += [self._object(bindings / f"{name}.cc") for name in part.others]
        command = [*self._command, *inputs, self._common, "-o", file]
        done = subprocess.run(command, stderr=subprocess.DEVNULL)
        return None if done.returncode else file


def measure(options: argparse.Namespace) -> dict[str, dict]:
    """Numbers of mutants made and noticed, and what survived, by part."""
    found = {}
    for package in ("numpy", "scipy.signal", "scipy.optimize", "hypothesis", "mujoco", "pyarrow"):
        importlib.import_module(package)  # Each child has them, and not leglab, from its parent.
    with tempfile.TemporaryDirectory() as name:
        compiler = _Compiler(Path(name))
        for key in options.parts or PARTS:
            found[key] = _part(PARTS[key], compiler, options)
            row = found[key]
            noticed = row["tried"] - len(row["survived"])
            print(f"{key}: {noticed} of {row['tried']} noticed", flush=True)
    return found


def _part(part: Part, compiler: _Compiler, options: argparse.Namespace) -> dict:
    headers = sorted((SOURCES / part.headers).glob("*.h"))
    every = [(header.name, *mutant) for header in headers for mutant in mutants(header.read_text())]
    random.Random(0).shuffle(every)
    if options.again:
        every = [row for row in every if f"{row[0]} {row[1]}" in options.again.read_text()]
    whole = compiler.module(part)
    if whole is None or not mutation.survives(_Compiled(part.module, whole), part.tests):
        sys.exit(f"the tests of {part.headers} fail without a fault")
    tried, left = 0, []
    for header, told, text in every:
        if tried == options.most:
            break
        place = compiler.sources / part.headers / header
        before = place.read_text()
        place.write_text(text)
        file = compiler.module(part)
        place.write_text(before)
        if file is None:
            continue
        tried += 1
        if mutation.survives(_Compiled(part.module, file), part.tests):
            left.append(f"{header} {told}")
            print(left[-1], flush=True)
        file.unlink()
    return {"all": len(every), "tried": tried, "survived": left}


tables = mutation.tables


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("parts", nargs="*", help="allowed: " + ", ".join(PARTS))
    parser.add_argument("--most", type=int, default=10_000, help="mutants of a part, by chance")
    parser.add_argument("--again", type=Path, metavar="LOG", help="only mutants that it names")
