"""Tables that a command makes: `python -m tests.tables` compares, `--write` makes them anew.

In README.md and docs/ there are two kinds:

- between `<!-- made by: COMMAND -->` and `<!-- end -->` stands what the command prints;
- a page that says "Made by `COMMAND > docs/PAGE.md`" is, as a whole, what the command prints.

Commands are `leglab ...` or `python ...` and run in the repository's root.
"""

import argparse
import contextlib
import difflib
import io
import os
import re
import runpy
import shlex
import sys
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

ROOT = Path(__file__).parent.parent
_BLOCK = re.compile(r"^<!-- made by: (.+?) -->\n(.*?)^<!-- end -->$", re.MULTILINE | re.DOTALL)
_PAGE = re.compile(r"^Made by `([^`]+) > (docs/[\w/]+\.md)`", re.MULTILINE)


@dataclass(frozen=True, kw_only=True)
class Made:
    """A part of a page that a command makes.

    Attributes:
        page: The page, from the root.
        command: What makes it.
        text: What stands there.
    """

    page: str
    command: str
    text: str

    def __str__(self) -> str:
        return f"{self.page}: {self.command}"


def pages() -> list[Path]:
    """README.md and everything in docs/."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def made(paths: Iterable[Path] | None = None) -> list[Made]:
    """Everything that commands make in these pages; None for all."""
    found = []
    for path in pages() if paths is None else paths:
        page, text = path.relative_to(ROOT).as_posix(), path.read_text()
        whole = _PAGE.search(text)
        if whole:
            if whole[2] != page:
                raise ValueError(f"{page} says that it is {whole[2]}")
            found.append(Made(page=page, command=whole[1], text=text))
        found += [Made(page=page, command=b[1], text=b[2]) for b in _BLOCK.finditer(text)]
    return found


def printed(command: str) -> str:
    """What a command prints, run in this process: to start Python takes longer than most tables.

    Raises:
        ValueError: It ends with another status than 0, or is neither `leglab` nor `python`.
    """
    program, *arguments = shlex.split(command)
    known = {"leglab": ["-m", "leglab"], "python": []}
    if program not in known:
        raise ValueError(f"{command!r} starts with {program!r}; allowed: {', '.join(known)}")
    words = [*known[program], *arguments]
    script = words[0] != "-m"
    name, *options = words if script else words[1:]
    output, errors, status = io.StringIO(), io.StringIO(), None
    with (
        contextlib.chdir(ROOT),
        mock.patch.dict(os.environ, COLUMNS="100"),
        mock.patch.object(sys, "argv", [name, *options]),
        mock.patch.object(sys, "path", [str((ROOT / name).parent) if script else ".", *sys.path]),
        contextlib.redirect_stdout(output),
        contextlib.redirect_stderr(errors),
        warnings.catch_warnings(action="ignore", category=RuntimeWarning),  # imported before
    ):
        try:
            if script:
                runpy.run_path(name, run_name="__main__")
            else:
                runpy.run_module(name, run_name="__main__", alter_sys=True)
        except SystemExit as exit_:
            status = exit_.code
    if status:
        raise ValueError(f"{command!r} ended with status {status}: {errors.getvalue()}")
    return output.getvalue()


def difference(part: Made, now: str) -> str:
    """What differs between a page and what its command prints now; empty if nothing does."""
    lines = difflib.unified_diff(
        part.text.splitlines(), now.splitlines(), part.page, part.command, lineterm="", n=0
    )
    return "\n".join(lines)


def write(part: Made, now: str) -> None:
    """Puts what a command prints now into its page."""
    path = ROOT / part.page
    text = path.read_text()
    if part.text == text:
        path.write_text(now)
        return
    head = f"<!-- made by: {part.command} -->\n"
    path.write_text(text.replace(head + part.text + "<!-- end -->", head + now + "<!-- end -->"))


def main() -> None:
    """Compares or writes."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("pages", nargs="*", type=Path, help="default: README.md and docs/")
    parser.add_argument("--write", action="store_true", help="put what is printed now into pages")
    options = parser.parse_args()
    chosen = [path.resolve() for path in options.pages] or None
    stale = 0
    for part in made(chosen):
        now = printed(part.command)
        changed = difference(part, now)
        print(f"{'differs' if changed else 'same   '}  {part}")
        if changed:
            stale += 1
            print(changed)
            if options.write:
                write(part, now)
    sys.exit(1 if stale and not options.write else 0)


if __name__ == "__main__":
    main()
