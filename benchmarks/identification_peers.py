"""Accuracy and time per sample beside padasip, river, SysIdentPy and NumPy/SciPy, in one run.

Every linear model gets the same regressor [y(t-1..t-3), u(t-1..t-3), 1], scaled by the same
declared ranges, and the same F(0) = 1e4 I. All are free-run tested on samples they have not seen.
Times are processor times of one thread, the best of `REPEATS` passes over the training part,
construction included: other work on the machine, which peers would wait for, counts for nobody.
RMSE in the unit of the data (Silverbox: mV). Measuring needs padasip, river and sysidentpy.
"""

import argparse
import logging
import os
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from importlib import metadata
from multiprocessing import get_context

import numpy as np
import scipy.linalg
import scipy.signal

from benchmarks import data_sets, results
from benchmarks.data_sets import SILVERBOX, Dataset
from leglab.base.scale import rms
from leglab.identification import BsnnArx, SplineNarx
from replication import deployed, paper
from replication.online import OnlineSettings
from replication.plant import simulate

LAGS = 3
INITIAL_GAIN = 1e4
REPEATS = 7


@dataclass(frozen=True, kw_only=True)
class Result:
    """Nanoseconds a sample of training, one-step and free-run RMSE, parameters."""

    nanoseconds: float
    one_step: float
    free_run: float
    parameters: int


def best_time(work: Callable[[], object], samples: int) -> tuple[float, object]:
    """Nanoseconds a sample of the fastest of `REPEATS` calls, and what the last returned."""
    times = []
    for _ in range(REPEATS):
        start = time.process_time()
        result = work()
        times.append(time.process_time() - start)
    return min(times) / samples * 1e9, result


class Problem:
    """Scaled training and test signals, and scores in the unit of the data."""

    def __init__(self, data: Dataset, centre: tuple[float, float], samples: int) -> None:
        self.data = data
        self.centre = centre
        train, test = data.train, next(iter(data.tests.values()))
        self.raw = [signal[train][:samples] for signal in (data.u, data.y)]
        self.raw_test = [signal[test] for signal in (data.u, data.y)]
        pairs = list(zip(centre, data.ranges, strict=True))
        self.u, self.y = ((s - c) / r for s, (c, r) in zip(self.raw, pairs, strict=True))
        self.u_test, self.y_test = (
            (s - c) / r for s, (c, r) in zip(self.raw_test, pairs, strict=True)
        )
        self.learned = self.regressors(self.u, self.y), self.y[LAGS:]

    def regressors(self, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Rows for t = 3 .. n-1."""
        n = len(u)
        lagged = [s[LAGS - k : n - k] for s in (y, u) for k in range(1, LAGS + 1)]
        return np.column_stack([*lagged, np.ones(n - LAGS)])

    def score(self, residual: np.ndarray, *, scaled: bool = True) -> float:
        """RMSE behind the given samples, in the unit of the data."""
        factor = self.data.unit[1] * (self.data.ranges[1] if scaled else 1.0)
        with np.errstate(over="ignore", invalid="ignore"):
            error = float(rms(residual[self.data.given :])) * factor
        return error if np.isfinite(error) else float("inf")

    def linear(self, nanoseconds: float, theta: np.ndarray) -> Result:
        """Scores the linear model with the parameters `theta`."""
        rows = self.regressors(self.u_test, self.y_test)
        one_step = np.concatenate([np.zeros(LAGS), rows @ theta - self.y_test[LAGS:]])
        with np.errstate(over="ignore", invalid="ignore"):
            free = self.simulate(theta) - self.y_test
        return Result(
            nanoseconds=nanoseconds,
            one_step=self.score(one_step),
            free_run=self.score(free),
            parameters=len(theta),
        )

    def simulate(self, theta: np.ndarray) -> np.ndarray:
        """Free run of the linear model."""
        drive = self.regressors(self.u_test, np.zeros_like(self.y_test)) @ theta
        denominator = np.concatenate([[1.0], -theta[:LAGS]])
        given = self.y_test[:LAGS]
        state = scipy.signal.lfiltic([1.0], denominator, given[::-1])
        return np.concatenate([given, scipy.signal.lfilter([1.0], denominator, drive, zi=state)[0]])


def numpy_rls(problem: Problem) -> Result:
    rows, targets = problem.learned

    def learn() -> np.ndarray:
        theta, gain = np.zeros(rows.shape[1]), INITIAL_GAIN * np.eye(rows.shape[1])
        for phi, target in zip(rows, targets, strict=True):
            k = gain @ phi
            denominator = 1.0 + phi @ k
            theta = theta + k * ((target - phi @ theta) / denominator)
            gain = gain - np.outer(k, k) / denominator
        return theta

    return problem.linear(*best_time(learn, len(rows)))


def scipy_batch(problem: Problem) -> Result:
    rows, targets = problem.learned
    return problem.linear(*best_time(lambda: scipy.linalg.lstsq(rows, targets)[0], len(rows)))


def padasip_filter(problem: Problem, make: Callable[[int], object]) -> Result:
    rows, targets = problem.learned

    def learn() -> np.ndarray:
        adaptive = make(rows.shape[1])
        for phi, target in zip(rows, targets, strict=True):
            adaptive.adapt(target, phi)
        return np.array(adaptive.w)

    return problem.linear(*best_time(learn, len(rows)))


def river_regression(problem: Problem) -> Result:
    """Bayesian linear regression: with the prior 1/F(0) it is RLS without forgetting."""
    from river.linear_model import BayesianLinearRegression

    rows, targets = problem.learned
    names = [f"x{i}" for i in range(rows.shape[1])]
    samples = [dict(zip(names, row, strict=True)) for row in rows.tolist()]

    def learn() -> BayesianLinearRegression:
        model = BayesianLinearRegression(alpha=1 / INITIAL_GAIN, beta=1.0)
        for sample, target in zip(samples, targets.tolist(), strict=True):
            model.learn_one(sample, target)
        return model

    nanoseconds, model = best_time(learn, len(rows))
    # It tells its weights by what it predicts for each input alone.
    zero = dict.fromkeys(names, 0.0)
    theta = np.array([model.predict_one({**zero, name: 1.0}) for name in names])
    return problem.linear(nanoseconds, theta)


def sysidentpy_frols(problem: Problem, degree: int, estimator: object) -> Result:
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS

    train_u, train_y = (s.reshape(-1, 1) for s in (problem.u, problem.y))
    test_u, test_y = (s.reshape(-1, 1) for s in (problem.u_test, problem.y_test))

    def learn() -> FROLS:
        model = FROLS(
            order_selection=True,
            n_info_values=15,
            ylag=LAGS,
            xlag=LAGS,
            estimator=estimator,
            basis_function=Polynomial(degree=degree),
        )
        model.fit(X=train_u, y=train_y)
        return model

    nanoseconds, model = best_time(learn, len(train_u))
    one_step = model.predict(X=test_u, y=test_y, steps_ahead=1)
    free = model.predict(X=test_u, y=test_y[: model.max_lag])
    return Result(
        nanoseconds=nanoseconds,
        one_step=problem.score((one_step - test_y)[:, 0]),
        free_run=problem.score((free - test_y)[:, 0]),
        parameters=len(model.theta),
    )


def ours(problem: Problem, make: Callable[[], object], *, single: bool = False) -> Result:
    u, y = problem.raw

    def learn() -> object:
        model = make()
        if single:
            for pair in zip(u.tolist(), y.tolist(), strict=True):
                model.update(*pair)
        else:
            model.run(u, y)
        return model

    nanoseconds, model = best_time(learn, len(u))
    model.freeze()
    u_test, y_test = problem.raw_test
    with np.errstate(over="ignore", invalid="ignore"):
        free = model.free_run(u_test, y_test[: problem.data.given]) - y_test
    return Result(
        nanoseconds=nanoseconds,
        one_step=problem.score(model.one_step(u_test, y_test) - y_test, scaled=False),
        free_run=problem.score(free, scaled=False),
        parameters=len(model.parameters),
    )


def paper_model() -> BsnnArx:
    model = BsnnArx(OnlineSettings().bsnn_arx())
    model.randomise(np.random.default_rng(0))
    return model


def plant_problem() -> tuple[Problem, Callable[[], SplineNarx], Callable[[], SplineNarx]]:
    u, y = (signal[0] for signal in simulate([paper.SEED], paper.N_SAMPLES))
    n = paper.N_TRAINING
    data = Dataset(
        name="plant of Eq. 23",
        u=u,
        y=y,
        train=slice(0, n),
        tests={"validation": slice(n, paper.N_SAMPLES)},
        given=10,
        unit=("", 1.0),
        ranges=(deployed.U.half_range, deployed.Y.half_range),
    )
    linear = deployed.MODELS["ARX + constant"]
    problem = Problem(data, (deployed.U.centre, deployed.Y.centre), n)
    return problem, lambda: SplineNarx(linear), lambda: SplineNarx(deployed.settings())


def silverbox_problem(samples: int) -> tuple[Problem, Callable, Callable]:
    data = data_sets.silverbox()
    linear = data_sets.spline_narx(data, na=LAGS, nb=LAGS, nk=1)
    full = data_sets.spline_narx(data, **SILVERBOX)
    problem = Problem(data, (0.0, 0.0), samples)
    return problem, lambda: SplineNarx(linear), lambda: SplineNarx(full)


def compare(problem: Problem, linear: Callable, full: Callable) -> dict[str, Result]:
    import padasip
    from sysidentpy.parameter_estimation import LeastSquares, RecursiveLeastSquares

    filters, frols = (
        f"{name} {metadata.version(name.lower())}" for name in ("padasip", "SysIdentPy")
    )
    models = {"ARX + constant": linear, "deployed": full}
    if problem.data.name != "Silverbox":  # its ranges are those of the paper's experiment
        models = {"paper's BSNN-ARX": paper_model, **models}
    found = {}
    for name, make in models.items():
        found[f"leglab, {name}, array"] = ours(problem, make)
        found[f"leglab, {name}, single calls"] = ours(problem, make, single=True)
    return found | {
        f"{filters} RLS": padasip_filter(
            problem, lambda n: padasip.filters.FilterRLS(n, mu=1.0, eps=1 / INITIAL_GAIN, w="zeros")
        ),
        f"{filters} NLMS": padasip_filter(
            problem, lambda n: padasip.filters.FilterNLMS(n, mu=0.5, w="zeros")
        ),
        f"river {metadata.version('river')} Bayesian linear regression": river_regression(problem),
        "NumPy RLS, written out": numpy_rls(problem),
        "SciPy least squares (batch)": scipy_batch(problem),
        f"{frols} FROLS, degree 3, least squares (batch)": sysidentpy_frols(
            problem, 3, LeastSquares()
        ),
        f"{frols} FROLS, degree 1, RLS": sysidentpy_frols(problem, 1, RecursiveLeastSquares()),
    }


def measure(options: argparse.Namespace) -> dict[str, dict[str, dict[str, float]]]:
    """Results by data set and model, from a process of its own that has one thread."""
    for library in ("OMP", "OPENBLAS"):
        os.environ[f"{library}_NUM_THREADS"] = "1"  # read when NumPy is loaded
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        return process.submit(compared, options.samples).result()


def compared(samples: int) -> dict[str, dict[str, dict[str, float]]]:
    """Results by data set and model, with so many samples of Silverbox."""
    warnings.filterwarnings("ignore", module="sysidentpy")
    logging.disable(logging.WARNING)
    cases = [plant_problem()]
    if samples:
        cases.append(silverbox_problem(samples))
    found = {}
    for problem, linear, full in cases:
        title = f"{problem.data.name}, {len(problem.u)} samples"
        rows = compare(problem, linear, full)
        found[title] = {name: asdict(result) for name, result in rows.items()}
    return found


def tables(found: dict[str, dict[str, dict[str, float]]]) -> str:
    """A table a data set."""
    grids = []
    for title, rows in found.items():
        cells = [
            (
                name,
                str(row["parameters"]),
                results.number(row["nanoseconds"], 2),
                *(
                    "diverges" if e is None else f"{e:.4f}"
                    for e in (row["one_step"], row["free_run"])
                ),
            )
            for name, row in rows.items()
        ]
        head = (title, "parameters", "ns a sample", "one step", "free run")
        grids.append(results.table(head, cells))
    return "\n".join(grids)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--samples", type=int, default=20_000, help="of Silverbox; 0 leaves it out")
