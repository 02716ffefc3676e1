"""Multiplications of an update as Sec. 3.2 counts them, against measured time."""

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from leglab.identification import Basis, BsnnArx
from leglab.studies.replication import paper
from leglab.studies.replication.online import Settings, run_online

Array = NDArray[np.float64]

ORDERS = (1, 2, 3, 5, 8, 12, 20, 32)
"""na = nb of the ARX part; its parameters are twice that."""
ROUNDS = 9
SPLINES = (4, 8, 16, 32, 64, 128)


def rls_multiplications(parameters: int) -> int:
    """5 N^2 + 3 N for one RLS step with N parameters (Sec. 3.2)."""
    return 5 * parameters**2 + 3 * parameters


def bsnn_multiplications(neurons: int) -> int:
    """5 N for one adaptation step of a single-input BSNN with N neurons (Sec. 3.2)."""
    return 5 * neurons


def multiplications(arx_parameters: int, neurons: int) -> int:
    """Of one step of the combined model: 238 for 6 ARX parameters and 8 neurons."""
    return rls_multiplications(arx_parameters) + bsnn_multiplications(neurons)


def measure(samples: int = 20_000) -> list[tuple[int, int, int, float]]:
    """Times batch updates of models of growing size.

    Args:
        samples: Samples of a timed call; the best of `ROUNDS` calls counts.

    Returns:
        Rows (ARX parameters, neurons, multiplications as counted, nanoseconds a sample).
    """
    rng = np.random.default_rng(0)
    u = rng.uniform(0.0, 0.8, samples)
    y = 0.5 * np.concatenate([[0.0], u[:-1]]) + 0.01 * rng.standard_normal(samples)
    sizes = [(order, 8) for order in ORDERS] + [(3, n) for n in SPLINES if n != 8]
    models = []
    for order, neurons in sizes:
        base = Settings().bsnn_arx()
        basis = Basis.uniform(0.0, 0.8, neurons, kind="paper")
        settings = replace(base, na=order, nb=order, network=replace(base.network, basis=(basis,)))
        models.append(settings)
    # Sizes take turns, so that a slow spell of the machine does not fall on one of them.
    rounds = [[_time(BsnnArx(settings), u, y) for settings in models] for _ in range(ROUNDS)]
    rows = []
    for (order, neurons), best in zip(sizes, np.min(rounds, axis=0).tolist(), strict=True):
        count = multiplications(2 * order, neurons)
        rows.append((2 * order, neurons, count, best / samples * 1e9))
    return rows


def table_time(u: Array, y: Array, seed: int) -> float:
    """Seconds for the online models of Table 1: 100 instances of each, training and validation."""
    start = time.perf_counter()
    run_online(u, y, paper.INSTANCES, seed)
    return time.perf_counter() - start


def _time(model: BsnnArx, u: Array, y: Array) -> float:
    start = time.perf_counter()
    model.run(u, y)
    return time.perf_counter() - start
