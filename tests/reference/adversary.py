"""Samples chosen to break an identifier."""

import numpy as np

BLOCK = 2000
KINDS = ("random", "constant", "silence", "jumps", "denormal", "alternating", "tiny", "not finite")


def samples(count, rng):
    """Yields (u, y) in blocks of BLOCK samples, the kind drawn at random, `count` in all."""
    for _ in range(count // BLOCK):
        kind = KINDS[rng.integers(len(KINDS))]
        u, y = rng.standard_normal((2, BLOCK))
        if kind == "constant":
            u[:], y[:] = rng.standard_normal(2)
        elif kind == "silence":
            u[:] = y[:] = 0.0
        elif kind == "jumps":
            at = rng.random(BLOCK) < 0.01
            u[at] *= 1e6
            y[rng.random(BLOCK) < 0.01] *= 1e6
        elif kind == "denormal":
            u *= 1e-310
            y *= 1e-310
        elif kind == "alternating":
            y[:] = 1e6 * (-1.0) ** np.arange(BLOCK)
        elif kind == "tiny":
            u *= 1e-6
            y *= 1e-6
        elif kind == "not finite":
            y[rng.random(BLOCK) < 0.05] = np.nan
            u[rng.random(BLOCK) < 0.05] = np.inf
        yield u, y
