"""All that measures leglab, by name: `python -m benchmarks NAME [OPTIONS]`.

Without a name it lists them; `results [NAME ...]` makes docs/data and the tables of README.md and
docs anew, one benchmark after the other, so that times are not disturbed by each other. Needs the
benchmarks group (`pip install --group benchmarks`) and the recordings in $LEGLAB_DATA.
"""

import subprocess
import sys
import time

from benchmarks import results
from benchmarks.registry import BENCHMARKS, ROOT, Benchmark, benchmark
from leglab.base.errors import LeglabError, SettingsError, SimulationError
from leglab.cli.terminal import complain


def listing() -> str:
    """A line a benchmark: name, minutes, file, what it measures."""
    rows = [
        (
            one.name,
            "" if one.minutes is None else f"{one.minutes:g} min",
            one.file.relative_to(ROOT).as_posix() if one.kept else "",
            one.measures(),
        )
        for one in BENCHMARKS.values()
    ]
    widths = [max(len(row[i]) for row in rows) for i in range(3)]
    return "\n".join(
        "  ".join([*(cell.ljust(w) for cell, w in zip(row, widths, strict=False)), row[-1]])
        for row in rows
    )


def make(one: Benchmark) -> bool:
    """Makes a file of docs/data; says whether that ended well."""
    print(f"{one.name}: about {one.minutes:g} min", flush=True)
    began = time.monotonic()
    command = [sys.executable, "-m", "benchmarks", one.name, "--write", one.file]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.DEVNULL)
    spent = (time.monotonic() - began) / 60
    print(f"{one.name}: {'made' if done.returncode == 0 else 'FAILED'} in {spent:.1f} min")
    return done.returncode == 0


def make_results(names: list[str]) -> None:
    """Makes all of docs/data, or those named, then the tables; everything is tried if one fails.

    Raises:
        LeglabError: A name is not of a benchmark that docs/data keeps; or some could not be made.
    """
    kept = [one for one in BENCHMARKS.values() if one.kept]
    if unknown := [name for name in names if not benchmark(name).kept]:
        raise SettingsError(f"docs/data keeps no {', '.join(unknown)}", given=tuple(unknown))
    failed = [one.name for one in kept if one.name in (names or BENCHMARKS) and not make(one)]
    print("tables of README.md and docs", flush=True)
    tables = subprocess.run([sys.executable, "-m", "tests.tables", "--write"], cwd=ROOT)
    if failed or tables.returncode:
        raise SimulationError(f"not made: {', '.join(failed) or 'tables'}")


def main() -> None:
    """Runs what is named, or lists all; errors are one line."""
    name, *words = sys.argv[1:] or ["--help"]
    try:
        if name in ("-h", "--help"):
            print(f"{__doc__}\n{listing()}")
        elif name == "results":
            make_results(words)
        else:
            results.run(benchmark(name), words)
    except LeglabError as error:
        complain(str(error))
        raise SystemExit(2) from error


if __name__ == "__main__":
    main()
