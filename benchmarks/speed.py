"""One cylinder's update against the straight-line C++ loop of its own arithmetic.

`straight_line.cc` holds the arithmetic of the default step (two sub-steps, oil with air, LuGre
friction, leakage) in a row, without parameters, guards, error estimate, hysteresis, wear,
temperature and the books of energy. Compiled here with the flags of the core, it says what the
structure of the core costs. Both run the same motion and must end in the same state.

Run: python -m benchmarks speed
"""

import argparse
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import results
from leglab.machine.cylinder import Cylinder

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
            commands, TIMESTEP, mass=20.0, position=0.04, pressure_a=6e6, pressure_b=9.8e6
        )
        best = min(best, time.perf_counter() - start)
    return np.array([best / STEPS * 1e9, *out[-1, :4]])


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Both tables' figures.

    Raises:
        SystemExit: The two loops do not compute the same.
    """
    del options
    bare, ours = straight_line(), core()
    if not np.allclose(bare[1:], ours[1:], rtol=1e-5):
        raise SystemExit(f"the two loops end at {bare[1:]} and {ours[1:]}")
    return {
        "straight_line_ns": bare[0],
        "cylinder_ns": ours[0],
        "substeps": {
            f"{n:g}": [core(substeps=n, entrained_air=air)[0] for air in (0.005, 0.0)]
            for n in (1.0, 2.0, 4.0)
        },
    }


def tables(found: dict[str, Any]) -> str:
    """The two loops, and sub-steps with and without air."""
    bare, ours = found["straight_line_ns"], found["cylinder_ns"]
    loops = results.table(
        ("one update, 2 sub-steps, oil with air", "ns", "ratio"),
        [
            ("straight-line C++ loop of its own arithmetic", f"{bare:.0f}", "1"),
            ("`Cylinder.simulate`", f"{ours:.0f}", f"{ours / bare:.2f}"),
        ],
    )
    if not found["substeps"]:
        return loops
    rows = [(n, *(f"{ns:.0f}" for ns in row)) for n, row in found["substeps"].items()]
    return f"{loops}\n{results.table(('sub-steps', 'ns with air', 'ns without air'), rows)}"
