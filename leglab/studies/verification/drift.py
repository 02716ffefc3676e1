"""Case e: a closed valve holds a load while its seal leaks."""

import math
from collections.abc import Iterator

import numpy as np
from scipy.optimize import root

from leglab.studies.verification.experiment import (
    IDEAL,
    SOLVERS,
    SUPPLY_PRESSURE,
    Experiment,
    Solver,
    constant,
)
from leglab.studies.verification.geometry import (
    AREA_A,
    AREA_B,
    AREA_ROD,
    BULK_MODULUS,
    GAIN,
    LEAKAGE,
    volumes,
)
from leglab.studies.verification.rows import Row

_VISCOUS = 700.0  # N s/m
_LEAKING = {**IDEAL, "internal_leakage": LEAKAGE, "viscous": _VISCOUS}


def _speed(solver: Solver, experiment: Experiment) -> float:
    """Mean speed over the last quarter [m/s]."""
    trace = solver.run(experiment)
    n = len(trace.time) // 4
    return float((trace.position[-1] - trace.position[-n]) / (trace.time[-1] - trace.time[-n]))


def open_drift() -> Iterator[Row]:
    """e1, e2: v = -C_i F/(A^2 + C_i b) where the other side takes the leak up."""
    load = 1000.0
    expected = -LEAKAGE * load / (AREA_A**2 + LEAKAGE * _VISCOUS)
    variants = {
        # Without a rod both sides are alike and the leak goes from one to the other.
        "symmetric cylinder": ({"rod": 0.0}, 8e6, 8e6 - load / AREA_A),
        "side B vented": ({"external_leakage_b": 1e-9}, load / AREA_A, 0.0),
    }
    for solver in SOLVERS:
        for name, (change, pressure_a, pressure_b) in variants.items():
            experiment = Experiment(
                parameters={**_LEAKING, **change},
                pressure_a=pressure_a,
                pressure_b=pressure_b,
                load=constant(load),
                duration=2.0,
            )
            yield Row(
                case="e",
                quantity=f"drift under 1 kN, {name}",
                solver=solver.name,
                unit="m/s",
                expected=expected,
                got=_speed(solver, experiment),
                tolerance=5e-3,
            )


def blocked_drift() -> Iterator[Row]:
    """e3: with both ports blocked pressures meet at F/A_rod; oil and rod volume give the way.

    The model passes the leak by volume, so that V_A pA + V_B pB + beta A_rod x is conserved but
    for second-order terms of p/beta, hence dx; the slow time constant follows from the linearised
    rates at the end position.
    """
    pressure_b = 2e6
    for solver in SOLVERS:
        for load in (500.0, 1000.0, 2000.0):
            pressure_a = (load + pressure_b * AREA_B) / AREA_A
            start, level = 0.04, load / AREA_ROD
            va, vb = volumes(start)
            compressed = va * pressure_a + vb * pressure_b - (va + vb) * level
            way = compressed / (BULK_MODULUS * AREA_ROD)
            va, vb = volumes(start + way)
            share = (AREA_A / va + AREA_B / vb) / (AREA_A**2 / va + AREA_B**2 / vb)
            tau = vb / (BULK_MODULUS * LEAKAGE * (1 - AREA_B / AREA_A) * (1 - AREA_B * share))
            trace = solver.run(
                Experiment(
                    parameters=_LEAKING,
                    pressure_a=pressure_a,
                    pressure_b=pressure_b,
                    load=constant(load),
                    duration=4.0,
                )
            )
            late = (trace.time > 3 * tau) & (trace.time < 6 * tau)
            rest = trace.pressure_a - trace.pressure_b
            slope = np.polyfit(trace.time[late], np.log(np.abs(rest[late])), 1)[0]
            for name, unit, want, got in (
                ("pressure A", "Pa", level, float(trace.pressure_a[-1])),
                ("pressure B", "Pa", level, float(trace.pressure_b[-1])),
                ("way", "m", way, float(trace.position[-1]) - start),
                ("time constant", "s", tau, -1 / slope),
            ):
                yield Row(
                    case="e",
                    quantity=f"{name} under {load:g} N, both ports blocked",
                    solver=solver.name,
                    unit=unit,
                    expected=want,
                    got=got,
                    tolerance=5e-3,
                )


def null_creep(load: float, rounding: float = 0.0216) -> tuple[float, float]:
    """Speed [m/s] and pressure A [Pa] of the centred valve with rounded edges under a load [N]."""
    k = GAIN * 0.5 * rounding

    def edge(pressure: float) -> float:
        return k * math.copysign(math.sqrt(abs(pressure)), pressure)

    def balance(z: np.ndarray) -> list[float]:
        pa, pb, v = z[0] * 1e6, z[1] * 1e6, z[2] * 1e-3
        leak = LEAKAGE * (pa - pb)
        return [
            1e6 * (edge(SUPPLY_PRESSURE - pa) - edge(pa) - leak - AREA_A * v),
            1e6 * (edge(SUPPLY_PRESSURE - pb) - edge(pb) + leak + AREA_B * v),
            1e-2 * (pa * AREA_A - pb * AREA_B - load - _VISCOUS * v),
        ]

    pa, _, v = root(balance, [6.0, 9.0, 1.0], tol=1e-13).x
    return v * 1e-3, pa * 1e6


def creep() -> Iterator[Row]:
    """e4: the leaking null of a real valve lets the piston creep."""
    for solver in SOLVERS:
        for load in (0.0, 1000.0, 2000.0):
            experiment = Experiment(
                parameters={**_LEAKING, "edge_rounding": 0.0216},
                pressure_a=8e6,
                pressure_b=(8e6 * AREA_A - load) / AREA_B,
                load=constant(load),
                duration=1.0,
            )
            yield Row(
                case="e",
                quantity=f"creep of the rounded null under {load:g} N",
                solver=solver.name,
                unit="m/s",
                expected=null_creep(load)[0],
                got=_speed(solver, experiment),
                tolerance=5e-3,
            )
