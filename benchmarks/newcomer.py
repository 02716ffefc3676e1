"""The newcomer's way, timed.

Takes the commands of docs/start/first_hour.md from the page, section by section, and runs them as
one typed them: in one shell, in an empty folder, with a clone of the commit that is checked out
and an empty home, so that the environment is made and compiled anew. A command that fails ends it.
"""

import argparse
import itertools
import os
import re
import subprocess
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks import results
from benchmarks.registry import ROOT
from tests.helpers.pages import Block, blocks

PAGE = ROOT / "docs" / "start" / "first_hour.md"
_HEAD = re.compile(r"^## (\d+\. .+)$", re.MULTILINE)
_ADDRESS = "URL-OF-THIS-REPOSITORY"
# Of the own environment, what the shell of a newcomer has as well; his home is empty.
_KEPT = ("PATH", "LANG", "LC_ALL", "LEGLAB_DATA", "MUJOCO_GL")
_MIRRORS = ("PIP_", "UV_", "HTTP", "http", "SSL_")


@dataclass(frozen=True, kw_only=True)
class Section:
    """A numbered section of the page."""

    title: str  #: Its heading
    blocks: tuple[Block, ...]  #: What is typed or saved, in order

    @property
    def commands(self) -> list[str]:
        """Typed commands, one each, without comments."""
        typed = "".join(block.text for block in self.blocks if block.file is None)
        lines = typed.replace("\\\n", " ").splitlines()
        return [" ".join(line.partition(" #")[0].split()) for line in lines if line.strip()]


def sections(page: str) -> list[Section]:
    """Numbered sections of a page with the blocks in them that are typed or saved."""
    heads = list(_HEAD.finditer(page))
    ends = [*(head.start() for head in heads[1:]), len(page)]
    typed = [b for b in blocks(page) if b.file or b.language in ("sh", "console")]
    return [
        Section(
            title=head[1],
            blocks=tuple(b for b in typed if head.start() < b.start < end),
        )
        for head, end in zip(heads, ends, strict=True)
    ]


def script(parts: list[Section], repository: Path) -> str:
    """A shell script that does all of it and tells descriptor 3 when each section ended."""
    lines = ["set -eo pipefail"]
    for part in parts:
        for block in part.blocks:
            if block.file:
                lines += [f"cat > {block.file} <<'END OF FILE'", block.text + "END OF FILE"]
            else:
                lines.append(block.text.replace(_ADDRESS, str(repository)))
        lines.append("echo $EPOCHREALTIME >&3")
    return "\n".join(lines) + "\n"


def run(parts: list[Section], folder: Path) -> list[float]:
    """Runs the sections in a folder and returns how long each took [s].

    Raises:
        SystemExit: A command failed; the last lines of what was printed are told.
    """
    home = folder / "home"
    home.mkdir()
    environment = {
        name: value
        for name, value in os.environ.items()
        if name in _KEPT or name.startswith(_MIRRORS)
    }
    environment |= {"HOME": str(home), "COLUMNS": "100"}
    log, read, write = folder / "log.txt", *os.pipe()
    began = time.time()
    with log.open("w") as printed:
        done = subprocess.run(
            ["bash", "-c", f"exec 3>&{write}; {script(parts, ROOT)}"],
            cwd=folder,
            env=environment,
            stdout=printed,
            stderr=subprocess.STDOUT,
            pass_fds=[write],
            check=False,
        )
    os.close(write)
    with os.fdopen(read) as marks:
        times = [began, *(float(line) for line in marks)]
    if done.returncode:
        told = "\n".join(log.read_text().splitlines()[-20:])
        raise SystemExit(f"error: section {parts[len(times) - 1].title!r} failed:\n{told}")
    return [after - before for before, after in itertools.pairwise(times)]


def measure(options: argparse.Namespace) -> list[dict]:
    """Title, commands and seconds of each section."""
    del options
    parts = sections(PAGE.read_text())
    with tempfile.TemporaryDirectory() as folder:
        seconds = run(parts, Path(folder))
    return [
        {"title": part.title, "commands": part.commands, "seconds": spent}
        for part, spent in zip(parts, seconds, strict=True)
    ]


def tables(found: list[dict]) -> str:
    """A row a section, and the sum."""
    rows = [(step["title"], str(len(step["commands"])), _told(step["seconds"])) for step in found]
    whole = sum(step["seconds"] for step in found)
    rows.append(("all", str(sum(len(step["commands"]) for step in found)), _told(whole)))
    return results.table(("section", "commands", "time"), rows)


def _told(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.1f} min"
