"""NNARX and NNOE, the comparison networks of Sec. 4: 6 inputs, 2 hidden tanh units, linear output.

Both learn in batch by Levenberg-Marquardt (scipy's MINPACK) with 10 iterations. During training
NNARX is fed the measured outputs, NNOE its predictions; both are scored in free run.

The paper specifies neither scaling, nor biases, nor an iteration. This module maps both signals to
[-1, 1] by their training range, gives every unit a bias, and counts one linearisation as an
iteration, however many trial steps MINPACK makes on it. If trial steps are counted instead, or
parameters are rescaled by the columns of the Jacobian, the errors are 1.5 to 2 times those of the
paper.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import tanh

import numpy as np
from scipy.linalg import solve_banded
from scipy.optimize import least_squares

from replication.paper import Array

LAGS = 3
"""Past outputs and past inputs in the regressor: n = m = 3 as in the ARX model."""
HIDDEN = 2
ITERATIONS = 10
N_PARAMETERS = HIDDEN * (2 * LAGS + 1) + HIDDEN + 1
"""Synapses and biases: 14 + 3."""


@dataclass(frozen=True, kw_only=True)
class Network:
    """A trained network with its scaling."""

    weights: Array  #: Synapses and bias of each hidden unit, then of the output unit, shape (17,)
    u_scale: tuple[float, float]  #: Middle and half width of the range of the training input
    y_scale: tuple[float, float]  #: Middle and half width of the range of the training output

    def free_run(self, u: Array, y_initial: Array) -> Array:
        """Simulates on `u`, shape (n,), from the first `LAGS` outputs `y_initial`."""
        scaled_u = (u - self.u_scale[0]) / self.u_scale[1]
        scaled_y = (np.asarray(y_initial) - self.y_scale[0]) / self.y_scale[1]
        return _free_run(self.weights, scaled_u, scaled_y) * self.y_scale[1] + self.y_scale[0]


def train(u: Array, y: Array, *, output_error: bool, rng: np.random.Generator) -> Network:
    """Trains one network on u and y, each of shape (n,).

    Args:
        u: Training input.
        y: Training output.
        output_error: NNOE (fed its own predictions) if true, NNARX otherwise.
        rng: Draws the initial weights, uniform in +-0.25 like those of the other models.
    """
    u_scale, y_scale = _scale(u), _scale(y)
    scaled_u, scaled_y = (u - u_scale[0]) / u_scale[1], (y - y_scale[0]) / y_scale[1]
    problem = _output_error if output_error else _equation_error
    start = rng.uniform(-0.25, 0.25, N_PARAMETERS)
    weights = _levenberg_marquardt(*problem(scaled_u, scaled_y), start)
    return Network(weights=weights, u_scale=u_scale, y_scale=y_scale)


class _IterationsSpentError(Exception):
    """Exception that stops MINPACK, which can limit trial steps but not iterations."""


def _levenberg_marquardt(
    residuals: Callable[[Array], Array], jacobian: Callable[[Array], Array], start: Array
) -> Array:
    """Returns the weights after `ITERATIONS` linearisations, or fewer if it converges earlier."""
    accepted: list[Array] = []

    def counted(weights: Array) -> Array:
        accepted.append(weights.copy())
        if len(accepted) > ITERATIONS:
            raise _IterationsSpentError
        return jacobian(weights)

    try:
        return least_squares(residuals, start, counted, method="lm", x_scale=1.0).x
    except _IterationsSpentError:
        return accepted[-1]


def _scale(signal: Array) -> tuple[float, float]:
    low, high = float(np.min(signal)), float(np.max(signal))
    return (low + high) / 2.0, (high - low) / 2.0


def _regressors(u: Array, y: Array) -> Array:
    """Returns rows [y(t-1..t-3), u(t-1..t-3), 1] for t = 3 .. n-1, shape (n-3, 7)."""
    n = len(u)
    lagged = [signal[LAGS - lag : n - lag] for signal in (y, u) for lag in range(1, LAGS + 1)]
    return np.column_stack([*lagged, np.ones(n - LAGS)])


def _split(weights: Array) -> tuple[Array, Array, float]:
    hidden = weights[: HIDDEN * (2 * LAGS + 1)].reshape(HIDDEN, -1)
    return hidden, weights[hidden.size : hidden.size + HIDDEN], float(weights[-1])


def _gradient(weights: Array, rows: Array) -> Array:
    """Returns d output / d weights at fixed regressors, shape (len(rows), 17)."""
    hidden, output, _ = _split(weights)
    active = np.tanh(rows @ hidden.T)
    back = (1.0 - active**2) * output
    first = [back[:, [unit]] * rows for unit in range(HIDDEN)]
    return np.hstack([*first, active, np.ones((len(rows), 1))])


Problem = tuple[Callable[[Array], Array], Callable[[Array], Array]]


def _equation_error(u: Array, y: Array) -> Problem:
    rows = _regressors(u, y)

    def residuals(weights: Array) -> Array:
        hidden, output, bias = _split(weights)
        return np.tanh(rows @ hidden.T) @ output + bias - y[LAGS:]

    return residuals, lambda weights: _gradient(weights, rows)


def _output_error(u: Array, y: Array) -> Problem:
    def residuals(weights: Array) -> Array:
        return _free_run(weights, u, y[:LAGS])[LAGS:] - y[LAGS:]

    def jacobian(weights: Array) -> Array:
        """Solves psi(t) = phi(t) + sum_i g_i(t) psi(t - i), a banded system for all t at once."""
        rows = _regressors(u, _free_run(weights, u, y[:LAGS]))
        hidden, output, _ = _split(weights)
        feedback = ((1.0 - np.tanh(rows @ hidden.T) ** 2) * output) @ hidden[:, :LAGS]
        n = len(rows)
        bands = np.zeros((LAGS + 1, n))
        bands[0] = 1.0
        for lag in range(1, min(LAGS, n - 1) + 1):
            bands[lag, : n - lag] = -feedback[lag:, lag - 1]
        return solve_banded((LAGS, 0), bands, _gradient(weights, rows), check_finite=False)

    return residuals, jacobian


def _free_run(weights: Array, u: Array, y_initial: Array) -> Array:
    """Simulates sample by sample, with plain floats, which are several times faster than arrays."""
    hidden, output, bias = _split(weights)
    (p1, p2, p3, *_), (r1, r2, r3, *_) = hidden[:, :LAGS].tolist()
    c_1, c_2 = output.tolist()
    lagged_u = np.column_stack([u[LAGS - lag : len(u) - lag] for lag in range(1, LAGS + 1)])
    drive = lagged_u @ hidden[:, LAGS : 2 * LAGS].T + hidden[:, -1]
    y_3, y_2, y_1 = (float(value) for value in y_initial[:LAGS])
    simulated = [y_3, y_2, y_1]
    for d_1, d_2 in drive.tolist():
        y_1, y_2, y_3 = (
            c_1 * tanh(p1 * y_1 + p2 * y_2 + p3 * y_3 + d_1)
            + c_2 * tanh(r1 * y_1 + r2 * y_2 + r3 * y_3 + d_2)
            + bias,
            y_1,
            y_2,
        )
        simulated.append(y_1)
    return np.array(simulated)
