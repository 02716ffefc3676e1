"""The experiment of the paper: the plant of Eq. 23 under filtered Gaussian noise.

Equations, sections and tables are those of M. Folgheraiter, "A combined B-Spline-Neural-Network
and ARX Model for Online Identification of Nonlinear Dynamic Actuation Systems".
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from replication.paper import Array

MEAN = 0.7
"""Of the noise that excites the plant (Sec. 3.1)."""
VARIANCE = 0.07
"""The paper prints "standard deviation sigma^2 = 0.07"; as a variance it fits Table 1 better."""
CUTOFF = 16.0
"""Of the filter [Hz]."""
HOLD, HOLDS = 0.0025, 2
"""Time for which one noise value is held [s], and such times in a sample."""
SAMPLING_TIME = 0.005
"""Of the recorded u and y [s]."""
SUBSTEPS = 5
"""Runge-Kutta steps in one hold of the noise: halving them moves y by less than 1e-7."""


@dataclass(frozen=True, kw_only=True)
class Plant:
    """Mass, spring and damper of Eq. 23; the defaults are the adopted paper-mode constants.

    The paper publishes none of the four. They were chosen so that y has the standard deviation that
    RMS and R^2 of Table 1 together imply (0.0527 on the validation set).
    """

    m: float = 1.3e-4  #: Mass, in force units per acceleration unit [kg]
    b: float = 5.8e-3  #: Damping constant [N s/m]
    k_1: float = 0.80  #: Linear spring constant [N/m]
    k_2: float = 3.4  #: Nonlinear spring constant of k_2 y^3 sin^2 y [N/m^3]

    def changed(self, name: str, factor: float) -> "Plant":
        """Returns a copy whose constant `name` is multiplied by `factor`."""
        return replace(self, **{name: getattr(self, name) * factor})


def simulate(
    seeds: Sequence[int],
    n_samples: int = 2000,
    *,
    variance: float = VARIANCE,
    after: Sequence[Plant] = (),
    change_at: int | None = None,
) -> tuple[Array, Array]:
    """Simulates the plant from rest, one realisation per seed, all at once.

    The input is Gaussian noise, held, then low-passed by a continuous first-order filter.

    Args:
        seeds: One seed of the noise generator per realisation.
        n_samples: Samples per realisation; 2000 are the 10 s of the paper.
        variance: Variance of the noise before the filter.
        after: Constants from sample `change_at` on, one plant per realisation.
        change_at: Sample of the change; None for never.

    Returns:
        Sampled input u and output y, each of shape (len(seeds), n_samples).
    """
    deviation, count = np.sqrt(variance), HOLDS * n_samples
    noise = np.stack([np.random.default_rng(s).normal(MEAN, deviation, count) for s in seeds])
    step = HOLD / SUBSTEPS
    half, full = (np.exp(-2.0 * np.pi * CUTOFF * t) for t in (step / 2.0, step))
    u, y, v = (np.zeros(len(seeds)) for _ in range(3))
    inputs, outputs = (np.empty((len(seeds), n_samples)) for _ in range(2))
    acceleration = _acceleration(Plant())
    for k in range(count):
        if k % HOLDS == 0:
            inputs[:, k // HOLDS], outputs[:, k // HOLDS] = u, y
            if k // HOLDS == change_at:
                acceleration = _acceleration(*after)
        held = noise[:, k]
        for _ in range(SUBSTEPS):
            middle, end = held + (u - held) * half, held + (u - held) * full
            y, v = _runge_kutta(acceleration, y, v, (u, middle, end), step)
            u = end
    return inputs, outputs


def exact_free_run(u: Array) -> Array:
    """Simulates the exact plant with the sampled input, linearly interpolated.

    The error of this simulation comes only from the unknown input between the samples. It is the
    lower bound (floor) for every model that uses the samples alone.

    Args:
        u: Sampled inputs, shape (n_realisations, n_samples); the plant starts from rest.
    """
    acceleration = _acceleration(Plant())
    y, v, outputs = np.zeros(len(u)), np.zeros(len(u)), np.zeros_like(u)
    steps = 2 * SUBSTEPS
    for k in range(u.shape[1] - 1):
        slope = (u[:, k + 1] - u[:, k]) / steps
        for i in range(steps):
            forces = tuple(u[:, k] + slope * (i + part) for part in (0.0, 0.5, 1.0))
            y, v = _runge_kutta(acceleration, y, v, forces, SAMPLING_TIME / steps)
        outputs[:, k + 1] = y
    return outputs


Acceleration = Callable[[Array, Array, Array], Array]


def _acceleration(*plants: Plant) -> Acceleration:
    """Returns Eq. 23 solved for the acceleration, for one plant or one per realisation."""
    m, b, k_1, k_2 = np.array([(p.m, p.b, p.k_1, p.k_2) for p in plants]).T

    def acceleration(y: Array, v: Array, u: Array) -> Array:
        return (u - b * v - k_1 * y - k_2 * y * y * y * np.sin(y) ** 2) / m

    return acceleration


def _runge_kutta(
    acceleration: Acceleration, y: Array, v: Array, forces: Sequence[Array], step: float
) -> tuple[Array, Array]:
    """Makes one classical fourth-order step with the inputs `forces` at start, middle and end."""
    start, middle, end = forces
    a_1 = acceleration(y, v, start)
    v_2 = v + step / 2.0 * a_1
    a_2 = acceleration(y + step / 2.0 * v, v_2, middle)
    v_3 = v + step / 2.0 * a_2
    a_3 = acceleration(y + step / 2.0 * v_2, v_3, middle)
    v_4 = v + step * a_3
    a_4 = acceleration(y + step * v_3, v_4, end)
    way = v + 2.0 * v_2 + 2.0 * v_3 + v_4
    return y + step / 6.0 * way, v + step / 6.0 * (a_1 + 2.0 * a_2 + 2.0 * a_3 + a_4)
