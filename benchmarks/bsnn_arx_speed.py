"""Time per sample of the identification core, all of it measured in one run.

    python -m benchmarks bsnn_arx_speed [--out DIR]

Prints the paper's model in the core, through `run` and through single `update` calls from Python
beside a bare C++ loop of the same arithmetic and padasip's recursive least squares step. With
--out also writes cost.png: cost against the number of splines (local rule: constant once the basis
is evaluated locally, at most linear) and of linear parameters (quadratic). Needs g++ and padasip.
"""

import argparse
import ctypes
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from benchmarks import results
from leglab.identification import BsnnArx, BsnnArxSettings

HERE = Path(__file__).parent
FLAGS = ["-std=c++20", "-O3", "-fPIC", "-shared", "-ffp-contract=off", "-fno-math-errno"]
SAMPLES = 20_000
CALLS = 2000
SPLINES = (8, 16, 32, 64, 128, 256, 512)
PARAMETERS = (4, 6, 8, 12, 16, 24, 32, 48, 64, 96)


def fastest(works: dict[str, tuple[Callable[[], object], int]], passes: int) -> dict[str, float]:
    """Least nanoseconds a sample; the works take turns, so that all see the same machine."""
    best = dict.fromkeys(works, np.inf)
    for _ in range(passes):
        for name, (work, samples) in works.items():
            start = time.perf_counter()
            work()
            best[name] = min(best[name], (time.perf_counter() - start) / samples * 1e9)
    return best


def library(folder: str) -> ctypes.CDLL:
    """The C++ side, compiled with the flags of CMakeLists.txt."""
    path = Path(folder) / "speed.so"
    include = f"-I{HERE.parent / 'leglab' / 'csrc'}"
    source = HERE / "bsnn_arx_speed.cc"
    subprocess.run(["g++", *FLAGS, include, source, "-o", path], check=True)
    return ctypes.CDLL(str(path))


def works(native: ctypes.CDLL) -> dict[str, tuple[Callable[[], object], int]]:
    """Calls to be timed, each with its number of samples."""
    import padasip

    rng = np.random.default_rng(1)
    u, y = rng.uniform(0, 0.8, SAMPLES), np.zeros(SAMPLES)
    for t in range(2, SAMPLES):
        y[t] = 1.2 * y[t - 1] - 0.5 * y[t - 2] + 0.1 * np.tanh(u[t])
    data = (*(ctypes.c_void_p(x.ctypes.data) for x in (u, y)), SAMPLES)
    paper = BsnnArxSettings.paper_mode()
    single, six = BsnnArx(paper), BsnnArx(paper, joints=6)
    pairs = list(zip(u[:CALLS].tolist(), y[:CALLS].tolist(), strict=True))
    rows = list(zip(rng.uniform(0, 0.8, (CALLS, 6)), rng.uniform(0, 0.4, (CALLS, 6)), strict=True))
    peer = padasip.filters.FilterRLS(n=6, mu=1.0, eps=1 / 5.6, w="zeros")

    def update() -> None:
        for sample in pairs:
            single.update(*sample)

    def update_six() -> None:
        for sample in rows:
            six.update(*sample)

    def adapt() -> None:
        for row, _ in rows:
            peer.adapt(0.1, row)

    return {
        # y lives in u and y for as long as the closures do
        "bare": (lambda keep=(u, y): native.bare(*data), SAMPLES),
        "core_double": (lambda: native.core_double(*data, 8, 6), SAMPLES),
        "core_float": (lambda: native.core_float(*data, 8, 6), SAMPLES),
        "run from Python": (lambda: BsnnArx(paper).run(u, y), SAMPLES),
        "update": (update, CALLS),
        "update of six joints": (update_six, CALLS),
        "padasip RLS step": (adapt, CALLS),
        **{f"splines {n}": (lambda n=n: native.core_double(*data, n, 6), SAMPLES) for n in SPLINES},
        **{f"rls {n}": (lambda n=n: native.core_double(*data, 8, n), SAMPLES) for n in PARAMETERS},
    }


def series(best: dict[str, float], name: str, sizes: tuple[int, ...]) -> list[float]:
    """Times of one family in the order of its sizes."""
    return [best[f"{name} {n}"] for n in sizes]


def plot(best: dict[str, float], path: Path) -> None:
    """Cost against splines and against linear parameters."""
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
    splines, linear = series(best, "splines", SPLINES), series(best, "rls", PARAMETERS)
    axes[0].semilogx(SPLINES, splines, "o-")
    axes[0].set(xlabel="number of splines", ylim=(0, 2 * max(splines)))
    axes[1].loglog(PARAMETERS, linear, "o-", label="measured")
    n = np.array(PARAMETERS)
    axes[1].loglog(n, linear[-1] * (n / n[-1]) ** 2, "--", label="quadratic")
    axes[1].set(xlabel="number of linear parameters")
    axes[1].legend()
    for axis in axes:
        axis.set(ylabel="time a sample [ns]")
    figure.savefig(path, dpi=150)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Nanoseconds a sample by what is timed, and the powers of growth."""
    with tempfile.TemporaryDirectory() as folder:
        best = fastest(works(library(folder)), options.passes)
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        plot(best, options.out / "cost.png")
    powers = {}
    for name, sizes in (("splines", SPLINES), ("rls", PARAMETERS)):
        times = series(best, name, sizes)
        powers[name] = float(np.polyfit(np.log(sizes[-4:]), np.log(times[-4:]), 1)[0])
    return {**best, "power": powers}


def tables(found: dict[str, Any]) -> str:
    """Beside the bare loop and padasip; growth with splines and with linear parameters."""
    bare, peer = found["bare"], found["padasip RLS step"]
    names = ("bare", "core_double", "core_float", "run from Python", "update")
    rows = [
        (name, f"{found[name]:.0f}", f"{found[name] / bare:.2f}", f"{peer / found[name]:.1f}")
        for name in (*names, "update of six joints", "padasip RLS step")
    ]
    text = results.table(("paper's model", "ns a sample", "over bare", "padasip over it"), rows)
    for name, sizes in (("splines", SPLINES), ("rls", PARAMETERS)):
        times = [f"{time:.0f}" for time in series(found, name, sizes)]
        head = (f"number of {name}", *map(str, sizes), "power of the last four")
        text += "\n" + results.table(head, [("ns a sample", *times, f"{found['power'][name]:.2f}")])
    return text


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", type=Path, help="folder for cost.png")
    parser.add_argument("--passes", type=int, default=40, help="of which the fastest counts")
