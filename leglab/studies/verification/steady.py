"""Cases a, b, k and the null leak: speeds, forces and flows that settle."""

import math
from collections.abc import Iterator
from itertools import product

import numpy as np
from scipy.optimize import brentq

from leglab.studies.verification.experiment import (
    HELD,
    IDEAL,
    SOLVERS,
    SUPPLY_PRESSURE,
    Experiment,
    Trace,
    constant,
)
from leglab.studies.verification.geometry import (
    AREA_A,
    AREA_B,
    GAIN,
    LEAKAGE,
    dynamic_viscosity_ratio,
)
from leglab.studies.verification.rows import Row

_LPM = 60e3  # l/min per m^3/s


def steady_speed(
    spool: float, load: float = 0.0, supply: float = SUPPLY_PRESSURE, tank: float = 0.0
) -> tuple[float, float, float]:
    """Speed [m/s] and pressures A and B [Pa] of an ideal valve moving the piston against a load.

    Both edges pass Q = K x_s sqrt(dp), and the pressures balance the load [N]:
    v = K x_s sqrt((A_A p_s - A_B p_t - F)/(A_A^3 + A_B^3)) extending; A and B change places and F
    its sign retracting.
    """
    k, cubes = GAIN * abs(spool), AREA_A**3 + AREA_B**3
    if spool > 0:
        v = k * math.sqrt((AREA_A * supply - AREA_B * tank - load) / cubes)
        return v, supply - (AREA_A * v / k) ** 2, tank + (AREA_B * v / k) ** 2
    v = k * math.sqrt((AREA_B * supply - AREA_A * tank + load) / cubes)
    return -v, tank + (AREA_A * v / k) ** 2, supply - (AREA_B * v / k) ** 2


def _settled(values: np.ndarray) -> float:
    """Mean over the last tenth."""
    return float(values[-max(len(values) // 10, 1) :].mean())


def _slope(trace: Trace, name: str) -> float:
    """Power into one of the energy books over the last fifth [W]."""
    n = max(len(trace.time) // 5, 2)
    energy = trace.energies[name]
    return float((energy[-1] - energy[-n]) / (trace.time[-1] - trace.time[-n]))


def _moving(spool: float, load: float = 0.0, tank: float = 0.0) -> Experiment:
    """The piston crosses 60 mm of its stroke at the speed that it settles at."""
    speed, pressure_a, pressure_b = steady_speed(spool, load, tank=tank)
    return Experiment(
        parameters={**IDEAL, "tank_pressure": tank},
        position=0.01 if spool > 0 else 0.07,
        pressure_a=pressure_a,
        pressure_b=pressure_b,
        command=constant(spool),
        load=constant(load),
        duration=round(0.06 / abs(speed), 3),
    )


def no_load_speed() -> Iterator[Row]:
    """Case a: speeds and pressures without load."""
    for solver in SOLVERS:
        speeds = {}
        for tank, spool in product((0.0, 1e6), (1.0, -1.0, 0.25, -0.25, 0.05, -0.05)):
            trace = solver.run(_moving(spool, tank=tank))
            expected = steady_speed(spool, tank=tank)
            got = (trace.velocity, trace.pressure_a, trace.pressure_b)
            names = (("speed", "m/s"), ("pressure A", "Pa"), ("pressure B", "Pa"))
            for (name, unit), want, values in zip(names, expected, got, strict=True):
                yield Row(
                    case="a",
                    quantity=f"{name} at x_s = {spool:+g}, tank {tank / 1e5:g} bar",
                    solver=solver.name,
                    unit=unit,
                    expected=want,
                    got=_settled(values),
                    tolerance=1e-3,
                )
            speeds[tank, spool] = _settled(trace.velocity)
        yield Row(
            case="a",
            quantity="speed out over speed in",
            solver=solver.name,
            unit="1",
            expected=math.sqrt(AREA_A / AREA_B),
            got=-speeds[0.0, 1.0] / speeds[0.0, -1.0],
            tolerance=1e-3,
        )


def loaded_speed() -> Iterator[Row]:
    """Case b: speeds against loads, stall forces, and the efficiency against 2 kN."""
    loads = [(0.5, f) for f in (-500.0, 0.0, 1000.0, 2000.0)]
    loads += [(-0.5, f) for f in (1500.0, 0.0, -1000.0)]
    for solver in SOLVERS:
        for spool, load in loads:
            trace = solver.run(_moving(spool, load))
            yield Row(
                case="b",
                quantity=f"speed at x_s = {spool:+g} against {load:g} N",
                solver=solver.name,
                unit="m/s",
                expected=steady_speed(spool, load)[0],
                got=_settled(trace.velocity),
                tolerance=5e-3,
            )
        for spool, force in ((0.5, AREA_A * SUPPLY_PRESSURE), (-0.5, -AREA_B * SUPPLY_PRESSURE)):
            held = Experiment(mass=HELD, command=constant(spool), duration=0.05)
            yield Row(
                case="b",
                quantity=f"stall force at x_s = {spool:+g}",
                solver=solver.name,
                unit="N",
                expected=force,
                got=_settled(solver.run(held).force),
                tolerance=5e-3,
            )
        trace = solver.run(_moving(1.0, 2000.0))
        yield Row(
            case="b",
            quantity="efficiency at x_s = +1 against 2000 N",
            solver=solver.name,
            unit="1",
            expected=2000.0 / (AREA_A * SUPPLY_PRESSURE),
            got=_slope(trace, "energy_load") / _slope(trace, "energy_supply"),
            tolerance=5e-3,
        )


def stall_pressure(spool: float, leakage: float, supply: float = SUPPLY_PRESSURE) -> float:
    """Pressure A at stall with a leaking seal: K x sqrt(d) = C_i (p_s - 2 d), pA = p_s - d."""
    d = brentq(
        lambda d: GAIN * spool * math.sqrt(d) - leakage * (supply - 2 * d), 0.0, supply, xtol=1e-6
    )
    return supply - d


def worn_stall() -> Iterator[Row]:
    """Case k: what a worn seal leaves of the stall pressure."""
    cases = [(1, 40.0, 0.05), (10, 40.0, 0.05), (10, 40.0, 0.2), (50, 40.0, 1.0), (50, 80.0, 1.0)]
    for solver, (wear, celsius, spool) in product(SOLVERS, cases):
        held = Experiment(
            parameters={
                **IDEAL,
                "internal_leakage": LEAKAGE,
                "seal_clearance": wear ** (1 / 3),
                "oil_temperature": celsius,
            },
            mass=HELD,
            command=constant(spool),
            duration=0.2,
        )
        yield Row(
            case="k",
            quantity=f"pressure A, leakage x{wear} at {celsius:g} degC, x_s = {spool:g}",
            solver=solver.name,
            unit="Pa",
            expected=stall_pressure(spool, wear * LEAKAGE / dynamic_viscosity_ratio(celsius)),
            got=_settled(solver.run(held).pressure_a),
            tolerance=1e-3,
        )


def null_leak() -> Iterator[Row]:
    """Flow of the centred valve with rounded edges, 2 K (eps/2) sqrt(p_s/2)."""
    for solver, supply in product(SOLVERS, (16e6, 21e6)):
        held = Experiment(
            parameters={**IDEAL, "edge_rounding": 0.0216, "supply_pressure": supply},
            mass=HELD,
            pressure_a=0.5 * supply,
            pressure_b=0.5 * supply,
            duration=0.1,
        )
        power = _slope(solver.run(held), "energy_supply")
        yield Row(
            case="null leak",
            quantity=f"supply flow at {supply / 1e5:g} bar",
            solver=solver.name,
            unit="l/min",
            expected=GAIN * 0.0216 * math.sqrt(supply / 2) * _LPM,
            got=power / supply * _LPM,
            tolerance=5e-3,
        )
