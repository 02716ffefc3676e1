"""Accuracy against cost of the fixed-step scheme, beside stiff reference solvers.

A 20 kg mass on the cylinder of physics.md follows half a second of valve commands held for 1 ms:
sines, a step and a reversal. Errors are those at the ends of the milliseconds against LSODA with a
relative tolerance of 1e-10, itself compared with Radau. "naive" is what a first plugin does: force
from the old pressures, pressures by explicit Euler with the old velocity.

Without air the continuous model lets oil under tension where the scheme lets it boil; where the
motion touches that, the two keep a difference that no step removes.

Run: python benchmarks/integration_accuracy.py
"""

import sys
import time
from collections.abc import Callable
from itertools import product

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.integrate import solve_ivp

from leglab.hydraulics import Cylinder

SIZE = {"bore": 0.016, "rod": 0.010, "stroke": 0.080}
HOLD, DURATION, MASS = 1e-3, 0.5, 20.0  # s, s, kg
START = {"position": 0.03, "pressure_a": 6e6, "pressure_b": 9.846e6}
NO_AIR = {"entrained_air": 0.0, "coulomb": 0.0, "static": 0.0, "sigma_0": 0.0, "sigma_1": 0.0}
MODELS = {"no air, viscous friction": NO_AIR, "air and LuGre friction": {}}
# What physics.md reports for n = 4 without air at 1 ms: mm, bar, ns.
ASKED = (0.04, 1.9, 460.0)


def commands() -> np.ndarray:
    """Valve commands, one a millisecond, shape (n,)."""
    t = HOLD * np.arange(round(DURATION / HOLD))
    smooth = 0.15 * np.sin(2 * np.pi * 5 * t) + 0.1 * np.sin(2 * np.pi * 13 * t)
    return smooth + np.where((t > 0.2) & (t < 0.3), 0.3, 0.0) - np.where(t >= 0.3, 0.2, 0.0)


def reference(cylinder: Cylinder, method: str, rtol: float) -> tuple[np.ndarray, float]:
    """x, pA, pB after every millisecond, shape (n, 3), and the seconds spent."""
    state = cylinder.initial_state(**START)
    scale = np.array([1e-3, 1e-2, 1e-3, 1e-1, 1e4, 1e4, 1e-6] + [1e-3] * 6)
    rows, begin = [], time.perf_counter()
    for u in commands():
        solution = solve_ivp(
            lambda _, y, u=u: cylinder.derivative(y, command=u, mass=MASS),
            (0.0, HOLD),
            state,
            method=method,
            rtol=rtol,
            atol=rtol * scale,
        )
        state = solution.y[:, -1]
        rows.append(state[[0, 4, 5]])
    return np.array(rows), time.perf_counter() - begin


def scheme(parameters: dict[str, float], substeps: int, h: float) -> tuple[np.ndarray, float]:
    """The same from the plugin's scheme, and nanoseconds a step."""
    cylinder = Cylinder({**SIZE, **parameters, "substeps": float(substeps)})
    every = round(HOLD / h)
    held = np.repeat(commands(), every)
    best = np.inf
    for _ in range(10):
        begin = time.perf_counter()
        out = cylinder.simulate(held, HOLD / every, mass=MASS, **START)
        best = min(best, time.perf_counter() - begin)
    return out[every - 1 :: every][:, [0, 2, 3]], best / len(held) * 1e9


def naive(cylinder: Cylinder, h: float) -> np.ndarray:
    """Symplectic Euler for the mass, explicit Euler for everything else, at step h."""
    state = cylinder.initial_state(**START)
    rows = []
    for u in commands():
        for _ in range(round(HOLD / h)):
            rate = cylinder.derivative(state, command=u, mass=MASS)
            old = state[0]
            state = state + h * rate
            state[0] = old + h * state[1]
            if not np.all(np.abs(state) < 1e12):
                return np.array(rows)
        rows.append(state[[0, 4, 5]])
    return np.array(rows)


def errors(got: np.ndarray, wanted: np.ndarray) -> tuple[str, str, str]:
    """RMS and largest error of x [mm] and RMS of both pressures [bar], as text."""
    if len(got) < len(wanted):
        return f"lost at {len(got)} ms", "", ""
    x = (got[:, 0] - wanted[:, 0]) * 1e3
    p = (got[:, 1:] - wanted[:, 1:]) / 1e5
    return (
        f"{np.sqrt(np.mean(x**2)):.4f}",
        f"{np.abs(x).max():.4f}",
        f"{np.sqrt(np.mean(p**2)):.2f}",
    )


def timed(title: str, parameters: dict[str, float], report: Callable[[object], None]) -> None:
    grid = Table(title=title, title_justify="left")
    grid.add_column("solver")
    for heading in ("h ms", "n", "x rms mm", "x max mm", "p rms bar", "ns a step", "us a ms"):
        grid.add_column(heading, justify="right")
    cylinder = Cylinder({**SIZE, **parameters})
    exact, spent = reference(cylinder, "LSODA", 1e-10)
    count = round(DURATION / HOLD)
    grid.add_row("LSODA 1e-10", "", "", "0", "0", "0", "", f"{spent / count * 1e6:.0f}")
    stiff, spent = reference(cylinder, "Radau", 1e-8)
    grid.add_row("Radau 1e-8", "", "", *errors(stiff, exact), "", f"{spent / count * 1e6:.0f}")
    for h in (1e-3, 5e-4, 1e-4, 1e-5):
        grid.add_row("naive", f"{h * 1e3:g}", "", *errors(naive(cylinder, h), exact), "", "")
    grid.add_section()
    for h, substeps in product((1e-3, 5e-4, 2.5e-4), (1, 2, 4, 8)):
        got, ns = scheme(parameters, substeps, h)
        cost = ns * HOLD / h * 1e-3
        grid.add_row(
            "leglab",
            f"{h * 1e3:g}",
            f"{substeps}",
            *errors(got, exact),
            f"{ns:.0f}",
            f"{cost:.2f}",
        )
    report(grid)
    lowest = exact[:, 1:].min() / 1e5
    report(f"lowest pressure of the reference: {lowest:.2f} bar gauge\n")


def main() -> int:
    console = Console()
    for title, parameters in MODELS.items():
        timed(title, parameters, console.print)
    console.print(
        f"physics.md, without air, h = 1 ms, n = 4: {ASKED[0]} mm, {ASKED[1]} bar, "
        f"{ASKED[2]:.0f} ns (another motion, another machine)"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
