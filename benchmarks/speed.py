"""One cylinder's update against the straight-line C++ loop of its own arithmetic.

`straight_line.cc` holds the arithmetic of the default step (two sub-steps, oil with air, LuGre
friction, leakage) in a row, without parameters, guards, error estimate, hysteresis, wear,
temperature and the books of energy. Compiled here with the flags of the core, it says what the
structure of the core costs. Both run the same motion; the final states show that they compute
the same.

Run: python benchmarks/speed.py
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from leglab.hydraulics import Cylinder

# Two seconds: longer, and the leaking null would creep into the end stops.
STEPS, TIMESTEP, REPEATS = 4000, 5e-4, 200
# As in CMakeLists.txt, which builds the core with the Release defaults -O3 -DNDEBUG.
FLAGS = ["-std=c++20", "-O3", "-DNDEBUG", "-ffp-contract=off", "-fno-math-errno"]
SIZE = {"bore": 0.016, "rod": 0.010, "stroke": 0.080}


def straight_line() -> np.ndarray:
    """Nanoseconds a step and the final x, v, pA, pB of the bare loop, shape (5,)."""
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "straight_line"
        source = Path(__file__).parent / "straight_line.cc"
        subprocess.run(["g++", *FLAGS, str(source), "-o", str(program)], check=True)
        output = subprocess.run([str(program)], check=True, capture_output=True, text=True)
    return np.array([float(word) for word in output.stdout.split()])


def core(**parameters: float) -> np.ndarray:
    """The same from `Cylinder.simulate`."""
    cylinder = Cylinder({**SIZE, **parameters})
    commands = 0.1 * np.sin(2 * np.pi * 2 * TIMESTEP * np.arange(STEPS))
    best = np.inf
    for _ in range(REPEATS):
        start = time.perf_counter()
        out = cylinder.simulate(
            commands,
            TIMESTEP,
            mass=20.0,
            position=0.04,
            pressure_a=6e6,
            pressure_b=9.8e6,
        )
        best = min(best, time.perf_counter() - start)
    return np.array([best / STEPS * 1e9, *out[-1, :4]])


def main() -> int:
    bare, ours = straight_line(), core()
    grid = Table(title="One cylinder's update, 2 sub-steps, oil with air", title_justify="left")
    for heading in ("loop", "ns a step", "ratio", "final x mm", "pA bar", "pB bar"):
        grid.add_column(heading, justify="left" if heading == "loop" else "right")
    for name, row in (("straight line", bare), ("Cylinder.simulate", ours)):
        ns, x, _, pa, pb = row
        grid.add_row(
            name,
            f"{ns:.0f}",
            f"{ns / bare[0]:.2f}",
            f"{x * 1e3:.6f}",
            f"{pa / 1e5:.5f}",
            f"{pb / 1e5:.5f}",
        )
    console = Console()
    console.print(grid)
    variants = Table(title="Cylinder.simulate", title_justify="left")
    for heading in ("sub-steps", "with air ns", "without air ns"):
        variants.add_column(heading, justify="right")
    for substeps in (1.0, 2.0, 4.0):
        cells = [core(substeps=substeps, entrained_air=air)[0] for air in (0.005, 0.0)]
        variants.add_row(f"{substeps:g}", *(f"{ns:.0f}" for ns in cells))
    console.print(variants)
    same = np.allclose(bare[1:], ours[1:], rtol=1e-5)
    if not same:
        console.print("[red]the two loops do not compute the same[/red]")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
