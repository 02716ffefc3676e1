"""Time per sample of the identification core, all of it measured in one run.

    python benchmarks/bsnn_arx_speed.py [--out DIR]

Prints the paper's model in the core, through `run` and through single `update` calls from Python
beside a bare C++ loop of the same arithmetic and padasip's recursive least squares step. With
--out also writes cost.png: cost against the number of splines (local rule: constant once the basis
is evaluated locally, at most linear) and of linear parameters (quadratic). Needs g++ and padasip.
"""

import argparse
import subprocess
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import padasip

from leglab.identification import BsnnArx, BsnnArxSettings

HERE = Path(__file__).parent
FLAGS = ["-std=c++20", "-O3", "-ffp-contract=off", "-fno-math-errno"]  # as CMakeLists.txt
PASSES = 15


def core() -> dict[str, dict[int, float]]:
    """Least nanoseconds a sample by name and size, from the C++ program."""
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "speed"
        source = HERE / "bsnn_arx_speed.cc"
        include = f"-I{HERE.parent / 'leglab' / 'csrc'}"
        subprocess.run(["g++", *FLAGS, include, source, "-o", program], check=True)
        lines = subprocess.run([program], check=True, capture_output=True, text=True).stdout
    found: dict[str, dict[int, float]] = defaultdict(dict)
    for line in lines.splitlines():
        name, size, nanoseconds = line.split()
        best = found[name].get(int(size), np.inf)
        found[name][int(size)] = min(best, float(nanoseconds))
    return found


def fastest(call: Callable[[], object], samples: int) -> float:
    """Least nanoseconds a sample over the passes."""
    times = []
    for _ in range(PASSES):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return min(times) / samples * 1e9


def python() -> dict[str, float]:
    """Nanoseconds a sample of batch and single calls, and of padasip's step, from Python."""
    rng = np.random.default_rng(1)
    u, y = rng.uniform(0, 0.8, 20_000), rng.uniform(-0.2, 0.2, 20_000)
    batch, single = BsnnArx(BsnnArxSettings.paper_mode()), BsnnArx(BsnnArxSettings.paper_mode())
    six = BsnnArx(BsnnArxSettings.paper_mode(), joints=6)
    u6, y6 = rng.uniform(0, 0.8, 6), rng.uniform(-0.2, 0.2, 6)
    pairs = list(zip(u[:2000].tolist(), y[:2000].tolist(), strict=True))
    peer = padasip.filters.FilterRLS(n=6, mu=1.0, eps=1 / 5.6, w="zeros")
    rows = list(rng.standard_normal((2000, 6)))

    def update() -> None:
        for sample in pairs:
            single.update(*sample)

    def update_six() -> None:
        for _ in range(2000):
            six.update(u6, y6)

    def adapt() -> None:
        for row in rows:
            peer.adapt(0.1, row)

    return {
        "run": fastest(lambda: batch.run(u, y), len(u)),
        "update": fastest(update, 2000),
        "update of six joints": fastest(update_six, 2000),
        "padasip": fastest(adapt, 2000),
    }


def plot(found: dict[str, dict[int, float]], path: Path) -> None:
    """Cost against splines and against linear parameters."""
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
    for axis, name, label in zip(
        axes, ("splines", "rls"), ("splines", "linear parameters"), strict=True
    ):
        sizes, times = zip(*sorted(found[name].items()), strict=True)
        axis.loglog(sizes, times, "o-", label="measured")
        axis.set(xlabel=f"number of {label}", ylabel="time a sample [ns]")
    n = np.array(sorted(found["rls"]))
    axes[1].loglog(n, found["rls"][n[-1]] * (n / n[-1]) ** 2, "--", label="quadratic")
    axes[0].set_ylim(bottom=10)
    axes[1].legend()
    figure.savefig(path, dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    found, calls = core(), python()
    bare = found["bare"][6]
    print(f"bare loop                  {bare:8.1f} ns")
    for name in ("core_double", "core_float"):
        print(f"{name:26s} {found[name][6]:8.1f} ns = {found[name][6] / bare:.2f} x bare")
    print(f"run from Python            {calls['run']:8.1f} ns = {calls['run'] / bare:.2f} x bare")
    print(f"padasip RLS step           {calls['padasip']:8.1f} ns")
    for name in ("update", "update of six joints"):
        ratio = calls["padasip"] / calls[name]
        print(f"{name:26s} {calls[name]:8.1f} ns = padasip / {ratio:.1f}")
    for name in ("splines", "rls"):
        print(name, "  ".join(f"{n}: {t:.0f}" for n, t in sorted(found[name].items())))
    sizes, times = zip(*sorted(found["rls"].items()), strict=True)
    slope = np.polyfit(np.log(sizes[-5:]), np.log(times[-5:]), 1)[0]
    print(f"cost of the linear part grows with power {slope:.2f} over {sizes[-5]} to {sizes[-1]}")
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        plot(found, options.out / "cost.png")


if __name__ == "__main__":
    main()
