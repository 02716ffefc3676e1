"""State-space models with static curves, fitted to the free run; see `StateSpace`.

First a linear model of the given order is fitted: a high-order ARX model is identified, its impulse
response is realised as a state-space model, and an output-error fit refines the result. Then static
curves are added one by one. The argument of a curve is a combination of states and inputs; of many
combinations the one expected to reduce the free-run error most is taken, and all parameters are
refitted. Schoukens and Toth (2020) and Paduart et al. (2010) also start from a linear model.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from leglab._native.structure import StateRuns
from leglab.identification.spline_state_space import OBSERVED, StateSpace
from leglab.identification.structure.fit import (
    ITERATIONS,
    LEAST_SHARE,
    Array,
    Fit,
    Problem,
    Stretch,
    descend,
    roughness,
    solve,
)

_ARX = 20  # maximum number of lags of the ARX model whose impulse response is realised
_RESPONSE = 60  # number of rows, and of column blocks, of the Hankel matrix of impulse responses
_LINEAR = 0.01  # prior precision of A, B, C, D and initial states; that of a curve's v, w, o is 1
_RANDOM = 8  # number of random combinations of states and inputs that are tried for a new curve
_TRIED = 2  # number of candidate curves that are fitted, by expected gain; the best one is added
_GLANCE, _STEPS = 5, 25  # iterations of the fit of each candidate, and of the refit of the best
_ANEW = 6  # iterations of a fit without the held-out block, started from the fit to all records
_WORTH = 0.997  # a curve is added if it multiplies the RMS error by less than this ratio
_SHORTEST = 500  # minimum samples per segment if the records exceed the budget of samples
# Each segment of a fit adds unknown initial states, so the number of segments is limited: minimum
# samples of the budget per segment, and maximum number of segments.
_FOR_A_START, _MOST = 125, 200
_NONE = np.zeros(0)  # argument of a candidate curve if there is no candidate
_RIDGE = 1e-9  # lower bound of singular values and of peak state values, against division by zero


class Sums(NamedTuple):
    """Scaled sums of a Gauss-Newton step over segments; see csrc/identification/state_run.h.

    Order of unknowns: parameters, initial states of all segments, weights of a candidate curve.
    """

    error: float
    samples: int
    products: Array
    gradient: Array


def segments_of(problem: Problem, budget: int, without: Stretch | None = None) -> list[Stretch]:
    """Returns segments outside a held-out block, evenly spaced if records exceed `budget`."""
    whole: list[Stretch] = []
    for k, record in enumerate(problem.records):
        ends = [(0, len(record))]
        if without is not None and without.record == k:
            ends = [(0, without.start), (without.start + without.length, len(record))]
        # Segments with fewer than two measured outputs are of no use in a fit.
        whole += [Stretch(k, a, b - a) for a, b in ends if np.isfinite(record.y[a:b]).sum() > 1]
    total, most = sum(s.length for s in whole), min(_MOST, budget // _FOR_A_START)
    if total <= budget and len(whole) <= most:
        return whole
    length = max(_SHORTEST, min(budget, total) // most)
    pieces = [
        Stretch(s.record, s.start + at, min(length, s.length - at))
        for s in whole
        for at in range(0, s.length, length)
    ]
    mean = sum(s.length for s in pieces) / len(pieces)
    keep = min(most, max(1, int(budget / mean)), len(pieces))
    return [pieces[i] for i in np.unique(np.linspace(0, len(pieces) - 1, keep).round().astype(int))]


def runs_of(
    problem: Problem, structure: StateSpace, segments: Sequence[Stretch], further: Array = _NONE
) -> StateRuns:
    """Builds the core's simulations of segments; `further` weighs a candidate's z = v' [x; u]."""
    data = []
    for s in segments:
        record, first = problem.records[s.record], max(0, s.start - max(structure.delays))
        rows = slice(first, s.start + s.length)
        data.append((record.u[rows], record.y[rows], s.start - first))
    return StateRuns(problem.model((structure,)), data, further)


@dataclass(frozen=True)
class _Model:
    """Variables of a fit: the model's parameters, then the initial state of each segment."""

    structure: StateSpace
    theta: Array

    @property
    def parameters(self) -> Array:
        return self.theta[: self.structure.count]


class StatePath:
    """Forward selection of static curves by the free-run error that each is expected to explain.

    Args:
        problem: Records.
        structure: States and delays; curves only together with `start`.
        strength: Strength of the prior of the parameters.
        budget: Maximum number of samples that a fit simulates.
        block: Held-out block, which the fits leave out.
        start: Initial parameters, (count,); by default those of the best linear model.
    """

    def __init__(
        self,
        problem: Problem,
        structure: StateSpace,
        strength: float,
        budget: int,
        block: Stretch | None = None,
        start: Array | None = None,
    ) -> None:
        self._problem, self._strength, self._budget = problem, strength, budget
        self._segments = tuple(segments_of(problem, budget, block))
        # With a seed that depends on the order alone all held-out blocks try the same directions.
        self._rng = np.random.default_rng(structure.states)
        self.ended = False
        theta = realised(problem, structure, self._segments) if start is None else start
        theta = np.append(theta, np.zeros(len(self._segments) * structure.states))
        theta = self._scaled(structure, theta) if start is None else self._started(structure, theta)
        self._model, error = self._fitted(_Model(structure, theta), ITERATIONS)
        if start is None:
            scaled = self._scaled(structure, self._model.theta)
            self._model = replace(self._model, theta=scaled)
        self.fit = self._as_fit(error)

    def grow(self) -> None:
        """Adds one curve; ends the selection if the RMS error falls too little (see `_WORTH`)."""
        if self.ended:
            return
        best: tuple[_Model, float] | None = None
        for tried in self._promising():
            fitted = self._fitted(tried, _GLANCE)
            if best is None or fitted[1] < best[1]:
                best = fitted
        if best is not None:
            best = self._fitted(best[0], _STEPS)
        if best is None or not best[1] < _WORTH * self.fit.error:
            self.ended = True
            return
        self._model = best[0]
        self.fit = self._as_fit(best[1])

    def without(self, block: Stretch) -> Fit:
        """Refits the model, from its present parameters, to the samples outside a block."""
        return self._elsewhere(segments_of(self._problem, self._budget, block), _ANEW)

    def _elsewhere(self, segments: Sequence[Stretch], iterations: int) -> Fit:
        """Refits to other segments, whose initial states are initialised by simulation."""
        structure = self._model.structure
        x = self._runs(structure).states(self._model.theta)
        ends = np.cumsum([s.length for s in self._segments])
        starts = np.zeros((len(segments), structure.states))
        for k, new in enumerate(segments):
            for old, end in zip(self._segments, ends, strict=True):
                if old.record == new.record and 0 <= new.start - old.start < old.length:
                    starts[k] = x[end - old.length + new.start - old.start]
        other = copy(self)
        other._segments = tuple(segments)
        other._model = replace(self._model, theta=np.append(self._model.parameters, starts))
        other._model, error = other._fitted(other._model, iterations)
        return other._as_fit(error)

    def _as_fit(self, error: float) -> Fit:
        variance = max(error**2 * self._problem.variance, 1e-12)
        structure = replace(self._model.structure, noise=variance)
        return Fit((structure,), self._model.parameters.copy(), error)

    def _runs(self, structure: StateSpace, further: Array = _NONE) -> StateRuns:
        return runs_of(self._problem, structure, self._segments, further)

    def _fitted(self, model: _Model, iterations: int) -> tuple[_Model, float]:
        runs = self._runs(model.structure)

        def sums(theta: Array, sensitivities: bool) -> Sums:
            return Sums(*runs.sums(theta, sensitivities))

        form = self._strength / self._problem.count * self._prior(model)
        centre = model.theta.copy()
        centre[model.structure.spline_weights] = 0.0
        theta, error = descend(
            sums, model.theta, form, self._problem.variance, iterations, centre=centre
        )
        return replace(model, theta=theta), error

    def _started(self, structure: StateSpace, theta: Array) -> Array:
        """Fits the initial states alone, to the first samples of each segment, then to all.

        They begin at the smallest states with the first output of each segment. From zeros, a fit
        to all samples at once may end in another minimum.
        """
        states, parameters = slice(structure.count, None), theta[: structure.count]
        parts, output = structure.parts(parameters), self._problem.template.output
        first = [self._problem.records[s.record].y[s.start :][: s.length] for s in self._segments]
        y = np.array([y[np.isfinite(y)][0] for y in first])
        away = (y - output.centre) / output.half_range - parts.d
        starts = (
            (away[:, None] * parts.C / max(float(parts.C @ parts.C), _RIDGE))
            .clip(-1.0, 1.0)
            .ravel()
        )
        form = self._strength / self._problem.count * _LINEAR * np.eye(len(starts))
        for length in (OBSERVED * structure.states, None):
            segments = [
                s if length is None else s._replace(length=min(s.length, length))
                for s in self._segments
            ]
            runs = runs_of(self._problem, structure, segments)

            def sums(at: Array, sensitivities: bool, runs: StateRuns = runs) -> Sums:
                out = Sums(*runs.sums(np.append(parameters, at), sensitivities))
                if not sensitivities:
                    return out
                products, gradient = out.products[states, states], out.gradient[states]
                return out._replace(products=products, gradient=gradient)

            starts, _ = descend(sums, starts, form, self._problem.variance, ITERATIONS)
        return np.append(parameters, starts)

    def _prior(self, model: _Model) -> Array:
        count = model.structure.count
        out = np.diag(np.full(len(model.theta), _LINEAR))
        out[:count, :count] = prior_of(model.structure)
        return out

    def _scaled(self, structure: StateSpace, theta: Array) -> Array:
        """Rescales the states of a linear model so that their largest magnitude is one."""
        x = self._runs(structure).states(theta)
        reach = np.maximum(np.abs(x).max(axis=0), _RIDGE)
        parts = structure.parts(theta)
        return np.concatenate([
            (parts.A * reach / reach[:, None]).ravel(),
            (parts.B / reach[:, None]).ravel(),
            parts.C * reach,
            parts.D,
            [parts.d],
            (theta[structure.count :].reshape(-1, structure.states) / reach).ravel(),
        ])  # fmt: skip

    def _promising(self) -> list[_Model]:
        """Returns the `_TRIED` models with one more curve that explain most error to 1st order."""
        present = self._model.structure
        structure = replace(present, curves=present.curves + 1)
        at = self._model.theta
        form = self._strength / self._problem.count * self._prior(self._model)
        candidates: list[tuple[float, Array]] = []
        for v in self._directions():
            sums = Sums(*self._runs(present, v).sums(at, True))
            for k, (gain, splines) in enumerate(self._gains(sums, form)):
                target = np.eye(present.states + 1)[k]
                curve = np.concatenate([v, target, splines])
                candidates.append((gain, np.insert(at, present.count, curve)))
        candidates.sort(key=lambda candidate: -candidate[0])
        return [_Model(structure, theta) for _, theta in candidates[:_TRIED]]

    def _gains(self, sums: Sums, form: Array) -> Iterator[tuple[float, Array]]:
        """Yields gain and spline weights of a curve that acts on state 1, 2, ..., n, or on y.

        The gain is the share of squared error explained to first order; see `lags.promises`.
        """
        structure, width = self._model.structure, len(form)
        scale = max(sums.error, LEAST_SHARE)
        products, gradient = sums.products / scale, sums.gradient / scale
        hessian = products[:width, :width] + form
        cross = products[width:, :width]
        inner = solve(hessian, np.column_stack([cross.T, gradient[:width]]))
        left = gradient[width:] - cross @ inner[:, -1]
        gram = products[width:, width:] - cross @ inner[:, :-1]
        curve = self._strength / self._problem.count * roughness(structure.splines)
        for rows in np.split(np.arange(len(left)), structure.states + 1):
            splines = solve(gram[np.ix_(rows, rows)] + curve, left[rows])
            yield float(left[rows] @ splines), splines

    def _directions(self) -> list[Array]:
        """Returns weights v of states and inputs in the argument v' [x; u] of a new curve.

        Each state and input alone, the output, its rate, and random weights; all peak at |z| = 1.
        """
        structure = self._model.structure
        parts = structure.parts(self._model.parameters)
        x = self._runs(structure).states(self._model.theta)
        z = np.column_stack([x, self._inputs(structure)])
        _, spread, axes = np.linalg.svd(z - z.mean(axis=0), full_matrices=False)
        spread = np.maximum(spread / np.sqrt(len(z)), 1e-3 * spread[0] / np.sqrt(len(z)))
        wanted = [
            *np.eye(z.shape[1]),
            np.append(parts.C, parts.D),
            np.append(parts.C @ parts.A - parts.C, parts.C @ parts.B),
            *((self._rng.normal(size=(_RANDOM, len(spread))) / spread) @ axes),
        ]
        reach = [np.abs(z @ v).max() for v in wanted]
        return [v / r for v, r in zip(wanted, reach, strict=True) if r > _RIDGE]

    def _inputs(self, structure: StateSpace) -> Array:
        signals = self._problem.template.inputs
        columns = []
        for s in self._segments:
            u = self._problem.records[s.record].u
            at = np.arange(s.start, s.start + s.length)
            columns.append(np.column_stack([
                (u[np.maximum(at - d, 0), j] - signal.centre) / signal.half_range
                for j, (d, signal) in enumerate(zip(structure.delays, signals, strict=True))
            ]))  # fmt: skip
        return np.concatenate(columns)


def prior_of(structure: StateSpace) -> Array:
    """Returns the prior precision: spline weights about 0, other parameters about the start."""
    out = np.diag(np.full(structure.count, _LINEAR))
    curves = np.arange(structure.linear, structure.count)
    out[curves, curves] = 1.0
    for rows in structure.spline_weights:
        out[np.ix_(rows, rows)] = roughness(structure.splines)
    return out


def realised(problem: Problem, structure: StateSpace, segments: Sequence[Stretch]) -> Array:
    """Returns the parameters of a balanced realisation of a high-order ARX model, (count,).

    The method of Ho and Kalman realises the impulse response (Kung 1978).
    """
    n, inputs = structure.states, len(structure.delays)
    lags = max(n, min(_ARX, problem.count // (10 * (1 + inputs))))
    output, signals = problem.template.output, problem.template.inputs
    rows, right = [], []
    for s in segments:
        record = problem.records[s.record]
        y = (record.y[s.start : s.start + s.length] - output.centre) / output.half_range
        at = np.arange(lags, s.length)
        columns = [y[at - k] for k in range(1, lags + 1)]
        for j, (delay, signal) in enumerate(zip(structure.delays, signals, strict=True)):
            late = np.maximum(np.arange(s.length) + s.start - delay, 0)
            u = (record.u[late, j] - signal.centre) / signal.half_range
            columns += [u[at - k] for k in range(lags + 1)]
        table = np.column_stack([*columns, np.ones(len(at)), y[at]])
        table = table[np.isfinite(table).all(axis=1)]
        rows.append(table[:, :-1])
        right.append(table[:, -1])
    table, wanted = np.concatenate(rows), np.concatenate(right)
    ridge = 1e-6 * max(len(wanted), 1) * np.eye(table.shape[1])
    arx = solve(table.T @ table + ridge, table.T @ wanted)
    a, b = arx[:lags], arx[lags:-1].reshape(inputs, lags + 1)
    response = np.zeros((2 * _RESPONSE + 1, inputs))
    for t in range(len(response)):
        past = response[max(t - lags, 0) : t][::-1]
        response[t] = a[: len(past)] @ past + (b[:, t] if t <= lags else 0.0)
    response = np.nan_to_num(np.clip(response, -1e3, 1e3))
    left, spread, across = np.linalg.svd(_hankel(response, 1), full_matrices=False)
    root = np.sqrt(np.maximum(spread[:n], _RIDGE))
    left, across = left[:, :n], across[:n]
    matrix = (left / root).T @ _hankel(response, 2) @ (across.T / root)
    largest = np.abs(np.linalg.eigvals(matrix)).max()
    matrix *= min(1.0, 0.999 / max(largest, _RIDGE))
    reach = (root[:, None] * across)[:, :inputs]
    return np.concatenate([matrix.ravel(), reach.ravel(), left[0] * root, response[0], [arx[-1]]])


def _hankel(response: Array, first: int) -> Array:
    """Returns the Hankel matrix: row i, column block k is the response at sample first + i + k."""
    at = first + np.arange(_RESPONSE)[:, None] + np.arange(_RESPONSE)
    return response[at].reshape(_RESPONSE, -1)


def refitted(problem: Problem, fit: Fit, strength: float, budget: int) -> Fit:
    """Refits a model to at most `budget` samples, starting from its present parameters."""
    return StatePath(problem, _structure(fit), strength, budget, start=fit.theta).fit


def information_of(problem: Problem, fit: Fit, strength: float) -> Array:
    """Returns the information matrix of the parameters, times the variance of the output error.

    The sum of psi psi' over all records, run from rest, plus the prior's; psi = d y / d theta.
    """
    structure = _structure(fit)
    total = strength * fit.error**2 * problem.variance * prior_of(structure)
    for whole in _whole(problem):
        runs = runs_of(problem, structure, [whole])
        sums = Sums(*runs.sums(np.append(fit.theta, np.zeros(structure.states)), True))
        total += sums.products[: structure.count, : structure.count]
    return total


def variances(problem: Problem, fit: Fit) -> Array:
    """Returns the variances of the scaled states and inputs over all records, (n + M,)."""
    structure, records = _structure(fit), _whole(problem)
    rest = np.zeros(structure.states * len(records))
    x = runs_of(problem, structure, records).states(np.append(fit.theta, rest))
    signals = problem.template.inputs
    inputs = [float(np.std(problem.samples[s.name])) / s.half_range for s in signals]
    return np.append(x.var(axis=0), np.square(inputs))


def _whole(problem: Problem) -> list[Stretch]:
    return [Stretch(k, 0, len(record)) for k, record in enumerate(problem.records)]


def _structure(fit: Fit) -> StateSpace:
    (structure,) = fit.features
    assert isinstance(structure, StateSpace), structure
    return structure
