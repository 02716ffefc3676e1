"""Accuracy against cost of the fixed-step scheme, beside stiff reference solvers.

A 20 kg mass on the cylinder of docs/concepts/physics.md follows half a second of valve commands
held for 1 ms: sines, a step and a reversal. Errors are those at the ends of the milliseconds
against LSODA with a relative tolerance of 1e-10, itself compared with Radau. "naive" is what a
first plugin does: force from the old pressures, pressures by explicit Euler with the old velocity.

Without air the continuous model lets oil under tension where the scheme lets it boil; where the
motion touches that, the two keep a difference that no step removes. Times are of the processor.

Run: python -m benchmarks integration_accuracy
"""

import argparse
import time
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks import results
from leglab.base.scale import rms
from leglab.machine.cylinder import Cylinder

SIZE = {"bore": 0.016, "rod": 0.010, "stroke": 0.080}
HOLD, DURATION, MASS = 1e-3, 0.5, 20.0  # s, s, kg
START = {"position": 0.03, "pressure_a": 6e6, "pressure_b": 9.846e6}
NO_AIR = {"entrained_air": 0.0, "coulomb": 0.0, "static": 0.0, "sigma_0": 0.0, "sigma_1": 0.0}
NAIVE = (1e-3, 5e-4, 1e-5)  # s
PASSES = 3  # of the reference solvers; the fastest counts
SCHEME = ((1e-3, 1), (1e-3, 2), (1e-3, 4), (5e-4, 2), (2.5e-4, 2))  # s, sub-steps
MODELS = {"air and LuGre friction": {}, "no air, viscous friction": NO_AIR}


def commands() -> np.ndarray:
    """Valve commands, one a millisecond, shape (n,)."""
    t = HOLD * np.arange(round(DURATION / HOLD))
    smooth = 0.15 * np.sin(2 * np.pi * 5 * t) + 0.1 * np.sin(2 * np.pi * 13 * t)
    return smooth + np.where((t > 0.2) & (t < 0.3), 0.3, 0.0) - np.where(t >= 0.3, 0.2, 0.0)


def reference(cylinder: Cylinder, method: str, rtol: float) -> tuple[np.ndarray, float]:
    """x, pA, pB after each millisecond, shape (n, 3), and processor seconds of the fastest pass."""
    passes = [_reference(cylinder, method, rtol) for _ in range(PASSES)]
    return passes[0][0], min(seconds for _, seconds in passes)


def _reference(cylinder: Cylinder, method: str, rtol: float) -> tuple[np.ndarray, float]:
    state = cylinder.initial_state(**START)
    scale = np.array([1e-3, 1e-2, 1e-3, 1e-1, 1e4, 1e4, 1e-6] + [1e-3] * 6)
    rows, begin = [], time.process_time()
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
    return np.array(rows), time.process_time() - begin


def scheme(parameters: dict[str, float], substeps: int, h: float) -> tuple[np.ndarray, float]:
    """The same from the plugin's scheme, and nanoseconds a step."""
    cylinder = Cylinder({**SIZE, **parameters, "substeps": float(substeps)})
    every = round(HOLD / h)
    held = np.repeat(commands(), every)
    best = np.inf
    for _ in range(10):
        begin = time.process_time()
        out = cylinder.simulate(held, HOLD / every, mass=MASS, **START)
        best = min(best, time.process_time() - begin)
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


def errors(got: np.ndarray, wanted: np.ndarray) -> dict[str, float]:
    """RMS and largest error of x [mm] and RMS of both pressures [bar], or when lost [ms]."""
    if len(got) < len(wanted):
        return {"lost_ms": len(got)}
    x = (got[:, 0] - wanted[:, 0]) * 1e3
    p = (got[:, 1:] - wanted[:, 1:]) / 1e5
    return {
        "x_rms_mm": rms(x),
        "x_max_mm": np.abs(x).max(),
        "p_rms_bar": rms(p),
    }


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Rows and lowest pressure of the reference, by model."""
    del options
    return {title: compared(parameters) for title, parameters in MODELS.items()}


def compared(parameters: dict[str, float]) -> list[dict[str, Any]]:
    """Every solver against LSODA."""
    cylinder = Cylinder({**SIZE, **parameters})
    exact, spent = reference(cylinder, "LSODA", 1e-10)
    per_ms = 1e6 * HOLD / DURATION
    rows = [{"solver": "LSODA 1e-10", **errors(exact, exact), "us_a_ms": spent * per_ms}]
    stiff, spent = reference(cylinder, "Radau", 1e-8)
    rows.append({"solver": "Radau 1e-8", **errors(stiff, exact), "us_a_ms": spent * per_ms})
    for h in NAIVE:
        row = {"solver": "naive explicit", "h_ms": h * 1e3}
        rows.append({**row, **errors(naive(cylinder, h), exact)})
    for h, substeps in SCHEME:
        got, ns = scheme(parameters, substeps, h)
        row = {"solver": "leglab", "h_ms": h * 1e3, "substeps": substeps}
        rows.append({**row, **errors(got, exact), "us_a_ms": ns * HOLD / h * 1e-3})
    return rows


def tables(found: dict[str, Any]) -> str:
    """A table a model."""
    return "\n".join(grid(title, rows) for title, rows in found.items())


def grid(title: str, rows: list[dict[str, Any]]) -> str:
    """Errors and cost of every solver."""
    head = (title, "h, ms", "sub-steps", "x rms, mm", "x max, mm", "p rms, bar", "µs a ms")
    cells = []
    for row in rows:
        lost = row.get("lost_ms")
        cells.append(
            (
                row["solver"],
                f"{row['h_ms']:g}" if "h_ms" in row else "",
                str(row.get("substeps", "")),
                fixed(row.get("x_rms_mm"), 3) if lost is None else f"lost at {lost} ms",
                fixed(row.get("x_max_mm"), 3),
                fixed(row.get("p_rms_bar"), 2),
                results.number(row.get("us_a_ms")),
            )
        )
    return results.table(head, cells)


def fixed(value: float | None, decimals: int) -> str:
    """So many decimals; nothing for None."""
    return "" if value is None else f"{value:.{decimals}f}"
