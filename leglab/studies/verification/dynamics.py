"""Cases c, d and the spool: oscillation, leak-down and the step of the valve."""

import math
from collections.abc import Iterator
from itertools import product

import numpy as np
from scipy.linalg import expm
from scipy.optimize import curve_fit

from leglab.studies.verification.experiment import (
    HELD,
    IDEAL,
    MASS,
    SOLVERS,
    Engine,
    Experiment,
    Solver,
    Trace,
    constant,
)
from leglab.studies.verification.geometry import (
    AREA_A,
    AREA_B,
    AREA_ROD,
    BULK_MODULUS,
    LEAKAGE,
    dynamic_viscosity_ratio,
    stiffness,
    volumes,
)
from leglab.studies.verification.rows import Row


def _decaying(t: np.ndarray, w: float, s: float, a: float, b: float, c: float) -> np.ndarray:
    return np.exp(-s * t) * (a * np.cos(w * t) + b * np.sin(w * t)) + c


def _oscillation(trace: Trace, frequency: float, decay: float) -> tuple[float, float]:
    """Angular frequency and decay rate [rad/s] of the velocity, fitted from a first guess."""
    t, v = trace.velocity_time, trace.velocity
    size = np.abs(v).max()
    fit, _ = curve_fit(_decaying, t, v / size, p0=(frequency, decay, 1.0, 0.0, 0.0), xtol=1e-14)
    return fit[0], fit[1]


def resonance() -> Iterator[Row]:
    """Case c: w_h = sqrt(k_h/m) between closed ports.

    The symplectic step of MuJoCo turns a frequency w into 2 asin(w h/2)/h.
    """
    for solver, position in product(SOLVERS, (0.04, 0.01, 0.07)):
        w = math.sqrt(stiffness(position) / MASS)
        shown = w
        if isinstance(solver, Engine):
            shown = 2 * math.asin(0.5 * w * solver.timestep) / solver.timestep
        trace = solver.run(
            Experiment(
                position=position,
                velocity=1e-3,
                pressure_a=5e6,
                pressure_b=5e6 * AREA_A / AREA_B,
                duration=0.2,
            )
        )
        yield Row(
            case="c",
            quantity=f"angular frequency at x = {position * 1e3:g} mm",
            solver=solver.name,
            unit="rad/s",
            expected=shown,
            got=_oscillation(trace, shown, 0.0)[0],
            tolerance=1e-4,
        )


def _linearised(position: float, leakage: float) -> np.ndarray:
    """Rates of (v, pA, pB) with closed ports and a leaking seal, shape (3, 3)."""
    va, vb = volumes(position)
    return np.array(
        [
            [0.0, AREA_A / MASS, -AREA_B / MASS],
            [-BULK_MODULUS * AREA_A / va, *(BULK_MODULUS / va * leakage * np.array([-1, 1]))],
            [BULK_MODULUS * AREA_B / vb, *(BULK_MODULUS / vb * leakage * np.array([1, -1]))],
        ]
    )


def _shown_pole(rates: np.ndarray, solver: Solver) -> complex:
    """Oscillating eigenvalue [1/s] of the linear model, or of MuJoCo's step of it."""
    if not isinstance(solver, Engine):
        return complex(max(np.linalg.eigvals(rates), key=lambda z: z.imag))
    h = solver.timestep
    kick = np.eye(3)
    kick[0] += h * rates[0]
    flow = np.vstack([np.zeros(3), rates[1:]])  # v held
    multiplier = max(np.linalg.eigvals(expm(h * flow) @ kick), key=lambda z: z.imag)
    return complex(np.log(multiplier)) / h


def damping() -> Iterator[Row]:
    """Case c: damping ratio 0.042 that the leakage gives.

    The symplectic step shows that of its own map: kick of v by the old pressures, then the exact
    flow of the pressures at the new v.
    """
    for solver in SOLVERS:
        pole = _shown_pole(_linearised(0.04, LEAKAGE), solver)
        pressure = 8e6  # equal pressures do not leak; the load carries the rod's share
        trace = solver.run(
            Experiment(
                parameters={**IDEAL, "internal_leakage": LEAKAGE},
                velocity=1e-3,
                pressure_a=pressure,
                pressure_b=pressure,
                load=constant(pressure * AREA_ROD),
                duration=0.1,
            )
        )
        w, s = _oscillation(trace, pole.imag, -pole.real)
        yield Row(
            case="c",
            quantity="damping ratio with C_i = 1.7e-13, as the step shows it",
            solver=solver.name,
            unit="1",
            expected=-pole.real / abs(pole),
            got=s / math.hypot(w, s),
            tolerance=0.01,
        )


def leak_down() -> Iterator[Row]:
    """Case d: pressures of a held piston meet with tau = V_A V_B/(V_A + V_B)/(beta C_i).

    A time constant of two steps needs finer sub-steps than the default two: the attribute
    `substeps` is raised to 4 where tau is below ten steps, and the row says so.
    """
    va, vb = volumes(0.04)
    cases = [
        (1.0, 1.0, 40.0),
        (0.1, 1.0, 40.0),
        (1.0, 2.0, 40.0),
        (1.0, 1.0, 0.0),
        (1.0, 1.0, 80.0),
    ]
    for solver, (part, clearance, celsius) in product(SOLVERS, cases):
        leakage = part * LEAKAGE * clearance**3 / dynamic_viscosity_ratio(celsius)
        tau = va * vb / (va + vb) / (BULK_MODULUS * leakage)
        fine = isinstance(solver, Engine) and tau < 10 * solver.timestep
        substeps = 4.0 if fine else 2.0
        trace = solver.run(
            Experiment(
                parameters={
                    **IDEAL,
                    "internal_leakage": part * LEAKAGE,
                    "seal_clearance": clearance,
                    "oil_temperature": celsius,
                    "substeps": substeps,
                },
                mass=HELD,
                pressure_a=14e6,
                pressure_b=2e6,
                duration=round(12 * tau, 3),
            )
        )
        difference = trace.pressure_a - trace.pressure_b
        part_used = trace.time <= 4 * tau
        slope = np.polyfit(trace.time[part_used], np.log(difference[part_used]), 1)[0]
        label = f"C_i {part * LEAKAGE:.2g}, clearance x{clearance:g}, {celsius:g} degC"
        label += ", substeps 4" if fine else ""
        yield Row(
            case="d",
            quantity=f"time constant, {label}",
            solver=solver.name,
            unit="s",
            expected=tau,
            got=-1 / slope,
            tolerance=1e-3,
        )
        yield Row(
            case="d",
            quantity=f"pressure in the end, {label}",
            solver=solver.name,
            unit="Pa",
            expected=(va * 14e6 + vb * 2e6) / (va + vb),
            got=float(trace.pressure_a[-1]),
            tolerance=1e-3,
        )


def spool_step() -> Iterator[Row]:
    """Peak of the second-order spool at 250 Hz and zeta 0.7: 1 + exp(-pi zeta/sqrt(1 - zeta^2))."""
    w, zeta, command = 2 * math.pi * 250.0, 0.7, 0.5
    root = math.sqrt(1 - zeta**2)
    for solver in SOLVERS:
        trace = solver.run(
            Experiment(mass=HELD, command=constant(command), ideal_spool=False, duration=0.01)
        )
        peak = int(np.argmax(trace.spool))
        time = trace.time[peak]  # samples need not hit the peak: compare at the sample
        phase = w * root * time
        wave = math.cos(phase) + zeta / root * math.sin(phase)
        yield Row(
            case="valve step",
            quantity=f"largest sample of the spool over the command, at {time * 1e3:.3f} ms",
            solver=solver.name,
            unit="1",
            expected=1 - math.exp(-zeta * w * time) * wave,
            got=float(trace.spool[peak]) / command,
            tolerance=1e-6,
        )
