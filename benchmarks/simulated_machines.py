"""Machines with known equations, whose records `benchmarks identify` gives to the identifier.

The equations of four machines are fitted as well. A family of further machines is drawn by a seed.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

Array = np.ndarray
FITTED = 3000


@dataclass(frozen=True)
class Machine:
    """Equations with parameters.

    Attributes:
        drive: Inputs (N,) or (N, m) of a generator and a number of samples.
        run: Outputs (N, K) of K parameter vectors (P, K), and the inputs.
        truth: Parameters (P,), none of which is zero.
    """

    drive: Callable[[np.random.Generator, int], Array]
    run: Callable[[Array, Array], Array]
    truth: tuple[float, ...]

    def output(self, u: Array) -> Array:
        """Output (N,) with the true parameters."""
        return self.run(np.array(self.truth)[:, None], u)[:, 0]

    def fitted(self, rng: np.random.Generator, u: Array, y: Array) -> Array:
        """Parameters fitted by output error, from a start within 10 % of the truth.

        The first FITTED samples of a record are used: the error that is left is far below the
        noise of the sensor.
        """
        u, y = u[:FITTED], y[:FITTED]
        truth = np.array(self.truth)
        step = 1e-4

        def errors(scaled: Array) -> Array:
            return self.run((truth * scaled)[:, None], u)[:, 0] - y

        def slopes(scaled: Array) -> Array:
            tried = (
                scaled[:, None] + np.column_stack([np.eye(len(truth)), -np.eye(len(truth))]) * step
            )
            runs = self.run(truth[:, None] * tried, u)
            return (runs[:, : len(truth)] - runs[:, len(truth) :]) / (2 * step)

        start = 1 + 0.1 * rng.uniform(-1, 1, len(truth))
        with np.errstate(over="ignore", invalid="ignore"):
            return truth * least_squares(errors, start, slopes, method="lm", max_nfev=100).x


def held(rng: np.random.Generator, n: int, hold: float) -> Array:
    """Random levels in [-1, 1], each held for `hold` samples on average, (n,)."""
    change = rng.random(n) < 1 / hold
    return rng.uniform(-1, 1, n)[np.maximum.accumulate(np.where(change, np.arange(n), 0))]


def _wiener_hammerstein(theta: Array, u: Array) -> Array:
    columns = []
    for b0, b1, a1, a2, dead, limit, d0, d1, c1, c2 in theta.T:
        x = lfilter([b0, b1], [1, a1, a2], u)
        bent = np.clip(np.sign(x) * np.maximum(np.abs(x) - dead, 0), -limit, limit)
        columns.append(lfilter([d0, d1], [1, c1, c2], bent))
    return np.column_stack(columns)


def _bouc_wen(theta: Array, force: Array) -> Array:
    """M y'' + c y' + k y + z = F, z' = a y' - b (g |y'| z + d y' |z|) (Wen 1976, exponent 1)."""
    m, c, k, a, b, g, d = theta
    steps, dt = 20, 1 / 750
    y = v = z = np.zeros(theta.shape[1])
    out = np.empty((len(force), theta.shape[1]))
    for t, f in enumerate(force):
        for _ in range(steps):
            rate = a * v - b * (g * abs(v) * z + d * v * abs(z))
            v = v + dt / steps * (f - c * v - k * y - z) / m
            y = y + dt / steps * v
            z = z + dt / steps * rate
        out[t] = 1e3 * y
    return out


def _tank(theta: Array, u: Array) -> Array:
    """Two tanks in a row, the upper with an overflow into the lower, whose level is measured."""
    pump, upper_hole, lower_hole, caught, brim, top = theta
    upper = lower = np.full(theta.shape[1], 3.0)
    out = np.empty((len(u), theta.shape[1]))
    for t, flow in enumerate(u):
        spill = np.maximum(upper - brim, 0)
        down = upper_hole * np.sqrt(upper)
        lower = lower + down - lower_hole * np.sqrt(lower) + caught * spill
        upper = np.maximum(upper + pump * flow - down - spill, 0)
        lower = np.minimum(np.maximum(lower, 0), top)
        out[t] = lower
    return out


def _heater(theta: Array, u: Array) -> Array:
    """Temperature by electric power (a square of voltage, late by 4 samples) and an air flow."""
    power, loss, still, room = theta
    y = np.full(theta.shape[1], 30.0)
    out = np.empty((len(u), theta.shape[1]))
    for t in range(len(u)):
        y = y + power * u[max(t - 4, 0), 0] ** 2 - loss * (y - room) * (still + u[t, 1])
        out[t] = y
    return out


MACHINES = {
    "Wiener-Hammerstein": Machine(
        lambda rng, n: held(rng, n, 5),
        _wiener_hammerstein,
        (0.1, 0.1, -1.5, 0.7, 0.1, 0.6, 0.2, 0.1, -1.2, 0.5),
    ),
    "Bouc-Wen": Machine(
        lambda rng, n: 300 * lfilter([0.05], [1, -0.95], rng.normal(size=n)),
        _bouc_wen,
        (2.0, 10.0, 5e4, 5e4, 1e3, 0.8, -1.1),
    ),
    "tank with overflow": Machine(
        lambda rng, n: np.clip(2.6 + 2.6 * held(rng, n, 40), 0, None),
        _tank,
        (0.25, 0.30, 0.28, 0.5, 10.0, 10.0),
    ),
    "two-input heater": Machine(
        lambda rng, n: np.column_stack([1 + held(rng, n, 30), 1.2 + held(rng, n, 50)]),
        _heater,
        (0.6, 0.02, 0.3, 20.0),
    ),
}


def drawn(seed: int, number: int) -> tuple[str, Array, Array]:
    """A machine of a family, drawn by a seed: its name, inputs (N, m) and output (N,).

    400 to 100,000 samples, evenly in the logarithm; one to five inputs, of which the first drives
    the machine and the others add to it with delays; noise of 20 to 60 dB.
    """
    rng = np.random.default_rng([seed, number])
    name = list(_FAMILY)[number % len(_FAMILY)]
    n = int(np.exp(rng.uniform(np.log(400), np.log(100_000))))
    memory = float(np.exp(rng.uniform(np.log(3), np.log(60))))  # time constant [samples]
    # At least some fifty levels, of which half are learned from.
    holds = [min(rng.uniform(0.3, 3) * memory, n / 50) for _ in range(rng.integers(1, 6))]
    u = np.column_stack([held(rng, n, hold) for hold in holds])
    push = u[:, 0].copy()
    for j in range(1, u.shape[1]):
        late = rng.integers(0, 6)
        push[late:] += rng.uniform(0.1, 0.5) * u[: n - late, j]
    y = _FAMILY[name](rng, push, memory)
    y = y + np.std(y) * 10 ** (-rng.uniform(1, 3)) * rng.normal(size=n)
    return f"{number + 1}: {name}, {n} samples, {u.shape[1]} inputs", u, y


def _filtered(rng: np.random.Generator, x: Array, memory: float) -> Array:
    """Through a filter of gain one: one real pole, or two complex ones."""
    pole = np.exp(-1 / memory)
    if rng.random() < 0.5:
        return lfilter([1 - pole], [1, -pole], x)
    turn = rng.uniform(0.5, 3) / memory
    a = [1, -2 * pole * np.cos(turn), pole**2]
    return lfilter([sum(a)], a, x)


def _linear(rng: np.random.Generator, x: Array, memory: float) -> Array:
    return _filtered(rng, _filtered(rng, x, memory), memory / 3)


def _saturated(rng: np.random.Generator, x: Array, memory: float) -> Array:
    limit = rng.uniform(0.3, 0.8)
    return _filtered(rng, np.clip(x, -limit, limit), memory)


def _dead_zone(rng: np.random.Generator, x: Array, memory: float) -> Array:
    dead = rng.uniform(0.05, 0.4)
    return _filtered(rng, np.sign(x) * np.maximum(abs(x) - dead, 0), memory)


def _sensor(rng: np.random.Generator, x: Array, memory: float) -> Array:
    return np.tanh(rng.uniform(0.5, 2) * _filtered(rng, x, memory))


def _steps(x: Array, state: Array, slope: Callable[[float, Array], Array], parts: int) -> Array:
    """First state by Euler steps, of which a sample has some parts, (N,)."""
    out = np.empty(len(x))
    for t, push in enumerate(x):
        for _ in range(parts):
            state = state + slope(push, state) / parts
        out[t] = state[0]
    return out


def _stiffening(rng: np.random.Generator, x: Array, memory: float) -> Array:
    rate, cubic, loss = 1 / memory, rng.uniform(0.5, 3), rng.uniform(0.2, 1)

    def slope(push: float, s: Array) -> Array:
        pull = push - s[0] - cubic * s[0] ** 3 - loss * s[1]
        return rate * np.array([s[1], pull])

    return _steps(x, np.zeros(2), slope, 16)


def _friction(rng: np.random.Generator, x: Array, memory: float) -> Array:
    level, loss = rng.uniform(0.1, 0.4), 1 / memory
    return _steps(x, np.zeros(1), lambda push, s: loss * (push - s - level * np.tanh(s / 0.02)), 8)


def _outflow(rng: np.random.Generator, x: Array, memory: float) -> Array:
    hole = rng.uniform(0.5, 1.5)
    return _steps(
        x,
        np.ones(1),
        lambda push, s: (1 + 0.8 * push - hole * np.sqrt(np.maximum(s, 0))) / memory,
        4,
    )


def _product(rng: np.random.Generator, x: Array, memory: float) -> Array:
    share = rng.uniform(0.3, 0.7)
    return _steps(x, np.ones(1), lambda push, s: (1 - s * (1 + share * np.tanh(push))) / memory, 4)


def _play(rng: np.random.Generator, x: Array, memory: float) -> Array:
    half, at = rng.uniform(0.05, 0.3), 0.0
    smooth = lfilter([1 / memory], [1, 1 / memory - 1], x)
    half *= np.std(smooth)
    out = np.empty(len(x))
    for t, value in enumerate(smooth):
        at = min(max(at, value - half), value + half)
        out[t] = at
    return out


def _drag(rng: np.random.Generator, x: Array, memory: float) -> Array:
    drag = rng.uniform(1, 4)
    return _steps(x, np.zeros(1), lambda push, s: (push - s - drag * s * abs(s)) / memory, 4)


_FAMILY = {
    "linear": _linear,
    "saturated input": _saturated,
    "dead zone": _dead_zone,
    "saturated sensor": _sensor,
    "stiffening spring": _stiffening,
    "dry friction": _friction,
    "tank": _outflow,
    "gain by the input": _product,
    "play": _play,
    "quadratic drag": _drag,
}
