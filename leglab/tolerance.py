"""A machine as it was built: near its drawing, not like it."""

import mujoco
import numpy as np

from leglab.errors import LeglabError
from leglab.simulation import Simulation

# What differs from one specimen to the next, by element; each by a factor of its own. Geometry,
# pressures and the oil's grade are known well and left alone.
_PARAMETERS = (
    "rated_flow",
    "lap",
    "bandwidth_hz",
    "bulk_modulus",
    "entrained_air",
    "internal_leakage",
    "viscous",
    "coulomb",
    "k1",
    "k2",
    "d1",
)

# A third and more would be another machine.
LARGEST = 0.3


def check_tolerance(tolerance: float) -> None:
    """Raises a `LeglabError` for a tolerance outside [0, 0.3]."""
    if not 0 <= tolerance <= LARGEST:
        raise LeglabError(f"tolerance {tolerance!r} is outside [0, {LARGEST:g}]")


def vary_bodies(model: mujoco.MjModel, tolerance: float, seed: int) -> None:
    """Scales mass and inertia of every body by a factor exp(tolerance N(0, 1)), in place.

    Args:
        model: Changed; make its `MjData` afterwards.
        tolerance: Relative standard deviation [1].
        seed: Of the specimen.
    """
    factor = np.exp(tolerance * np.random.default_rng([seed, 11]).standard_normal(model.nbody))
    model.body_mass[:] *= factor
    model.body_inertia[:] *= factor[:, None]
    mujoco.mj_setConst(model, mujoco.MjData(model))


def vary_parameters(simulation: Simulation, tolerance: float, seed: int) -> None:
    """Scales hydraulic, friction and spring parameters of every element, each by its own factor.

    The breakaway friction keeps its ratio to the Coulomb friction.

    Args:
        simulation: Changed.
        tolerance: Relative standard deviation [1].
        seed: Of the specimen.
    """
    rng = np.random.default_rng([seed, 12])
    for element in simulation.elements:
        for name in _PARAMETERS:
            factor = float(np.exp(tolerance * rng.standard_normal()))
            names = (name, "static") if name == "coulomb" else (name,)
            # The larger first where they grow: static friction is never below Coulomb's.
            for each in reversed(names) if factor > 1 else names:
                if simulation.has(element, each):
                    value = simulation.parameter(element, each)
                    simulation.set_parameter(element, each, factor * value)
