"""Runs the examples of a page: `python -m tests.helpers.pages docs/start/tutorial.md`.

Fenced blocks are taken in the order of the page, in one folder that is empty at the start:

- `sh` runs in bash, `python` runs in one namespace for the whole page;
- a block whose first line is a comment with nothing but a file name is saved under that name;
- a `text` block right after one that ran says what it printed: numbers may differ by 2 % or by one
  in the last digit, `...` stands for something, spaces and the lines of tables do not count. If it
  starts with "error:", the block must end with status 2.
"""

import argparse
import contextlib
import io
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
_BLOCK = re.compile(r"^```(\w+)[^\n]*\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_FILE = re.compile(r"\A(?:#|<!--) ([\w./-]+\.\w+)(?: -->)?\n")
_TOKEN = re.compile(r"\.\.\.|[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?|[^\W\d]+|[^\s\w]")
_NUMBER = re.compile(r"[-+]?\d")
_FRAME = str.maketrans("", "", "─━│┃┏┓┗┛┡┩┳┻┴┬╇╈╋┼├┤└┘┌┐")
_TOLERANCE = 0.02


@dataclass(frozen=True, kw_only=True)
class Block:
    """A fenced block.

    Attributes:
        language: Of its first line.
        text: Its content.
        line: Where the content starts, from 1.
        start: Offset of the block in the page.
        end: Offset behind it.
    """

    language: str
    text: str
    line: int
    start: int
    end: int

    @property
    def file(self) -> str | None:
        """Name of the file that the block is, if it is one."""
        found = _FILE.match(self.text)
        return found[1] if found else None


def blocks(page: str) -> list[Block]:
    """All fenced blocks of a page."""
    return [
        Block(
            language=found[1],
            text=found[2],
            line=page.count("\n", 0, found.start(2)) + 1,
            start=found.start(),
            end=found.end(),
        )
        for found in _BLOCK.finditer(page)
    ]


def steps(page: str) -> Iterator[tuple[Block, str | None]]:
    """Blocks that run or are saved, with what they print where the page says it."""
    every = blocks(page)
    for i, block in enumerate(every):
        if block.file is None and block.language not in ("sh", "python"):
            continue
        after = every[i + 1] if i + 1 < len(every) else None
        said = None
        if after and after.language == "text" and not page[block.end : after.start].strip():
            said = after.text
        yield block, said


def agrees(said: str, printed: str) -> bool:
    """Whether what was printed is what the page says."""
    pattern, tokens = (_TOKEN.findall(text.translate(_FRAME)) for text in (said, printed))
    # Positions in `tokens` that the pattern so far can have come to.
    reached = {0}
    for part in pattern:
        if part == "...":
            reached = set(range(min(reached) + 1, len(tokens) + 1)) if reached else set()
        else:
            reached = {i + 1 for i in reached if i < len(tokens) and _same(part, tokens[i])}
    return len(tokens) in reached


def _same(said: str, printed: str) -> bool:
    if not (_NUMBER.match(said) and _NUMBER.match(printed)):
        return said == printed
    mantissa, _, exponent = said.lower().partition("e")
    digits = len(mantissa.partition(".")[2])
    last = 10.0 ** (int(exponent or 0) - digits) if "." in mantissa or exponent else 0.0
    a, b = float(said), float(printed)
    return abs(a - b) <= max(_TOLERANCE * abs(a), 1.001 * last)


def run(path: Path, folder: Path, languages: tuple[str, ...] = ("sh", "python")) -> None:
    """Runs a page in a folder: blocks in these languages, and files.

    Raises:
        AssertionError: A block fails, or prints something else than the page says.
    """
    names: dict = {"__name__": "page"}
    sys.path.insert(0, str(folder))
    for block, said in steps(path.read_text()):
        where = f"{path.name}:{block.line}"
        if block.file:
            target = folder / block.file
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(block.text)
            continue
        if block.language not in languages:
            continue
        status, printed = (_shell if block.language == "sh" else _python)(block, where, names)
        wanted = 2 if said is not None and said.startswith("error:") else 0
        assert status == wanted, f"{where}: status {status}\n{printed}"
        if said is not None:
            assert agrees(said, printed), f"{where}: the page says\n{said}\nprinted was\n{printed}"


def _shell(block: Block, where: str, names: dict) -> tuple[int, str]:
    del where, names
    binaries = str(Path(sys.executable).parent)
    environment = {
        **os.environ,
        "PATH": f"{binaries}{os.pathsep}{os.environ['PATH']}",
        "COLUMNS": "100",
        "PYTHONPATH": os.pathsep.join(filter(None, [".", os.environ.get("PYTHONPATH")])),
    }
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", block.text],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    # Where all went well standard error has the progress alone, as a pipe gets it.
    return done.returncode, done.stdout + (done.stderr if done.returncode else "")


def _python(block: Block, where: str, names: dict) -> tuple[int, str]:
    del where
    printed = io.StringIO()
    # Empty lines in front: tracebacks show the line of the page.
    code = compile("\n" * (block.line - 1) + block.text, "page", "exec")
    with contextlib.redirect_stdout(printed):
        exec(code, names)
    return 0, printed.getvalue()


def main() -> None:
    """Runs pages, each in a folder of its own."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("pages", nargs="+", type=Path)
    parser.add_argument("--keep", type=Path, help="run in this folder and leave it")
    parser.add_argument("--only", action="append", choices=("sh", "python"))
    options = parser.parse_args()
    for page in [path.resolve() for path in options.pages]:
        with contextlib.ExitStack() as stack:
            if options.keep:
                options.keep.mkdir(parents=True, exist_ok=True)
                folder = options.keep.resolve()
            else:
                folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            os.chdir(folder)
            try:
                run(page, folder, tuple(options.only or ("sh", "python")))
            except AssertionError as error:
                sys.exit(str(error))
            finally:
                os.chdir(ROOT)


if __name__ == "__main__":
    main()
