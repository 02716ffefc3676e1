"""Output-error fits, which minimise the free-run error over stretches (samples of a record)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache, cached_property, lru_cache, partial
from operator import add
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from leglab._native.structure import Runs
from leglab.identification.features import Feature, Spline
from leglab.identification.settings import SignalSettings
from leglab.identification.spline_narx import ParameterBlock, SplineNarx, SplineNarxSettings
from leglab.identification.spline_state_space import (
    SplineStateSpace,
    SplineStateSpaceSettings,
    StateSpace,
)

Array = NDArray[np.float64]
# Structure of a model: features of lagged signals, or a single `StateSpace`.
Features = Sequence[Feature | StateSpace]
Settings = SplineNarxSettings | SplineStateSpaceSettings
Model = SplineNarx | SplineStateSpace
# Prior precision of the second differences of a spline's weights; that of a weight is 1. Signals
# are scaled to [-1, 1], so all constants of this file are dimensionless.
SMOOTHNESS = 10.0
ITERATIONS = 25
_CONVERGED = 2e-4  # a fit ends if an iteration lowers the cost by no more than this
LEAST_SHARE = 1e-20  # lower bound of squared errors, in output variances; less is rounding
_FIRST_DAMPING, _LEAST_DAMPING, _FACTOR, _TRIES = 1e-3, 1e-9, 8.0, 6
SHORTEST = 60  # minimum samples of a stretch: a free run must outlast its measured initial outputs
_MOST_STARTS = 5000  # approximate number of one-step errors in the least squares that start a fit
# Mean squared error assigned to a diverging free run, in variances of the output.
DIVERGED = 1e9


@dataclass(frozen=True)
class Record:
    """Signals of one recording, uniformly sampled.

    Attributes:
        u: Inputs, finite, (N, M).
        y: Output, (N,); NaN where it is missing.
        name: Name of the recording.
    """

    u: Array
    y: Array
    name: str = ""

    def __len__(self) -> int:
        return len(self.y)


class Stretch(NamedTuple):
    """Samples start ... start + length - 1 of one record, simulated from the measured past."""

    record: int
    start: int
    length: int


class Sums(NamedTuple):
    """Scaled sums of a Gauss-Newton step over stretches; see csrc/identification/free_run.h."""

    error: float
    samples: int
    products: Array
    gradient: Array
    squares: Array


class Further:
    """Candidate features of the next selection step, with their parameter blocks for the core."""

    def __init__(self, template: SplineNarxSettings, features: Sequence[Feature]) -> None:
        self.features = tuple(features)
        self.blocks = replace(template, features=self.features).blocks if features else ()

    def without(self, index: int) -> "Further":
        """Returns the candidates without the one at `index`."""
        out = object.__new__(Further)
        out.features = self.features[:index] + self.features[index + 1 :]
        out.blocks = self.blocks[:index] + self.blocks[index + 1 :]
        return out


class Simulator:
    """Free runs of one structure over records."""

    def __init__(
        self,
        settings: SplineNarxSettings,
        records: Sequence[Record],
        further: Sequence[ParameterBlock] = (),
    ) -> None:
        self.settings = settings
        self._runs = [Runs(settings, further, r.u, r.y) for r in records]

    def sums(self, theta: Array, stretches: Sequence[Stretch], *, sensitivities: bool) -> Sums:
        """Returns the sums over the stretches; without `sensitivities` their sums are zero."""
        total: tuple | None = None
        by_record: dict[int, list[tuple[int, int]]] = {}
        for record, start, length in stretches:
            by_record.setdefault(record, []).append((start, length))
        for record, places in sorted(by_record.items()):
            starts, lengths = np.array(places, dtype=np.int64).T.copy()
            sums = self._runs[record].sums(theta, starts, lengths, sensitivities)
            total = sums if total is None else tuple(map(add, total, sums))
        assert total is not None, "no stretch"
        return Sums(*total)


class Problem:
    """Training records and the settings shared by all models that are fitted to them.

    Args:
        records: Training records.
        template: Signals with ranges, limits and estimator; a model replaces the features.
    """

    def __init__(self, records: Sequence[Record], template: SplineNarxSettings) -> None:
        self.records = tuple(
            Record(np.ascontiguousarray(r.u, float), np.ascontiguousarray(r.y, float), r.name)
            for r in records
        )
        self.template = template
        y = np.concatenate([r.y for r in self.records])
        self.deviation = float(np.nanstd(y))
        self.variance = (self.deviation / template.output.half_range) ** 2  # in scaled units
        self.count = int(np.isfinite(y).sum())
        # A search asks for the same structure many times, and its settings are checked when made.
        self._lagged = lru_cache(maxsize=1000)(partial(replace, template))

    @cached_property
    def samples(self) -> dict[str, Array]:
        """Finite values of each signal over all records, by name."""
        columns = [np.concatenate([r.y for r in self.records])]
        columns += list(np.concatenate([r.u for r in self.records]).T)
        names = self.template.names
        return {n: c[np.isfinite(c)] for n, c in zip(names, columns, strict=True)}

    def lagged(self, features: Features) -> SplineNarxSettings:
        """Returns the settings of a model of lags; a state space among the features is ignored."""
        chosen = tuple(f for f in features if not isinstance(f, StateSpace))
        return self._lagged(features=chosen)

    def model(self, features: Features) -> Settings:
        """Returns the settings of a model of lags, or of a state-space model."""
        first = features[0]
        if not isinstance(first, StateSpace):
            return self.lagged(features)
        return SplineStateSpaceSettings(
            structure=first,
            **{field.name: getattr(self.template, field.name) for field in fields(SignalSettings)},
        )

    def identifier(self, fit: "Fit") -> Model:
        """Returns an identifier with the fitted parameters."""
        settings = self.model(fit.features)
        if isinstance(settings, SplineNarxSettings):
            model: Model = SplineNarx(settings)
        else:
            model = SplineStateSpace(settings)
        model.parameters = fit.theta
        return model

    def error_of(self, fit: "Fit", block: Stretch, first: int) -> float:
        """Returns the mean squared free-run error in a block, as a share of the output's variance.

        The run begins at the sample `first`, if possible long before the block, because a model
        is more accurate shortly after the measured initial outputs than in a long run.
        """
        model, record = self.identifier(fit), self.records[block.record]
        end = block.start + block.length
        u = record.u[first - model.lags : end]
        run = model.free_run(single(u), record.y[first - model.lags : first])
        error = record.y[block.start : end] - run[-block.length :]
        share = float(np.nanmean(error**2)) / self.deviation**2
        return float(np.clip(share, LEAST_SHARE, DIVERGED)) if np.isfinite(share) else DIVERGED


def single(u: Array) -> Array:
    """Returns inputs (N, M) in the shape that an identifier takes: (N,) if M is 1."""
    return u[:, 0] if u.shape[1] == 1 else u


@dataclass(frozen=True)
class Fit:
    """A fitted model.

    Attributes:
        features: Features of lagged signals, or a single state space.
        theta: Parameters in scaled units.
        error: RMS error of the free run over the stretches of the fit, as a share of the output's
            standard deviation.
    """

    features: tuple[Feature | StateSpace, ...]
    theta: Array
    error: float


@cache
def roughness(splines: int) -> Array:
    """Returns the prior precision of spline weights: I + SMOOTHNESS D'D, D: second differences."""
    second = np.diff(np.eye(splines), 2, axis=0)
    return np.eye(splines) + SMOOTHNESS * second.T @ second


def prior(features: Sequence[Feature], blocks: Sequence[ParameterBlock]) -> Array:
    """Returns the prior precision of unit strength, (n, n): I, but `roughness` for splines."""
    out = np.eye(sum(block.count for block in blocks))
    at = 0
    for feature, block in zip(features, blocks, strict=True):
        rows = slice(at, at + block.count)
        if isinstance(feature, Spline):
            out[rows, rows] = roughness(block.count)
        at = rows.stop
    return out


def solve(matrix: Array, right: Array) -> Array:
    """Solves a linear system; returns the least-norm solution if the matrix is singular."""
    try:
        return np.asarray(np.linalg.solve(matrix, right), float)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0], float)


class HasSums(Protocol):
    """Sums from which a Gauss-Newton step is computed."""

    @property
    def error(self) -> float: ...  # noqa: D102
    @property
    def samples(self) -> int: ...  # noqa: D102
    @property
    def products(self) -> Array: ...  # noqa: D102
    @property
    def gradient(self) -> Array: ...  # noqa: D102


def descend(
    sums: Callable[[Array, bool], HasSums],
    theta: Array,
    form: Array,
    variance: float,
    iterations: int,
    centre: Array | float = 0.0,
) -> tuple[Array, float]:
    """Computes maximum a-posteriori parameters by damped Gauss-Newton steps (Marquardt 1963).

    Minimises log E + (theta - centre)' R (theta - centre), with the mean squared free-run error E
    and the prior's precision matrix R. The logarithm arises because the error variance is unknown.

    Args:
        sums: Function of parameters and of whether sensitivities are wanted.
        theta: Initial parameters, (n,).
        form: R, (n, n).
        variance: Variance of the output, in the units of the sums' squared error.
        iterations: Maximum number of iterations.
        centre: Mean of the prior.

    Returns:
        Parameters, and the RMS error as a share of the output's standard deviation.
    """
    present = sums(theta, True)
    scale = variance * max(present.samples, 1)

    def cost(error: float, at: Array) -> float:
        if not np.isfinite(error):
            return np.inf
        away = at - centre
        return float(np.log(max(error / scale, LEAST_SHARE)) + away @ form @ away)

    error, damping = present.error, _FIRST_DAMPING
    best = cost(error, theta)
    for _ in range(iterations):
        level = max(error, LEAST_SHARE * scale)
        hessian = present.products / level + form
        downhill = present.gradient / level - form @ (theta - centre)
        for _ in range(_TRIES):
            damped = hessian + damping * np.diag(np.diag(hessian))
            tried = theta + solve(damped, downhill)
            tried_error = sums(tried, False).error
            tried_cost = cost(tried_error, tried)
            if tried_cost < best:
                break
            damping *= _FACTOR
        else:
            break
        theta, error = tried, tried_error
        damping = max(damping / _FACTOR, _LEAST_DAMPING)
        fell, best = best - tried_cost > _CONVERGED, tried_cost
        if not fell:
            break
        present = sums(theta, True)
    rms = float(np.sqrt(min(error / scale, DIVERGED))) if np.isfinite(error) else DIVERGED
    return theta, rms


def fit(
    problem: Problem,
    features: Sequence[Feature],
    theta: Array,
    stretches: Sequence[Stretch],
    strength: float,
    iterations: int = ITERATIONS,
) -> Fit:
    """Fits a model of lags by `descend`, with `strength` times the `prior`."""
    settings = problem.lagged(features)
    simulator = Simulator(settings, problem.records)
    form = strength * prior(features, settings.blocks) / problem.count

    def sums(at: Array, sensitivities: bool) -> Sums:
        return simulator.sums(at, stretches, sensitivities=sensitivities)

    return Fit(tuple(features), *descend(sums, theta, form, problem.variance, iterations))


def one_step(
    problem: Problem, features: Sequence[Feature], without: Stretch | None = None
) -> Array:
    """Fits one-step predictions by least squares, to initialise output-error fits."""
    settings = problem.lagged(features)
    simulator = Simulator(settings, problem.records)
    stretches = one_step_stretches(problem, settings.lags, without, _MOST_STARTS)
    theta = np.zeros(sum(block.count for block in settings.blocks))
    sums = simulator.sums(theta, stretches, sensitivities=True)
    scale = problem.variance * max(sums.samples, 1)
    # Weight of the prior if the RMS one-step error is 0.001 standard deviations of the output.
    form = 1e-6 * prior(features, settings.blocks) / problem.count
    return solve(sums.products / scale + form, sums.gradient / scale)


def one_step_stretches(
    problem: Problem, depth: int, without: Stretch | None = None, most: int | None = None
) -> list[Stretch]:
    """Returns stretches of one sample: free runs over them are one-step predictions.

    Args:
        problem: Records.
        depth: Number of measured outputs that must precede a sample.
        without: Held-out stretch; no output of it is used.
        most: Approximate number of samples, evenly spaced; None takes all.
    """
    every = 1 if most is None else max(1, problem.count // most)
    out = []
    for k, record in enumerate(problem.records):
        usable = startable(record, depth)
        if without is not None and without.record == k:
            usable[without.start : without.start + without.length + depth] = False
        out += [Stretch(k, t, 1) for t in np.flatnonzero(usable)[::every].tolist()]
    return out


def whole_runs(problem: Problem, depth: int) -> list[Stretch]:
    """Returns one stretch per record, from the first sample after `depth` measured outputs on."""
    out = []
    for k, record in enumerate(problem.records):
        usable = np.flatnonzero(startable(record, depth))
        if len(usable):
            out.append(Stretch(k, int(usable[0]), len(record) - int(usable[0])))
    return out


def startable(record: Record, depth: int) -> NDArray[np.bool_]:
    """Tests for each sample whether the `depth` outputs before the sample are measured, (N,)."""
    gaps = np.concatenate([[0], np.cumsum(~np.isfinite(record.y))])
    out = np.zeros(len(record), dtype=bool)
    at = np.arange(depth, len(record))
    out[at] = gaps[at] == gaps[at - depth]
    return out
