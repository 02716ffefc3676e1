"""Results that are kept in docs/data, and the pages' tables of them.

For benchmarks that take long, depend on the machine's speed, or need data or packages that a test
has not: `--write FILE` keeps what was measured with where it comes from, `--render` prints its
tables from there without measuring, which is how a test keeps page and data together.
"""

import argparse
import hashlib
import json
import os
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from datetime import date
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

if find_spec("joblib") is None:
    raise ImportError(
        "benchmarks needs the environment of the clone: make .venv/installed, then "
        "source .venv/bin/activate"
    )

import numpy as np
from joblib import Parallel, delayed

from benchmarks.registry import DATA, ROOT, Benchmark
from leglab.data import write_atomically
from leglab.jobs.fingerprint import fingerprint

# What a file of docs/data says of itself, beside its results.
RECORD = ("command", "date", "commit", "versions", "machine")
# Folders whose changes can change a result.
_CODE = ("leglab", "benchmarks", "replication", "controllers", "models", "scenarios")
_WIDTH = 800  # longest line of a file; most cases of a benchmark are one
_DIGITS = 6  # significant; tables show at most four


def run(benchmark: Benchmark, words: list[str]) -> None:
    """Measures and prints, or prints what is kept.

    Args:
        benchmark: Which one.
        words: Of the command line, after its name.

    Raises:
        SystemExit: The benchmark fails.
    """
    module, fixed = benchmark.module(), shlex.split(benchmark.options)
    sys.argv = [benchmark.command, *fixed, *words]
    if hasattr(module, "main"):
        module.main()
        return
    parser = argparse.ArgumentParser(prog=benchmark.command, description=module.__doc__)
    if hasattr(module, "add_options"):
        module.add_options(parser)
    parser.add_argument("--write", type=Path, metavar="FILE", help="keep the results, as JSON")
    parser.add_argument(
        "--render",
        type=Path,
        metavar="FILE",
        nargs="?",
        const=benchmark.file,
        help=f"print the tables of kept results; default: docs/data/{benchmark.name}.json",
    )
    options = parser.parse_args(sys.argv[1:])
    if options.render:
        record = json.loads(options.render.read_text())
    else:
        origin = origin_of(command(benchmark, words))
        results = module.measure(options)
        if results is None:
            return
        origin["machine"] += f", {os.getloadavg()[0]:.1f} after"
        kept = {**origin, "results": rounded(results)}
        record = json.loads(json.dumps(kept, allow_nan=False))
    print(f"{module.tables(record['results']).rstrip()}\n\n{origin_line(record)}")
    if options.write:
        text = _lines(record) + "\n"
        options.write.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(options.write, lambda file: file.write(text.encode()))
    if not options.render and hasattr(module, "wrong") and module.wrong(record["results"]):
        raise SystemExit(1)


def command(benchmark: Benchmark, words: list[str]) -> str:
    """The command that makes results, without where it writes them to."""
    words = [word for word in words if not word.startswith("--write=")]
    if "--write" in words:
        at = words.index("--write")
        del words[at : at + 2]
    return shlex.join([*benchmark.command.split(), *words])


def _lines(value: Any, indent: str = "") -> str:
    """JSON with what fits on one line."""
    text = json.dumps(value, ensure_ascii=False)
    if len(text) <= _WIDTH or not isinstance(value, (dict, list)):
        return text
    inner, ends = f"{indent} ", "{}" if isinstance(value, dict) else "[]"
    if isinstance(value, dict):
        parts = [f"{inner}{json.dumps(k)}: {_lines(item, inner)}" for k, item in value.items()]
    else:
        parts = [f"{inner}{_lines(item, inner)}" for item in value]
    return f"{ends[0]}\n" + ",\n".join(parts) + f"\n{indent}{ends[1]}"


def resumed(
    make: Callable[[Any], Any], items: Sequence[Any], *, folder: Path | None, jobs: int
) -> list[Any]:
    """Makes the result of each item, and keeps it, so that an interrupted call goes on.

    Args:
        make: Gives the result of an item, as JSON holds it.
        items: Whose `repr` tells them apart.
        folder: Where results are kept, by item and code of leglab; None for
            `runs/benchmarks/NAME` after the script of `make`.
        jobs: Processes at a time.

    Returns:
        Results in the order of the items.
    """
    place = folder or ROOT / "runs" / "benchmarks" / Path(make.__code__.co_filename).stem
    place.mkdir(parents=True, exist_ok=True)
    files = {repr(item): place / f"{_digest(make, item)}.json" for item in items}

    todo = [item for item in items if not files[repr(item)].exists()]
    made = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)(
        delayed(_keep)(make, files, item) for item in todo
    )
    for done, label in enumerate(made, len(items) - len(todo) + 1):
        print(f"{done} of {len(items)} {label}", file=sys.stderr, flush=True)
    return [json.loads(files[repr(item)].read_text()) for item in items]


def _digest(make: Callable[[Any], Any], item: Any) -> str:
    """Of what is made of what by which code."""
    script = Path(make.__code__.co_filename).read_bytes()
    told = f"{make.__name__} {item!r} {fingerprint()}".encode()
    return hashlib.sha256(told + script).hexdigest()[:32]


def _keep(make: Callable[[Any], Any], files: dict[str, Path], item: Any) -> str:
    """Makes the result of an item and writes it."""
    text = json.dumps(rounded(make(item)), allow_nan=False)
    write_atomically(files[repr(item)], lambda file: file.write(text.encode()))
    return str(item)


def origin_of(command: str) -> dict[str, Any]:
    """Where results come from, to be called before they are measured; JSON can hold it.

    Args:
        command: What makes them, without `--write FILE`.

    Returns:
        The entries of `RECORD`; `machine` has the load of the last minute.
    """
    return {
        "command": command,
        "date": date.today().isoformat(),
        "commit": commit(),
        "versions": {name: metadata.version(name) for name in ("leglab", "mujoco", "numpy")},
        "machine": f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} before",
    }


def origin_line(record: dict[str, Any]) -> str:
    """The line below the tables: the command and what it ran on."""
    parts = [f"`{record['command']}`", record["date"]]
    if "commit" in record:
        parts.append(f"commit {record['commit']}")
    parts += [f"{name} {version}" for name, version in record["versions"].items()]
    return ", ".join(parts) + f"; {record['machine']}."


def commit(root: Path = ROOT) -> str:
    """Short hash of the checkout, with "+" if code in it was changed; "unknown" outside git."""

    def git(*words: str) -> str:
        done = subprocess.run(
            ["git", "-C", str(root), *words], capture_output=True, text=True, check=True
        )
        return done.stdout.strip()

    try:
        if Path(git("rev-parse", "--show-toplevel")).resolve() != root.resolve():
            return "unknown"  # unpacked within somebody else's checkout
        changed = git("status", "--porcelain", "--", *_CODE)
        return git("rev-parse", "--short=10", "HEAD") + ("+" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def record(name: str) -> dict[str, Any]:
    """Results that docs/data keeps under this name, and their origin."""
    found: dict[str, Any] = json.loads((DATA / f"{name}.json").read_text())
    return found


def load(name: str) -> Any:
    """Results that docs/data keeps under this name."""
    return record(name)["results"]


def rounded(value: Any) -> Any:
    """The same with as many digits as are kept; what is not finite becomes None."""
    if isinstance(value, (float, np.floating)):
        return float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else None
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [rounded(item) for item in value]
    return value


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table of text."""
    lines = ["| " + " | ".join(line) + " |\n" for line in (head, *rows)]
    lines.insert(1, "|" + "---|" * len(head) + "\n")
    return "".join(lines)


def number(value: float | None, digits: int = 3) -> str:
    """So many significant digits, none cut off before the point; nothing for None."""
    if value is None:
        return ""
    return f"{value:.0f}" if abs(value) >= 10**digits else f"{value:#.{digits}g}".rstrip(".")
