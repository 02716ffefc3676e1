"""Case g: steady Stribeck friction and the displacement before sliding."""

import math
from collections.abc import Iterator
from itertools import product

import numpy as np

from leglab.studies.verification.experiment import HELD, IDEAL, SOLVERS, Experiment
from leglab.studies.verification.geometry import AREA_A, AREA_B
from leglab.studies.verification.rows import Row

_STATIC, _COULOMB, _VISCOUS = 150.0, 100.0, 700.0  # N, N, N s/m
_STRIBECK_VELOCITY, _SIGMA_0, _SIGMA_1 = 0.014, 2e6, 2e3  # m/s, N/m, N s/m
# Both chambers drain, so that pressures stay small beside the friction.
_DRAINED = {
    **IDEAL,
    "static": _STATIC,
    "coulomb": _COULOMB,
    "viscous": _VISCOUS,
    "stribeck_velocity": _STRIBECK_VELOCITY,
    "sigma_0": _SIGMA_0,
    "sigma_1": _SIGMA_1,
    "external_leakage_a": 1e-9,
    "external_leakage_b": 1e-9,
    "entrained_air": 0.005,
}


def steady_friction(v: float) -> float:
    """F = sgn(v) (F_c + (F_s - F_c) exp(-(v/v_s)^2)) + b v [N]."""
    level = _COULOMB + (_STATIC - _COULOMB) * math.exp(-((v / _STRIBECK_VELOCITY) ** 2))
    return math.copysign(level, v) + _VISCOUS * v


def stribeck() -> Iterator[Row]:
    """Friction at an imposed speed: a huge mass keeps it."""
    for solver, v in product(SOLVERS, (1e-4, 1e-3, 0.003, 0.0141, 0.03, 0.1, 0.5, -0.0141)):
        # The bristle settles over a path of F/sigma_0; ten of them, 0.75 mm.
        trace = solver.run(
            Experiment(
                parameters=_DRAINED,
                mass=HELD,
                velocity=v,
                pressure_a=0.0,
                pressure_b=0.0,
                duration=max(round(7.5e-4 / abs(v), 3), 0.05),
            )
        )
        pressure_force = AREA_A * trace.pressure_a - AREA_B * trace.pressure_b
        friction = pressure_force - trace.force
        yield Row(
            case="g",
            quantity=f"friction at {v:g} m/s",
            solver=solver.name,
            unit="N",
            expected=steady_friction(v),
            got=float(np.mean(friction[-5:])),
            tolerance=0.01,
        )


def presliding() -> Iterator[Row]:
    """Displacement under a force of 0.4 F_s raised slowly: -(F_s/sigma_0) ln(1 - F/F_s)."""
    force, rise = 60.0, 1.0
    for solver in SOLVERS:
        trace = solver.run(
            Experiment(
                parameters=_DRAINED,
                pressure_a=0.0,
                pressure_b=0.0,
                load=lambda t: -force * min(t / rise, 1.0),
                duration=1.1 * rise,
            )
        )
        yield Row(
            case="g",
            quantity=f"displacement before sliding under {force:g} N",
            solver=solver.name,
            unit="m",
            expected=-_STATIC / _SIGMA_0 * math.log(1 - force / _STATIC),
            got=float(trace.position[-1] - trace.position[0]),
            tolerance=0.01,
        )
