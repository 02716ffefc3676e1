"""Cost of a sweep beside its runs. Two processes on two cores.

One-second runs of the knee bench, and runs of about a second of wall time on the leg, by
one process, by two, and by two workers of a Dask cluster on this machine (a scheduler and two
workers as processes of their own). Where other work slows the machine down, wall times say little.
So CPU times are taken of all processes that have part in a sweep: the efficiency is the share of
them that goes into runs, start-up apart (that of a sweep of two runs). Then the books alone: rows
as those of a sweep, kept, put together and read again.
"""

import argparse
import resource
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil

from benchmarks import results
from leglab.base.output import write_json
from leglab.runs.sweeps import store
from leglab.runs.sweeps.engine import run_sweep
from leglab.runs.sweeps.plan import SweepPlan
from leglab.runs.sweeps.query import ask

SHORT = {"model": "knee_bench", "duration": 1.0, "controller": "pd", "scenario": "seal_wear"}
LONG = {"model": "leg", "duration": 40.0, "controller": "bsnn_arx", "scenario": "seal_wear"}
CASES = {"knee bench, 1 s simulated": (SHORT, "short"), "leg, 40 s simulated": (LONG, "long")}
WAYS = ("one process", "two processes", "Dask, two workers")
MILLION = 1_000_000
ASKED = {"thousand": 90.0, "efficiency": 0.9, "dask": 1.05}


def plan_of(settings: dict[str, Any], runs: int) -> SweepPlan:
    """Specimens, one a seed."""
    shared = {**settings, "tolerance": 0.1}
    return SweepPlan({"settings": shared, "block": [{"grid": {"seed": {"count": runs}}}]})


@contextmanager
def cluster(
    folder: Path, workers: int = 2
) -> Iterator[tuple[str, tuple[subprocess.Popen[bytes], ...]]]:
    """A Dask scheduler on loopback with workers of one thread, as long as it is entered.

    Args:
        folder: Where workers put their files.
        workers: How many.

    Yields:
        Its address; its process and those of the workers.
    """
    from distributed import Client

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    address = f"tcp://127.0.0.1:{port}"
    options = [address, "--nthreads", "1", "--no-nanny", "--local-directory", str(folder)]
    scheduler = ["dask_scheduler", "--host", "127.0.0.1", "--port", port]
    processes = tuple(
        subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.{name}", *own, "--no-dashboard"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        for name, *own in (scheduler, *[["dask_worker", *options]] * workers)
    )
    try:
        with Client(address, timeout=60, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=60)
        yield address, processes
    finally:
        for process in reversed(processes):
            process.kill()
            process.wait()


def spent() -> float:
    """CPU time [s] of this process, of those that it started, and of theirs."""
    total = 0.0
    for process in (own := psutil.Process(), *own.children(recursive=True)):
        times = process.cpu_times()
        total += times.user + times.system
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return total + ended.ru_utime + ended.ru_stime


def sweep(plan: SweepPlan, folder: Path, way: str, address: str) -> dict[str, float]:
    """Times of a sweep [s]: wall, CPU of all and within runs, CPU of this process."""
    options: dict[str, Any] = {"scheduler": address} if way.startswith("Dask") else {}
    if not options:
        options = {"workers": WAYS.index(way) + 1}
    own, all_, start = time.process_time(), spent(), time.perf_counter()
    result = run_sweep(plan, folder, **options)
    wall = time.perf_counter() - start
    found = {"wall": wall, "all": spent() - all_, "own": time.process_time() - own}
    if result.failed:
        raise SystemExit(f"error: {result.failed} runs failed")
    table = result.table()
    inside = sum(table.column("made_wall_s").to_pylist())
    found["busy"] = inside / ((1 if way == WAYS[0] else 2) * wall)
    return {**found, "runs": sum(table.column("made_cpu_s").to_pylist())}


def books(folder: Path, count: int) -> dict[str, float]:
    """Cost of storing a row: CPU time [s], size [B], time of reading [s]."""
    small = run_sweep(plan_of(SHORT, 20), folder / "small", workers=2)
    templates = small.table().to_pylist()
    plan = plan_of(SHORT, count)
    record = store.read_record(folder / "small").model_copy(
        update={"plan": plan.content, "runs": count}
    )
    place = folder / "books"
    place.mkdir()
    write_json(place / store.SWEEP, record.model_dump(), indent=1)
    kept = store.Store(place, plan)
    start = time.process_time()
    for number in range(count):
        row = dict(templates[number % len(templates)], run=number, seed=number)
        # No two runs have the same digits, which compression would find.
        for name, value in row.items():
            if isinstance(value, float):
                row[name] = value * (1 + 1e-9 * number)
        kept.keep(row)
    kept.finish()
    keeping = time.process_time() - start
    start = time.process_time()
    store.Store(place, plan).close()
    opening = time.process_time() - start
    start = time.process_time()
    ask(
        place,
        "SELECT controller, median(rms_rad), quantile_cont(peak_rad, 0.9) FROM runs GROUP BY 1",
    )
    asking = time.process_time() - start
    start = time.process_time()
    plan_of(SHORT, 5000).check()
    checking = (time.process_time() - start) / 5000
    files = [path for path in (place / "runs").rglob("*") if path.is_file()]
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {
        "keeping": keeping / count,
        "bytes": sum(path.stat().st_size for path in files) / count,
        "files": len(files),
        "opening": opening / count,
        "asking": asking / count,
        "checking": checking,
        "memory": memory * 1024,
    }


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """All cases by all ways, which take turns, and the books."""
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with cluster(folder) as (address, _):
            for case, (settings, option) in CASES.items():
                runs = getattr(options, option)
                found[case] = {"runs": runs, "ways": {}}
                for way in WAYS:
                    place = folder / f"{case} {way}"
                    starting = sweep(plan_of(settings, 2), place / "start", way, address)
                    told = sweep(plan_of(settings, runs), place / "sweep", way, address)
                    beside = (told["all"] - told["runs"]) - (starting["all"] - starting["runs"])
                    told["beside"] = beside / runs
                    told["efficiency"] = told["runs"] / (told["runs"] + beside)
                    found[case]["ways"][way] = told
        found["books"] = books(folder, options.rows)
    return found


def tables(found: dict[str, Any]) -> str:
    """Times and efficiency by case and way; what a million runs need."""
    rows = []
    for case in CASES:
        ways, runs = found[case]["ways"], found[case]["runs"]
        for way in WAYS:
            told = ways[way]
            rows.append(
                (
                    case,
                    str(runs),
                    way,
                    results.number(1e3 * told["runs"] / runs),
                    results.number(1e3 * told["beside"], 2),
                    f"{told['efficiency']:.3f}",
                    results.number(told["wall"]),
                    f"{ways[WAYS[0]]['wall'] / told['wall']:.2f}",
                    f"{100 * told['busy']:.0f} %",
                )
            )
    head = ("runs of", "number", "by", "CPU time of a run, ms", "beside it, ms", "efficiency")
    head += ("wall time, s", "times as fast as one process", "workers inside runs")
    text = results.table(head, rows)
    dask = [found[case]["ways"] for case in CASES]
    ratios = " and ".join(
        f"{ways[WAYS[1]]['efficiency'] / ways[WAYS[2]]['efficiency']:.3f}" for ways in dask
    )
    asked = (
        f"Asked: a thousand one-second runs within {ASKED['thousand']:g} s; efficiency of two at "
        f"least {ASKED['efficiency']:g}; Dask at most {ASKED['dask']:g} of processes, here by CPU "
        f"time {ratios}. On a machine that does other work as well, wall times say "
        "little, and the start-up that is taken off scatters by a second of CPU time: so do "
        "efficiencies of sweeps as short as these, of which one can come out above 1."
    )
    return f"{text}\n{asked}\n\n{results.table(('a million runs', 'need'), million(found))}"


def million(found: dict[str, Any]) -> list[tuple[str, str]]:
    """Time and size of a sweep of a million runs, from the measured ones."""
    told = found["books"]
    rows = []
    for case in CASES:
        ways = found[case]["ways"]
        hours = ways[WAYS[1]]["runs"] / found[case]["runs"] * MILLION / 3600
        rows.append((f"CPU time of the runs, {case}", f"{hours:,.0f} h of one core"))
    own = min(found[case]["ways"][WAYS[2]]["own"] / found[case]["runs"] for case in CASES)
    return [
        *rows,
        ("to check before the first run", f"{told['checking'] * MILLION / 60:.1f} min"),
        ("Parquet files without traces", f"{told['bytes'] * MILLION / 1e6:,.0f} MB"),
        ("CPU time of the books alone", f"{told['keeping'] * MILLION / 60:.1f} min"),
        ("CPU time of the process that submits to Dask", f"{own * MILLION / 60:,.0f} min"),
        ("runs a second that it can keep busy", f"{1 / own:,.0f}"),
        ("to open the folder again", f"{told['opening'] * MILLION:.1f} s"),
        ("a question to all rows", f"{told['asking'] * MILLION:.1f} s"),
    ]


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--short", type=int, default=1000, help="runs of the knee bench")
    parser.add_argument("--long", type=int, default=6, help="runs of the leg")
    parser.add_argument("--rows", type=int, default=20_000, help="rows of the books alone")
