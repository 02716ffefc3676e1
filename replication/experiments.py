"""Experiments with the paper's models: Table 1, convergence, sensitivity, cost of an update."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from timeit import timeit
from typing import NamedTuple

import numpy as np

from leglab.base.scale import rms
from leglab.identification import Basis, BsnnArx
from replication.networks import LAGS, train
from replication.online import (
    PAPER_MODE,
    OnlineRuns,
    OnlineSettings,
    for_joints,
    online_models,
    run_online,
    static_alone,
)
from replication.paper import (
    INSTANCES,
    LEARNING_CONSTANT,
    MODELS,
    N_TRAINING,
    PRINTED_LEARNING_CONSTANT,
    Array,
    Scores,
    score,
)
from replication.plant import simulate


@dataclass(frozen=True, kw_only=True)
class ModelComparison:
    """Scores of all models and an exemplary validation prediction of each."""

    scores: Scores  #: Scores by set (training, validation), then by model
    online: OnlineRuns  #: Predictions of the online models
    #: First instance of each model on the validation set, shape (n_validation,): one step ahead for
    #: BSNN, ARX and BSNN-ARX, free run for NNARX and NNOE.
    examples: dict[str, Array]


def compare(
    u: Array,
    y: Array,
    instances: int,
    seed: int,
    *,
    settings: OnlineSettings = PAPER_MODE,
    progress: Callable[[str], None] | None = None,
) -> ModelComparison:
    """Runs `instances` instances of each model, which differ in their initial parameters.

    Arguments as `run_online`; `progress` is called with a line before each part.
    """
    say = progress or (lambda line: None)
    say(f"BSNN, ARX, BSNN-ARX: {instances} instances")
    online = run_online(u, y, instances, seed, settings)
    scores = online.scores(y)
    examples = {model: run.validation[:, 0] for model, run in online.runs.items()}
    n = N_TRAINING
    for model, output_error in (("NNARX", False), ("NNOE", True)):
        say(f"{model}: {instances} instances by Levenberg-Marquardt")
        rng = np.random.default_rng([seed, int(output_error)])
        networks = [
            train(u[:n], y[:n], output_error=output_error, rng=rng) for _ in range(instances)
        ]
        for name, part in (("training", slice(0, n)), ("validation", slice(n, None))):
            runs = np.column_stack([net.free_run(u[part], y[part][:LAGS]) for net in networks])
            scores[name][model] = score(y[part], runs)
        examples[model] = runs[:, 0]
    return ModelComparison(scores=scores, online=online, examples=examples)


WEIGHTS_SETTLED = 300
"""Samples after which the paper calls the weights stable."""


@dataclass(frozen=True, kw_only=True)
class Convergence:
    """Parameters during adaptation, and their distances from their final values."""

    weights: Array  #: Weights of the first BSNN instance over the training part, (n, neurons)
    bsnn: Array  #: A-priori predictions of the first BSNN instance, (n,)
    theta: Array  #: ARX parameters of the first BSNN-ARX instance, (n, 6)
    theta_alone: Array  #: Parameters of the first ARX instance, (n, 6)
    distances: dict[str, float]  #: Named measures, means over the instances


def converge(u: Array, y: Array, instances: int, seed: int) -> Convergence:
    """Adapts on the training part and continues the pass to the end of the signals.

    Args:
        u: Input, longer than the training part, shape (n,).
        y: Output.
        instances: Instances of each model.
        seed: Seed of the initial parameters.
    """
    n = N_TRAINING
    bsnn, alone, model = online_models(instances, seed, PAPER_MODE).values()
    start = np.atleast_2d(model.weights).copy()
    order, neurons = model.settings.na + model.settings.nb, start.shape[-1]
    trajectory = _record(model, u, y)[1]
    theta, weights = trajectory[..., :order], trajectory[..., order : order + neurons]
    theta_alone = _record(alone, u, y)[1][..., :order]
    prediction = _record(bsnn, u[:n], y[:n])[0]

    basis = model.settings.network.basis[0]
    inside = np.clip(u[:n], basis.knots[0], basis.knots[-1])
    activation = np.array([np.mean(basis.spline(row)(inside)) for row in np.eye(neurons)])
    settled = weights[n - 1]
    to_go = np.sqrt(np.sum(activation * (weights[WEIGHTS_SETTLED - 1] - settled) ** 2, axis=-1))
    way = np.sqrt(np.sum(activation * (start - settled) ** 2, axis=-1))
    outside = np.mean((u[:n] < basis.knots[0]) | (u[:n] > basis.knots[-1]))
    distances = {
        "weights: part of the way from 0 to 1500 samples left at 300": float(np.mean(to_go / way)),
        f"theta of BSNN-ARX: distance at 1500 to its value at {len(u)}, relative": _away(theta, n),
        f"theta of ARX: distance at 1500 to its value at {len(u)}, relative": _away(theta_alone, n),
        "share of inputs outside [0, 0.8], clamped": float(outside),
    }
    return Convergence(
        weights=weights[:n, 0],
        bsnn=prediction[:, 0],
        theta=theta[:n, 0],
        theta_alone=theta_alone[:n, 0],
        distances=distances,
    )


def _record(model: BsnnArx, u: Array, y: Array) -> tuple[Array, Array]:
    """Returns predictions (n, J) and parameters (n, J, P) of all instances on the same signals."""
    u, y = for_joints(model, u, y)
    prediction, trajectory = model.run_recorded(u, y)
    return prediction.reshape(len(u), -1), trajectory.reshape(len(u), model.joints, -1)


def _away(theta: Array, at: int) -> float:
    gone = np.linalg.norm(theta[at - 1] - theta[-1], axis=-1)
    return float(np.mean(gone / np.linalg.norm(theta[-1], axis=-1)))


Errors = tuple[str, float, float, float, float]

ONLINE = ("BSNN", "ARX", "BSNN-ARX")
INITIAL_GAINS = (1.0, 2.0, 5.6, 10.0, 20.0, 50.0, 100.0, 1e3, 1e4)
LEARNING_CONSTANTS = (PRINTED_LEARNING_CONSTANT, 0.01, 0.02, 0.05, 0.1, LEARNING_CONSTANT, 0.2)
VARIANCES = (0.07**2, 0.02, 0.035, 0.07, 0.14)
"""Of the noise before the filter; the first reads the paper's 0.07 as a standard deviation."""
DIVERGED = 1.0
"""RMS of a free run [units of y] above which it counts as diverged; y itself is about 0.5."""


def readings(u: Array, y: Array, instances: int, seed: int) -> list[Errors]:
    """Computes validation RMS (one step) of the online models by other readings of the paper.

    Args:
        u: Input of the paper-mode realisation, shape (n,).
        y: Output of that realisation, shape (n,).
        instances: Instances per model.
        seed: Seed of the initial parameters.

    Returns:
        Rows (reading, standard deviation of y on the validation set, BSNN, ARX, BSNN-ARX).
    """
    cases = (
        ("paper mode", PAPER_MODE),
        ("Eq. 9 as printed", OnlineSettings(middle_piece="printed")),
        (
            f"learning constant {PRINTED_LEARNING_CONSTANT} as printed",
            OnlineSettings(learning_constant=PRINTED_LEARNING_CONSTANT),
        ),
        ("F(0) = 1e4 I", OnlineSettings(initial_gain=1e4)),
    )
    return [_row(name, u, y, instances, seed, settings) for name, settings in cases]


def input_variance(instances: int, seed: int) -> list[Errors]:
    """Computes rows as `readings` for `VARIANCES` of the noise, with paper mode's noise seed."""
    rows = []
    for variance in VARIANCES:
        u, y = (s[0] for s in simulate([seed], variance=variance))
        rows.append(_row(f"{variance:.2g}", u, y, instances, seed, PAPER_MODE))
    return rows


def _row(
    name: str, u: Array, y: Array, instances: int, seed: int, settings: OnlineSettings
) -> Errors:
    scores = run_online(u, y, instances, seed, settings).scores(y)["validation"]
    bsnn, arx, both = (float(np.mean(scores[m].rms)) for m in ONLINE)
    return name, float(np.std(y[N_TRAINING:])), bsnn, arx, both


def initial_gain(u: Array, y: Array, instances: int, seed: int) -> dict[str, list[float]]:
    """Computes RMS against `INITIAL_GAINS`: one step and free run of ARX and BSNN-ARX.

    Args:
        u: Inputs of several realisations, shape (R, n).
        y: Outputs, shape (R, n).
        instances: Instances per model and realisation.
        seed: Seed of the initial parameters.

    Returns:
        Curves by label; free runs are medians, because some of them diverge.
    """
    curves: dict[str, list[float]] = {}
    for gain in INITIAL_GAINS:
        errors = _errors(u, y, instances, seed, OnlineSettings(initial_gain=gain))
        for model in ONLINE[1:]:
            one, free = errors[model]
            curves.setdefault(f"{model}, one step", []).append(float(np.mean(one)))
            curves.setdefault(f"{model}, free run (median)", []).append(float(np.median(free)))
            share = float(np.mean(~(free < DIVERGED)))
            curves.setdefault(f"{model}, share diverged", []).append(share)
    return curves


def learning_constant(u: Array, y: Array, instances: int, seed: int) -> dict[str, list[float]]:
    """Computes validation RMS (one step) of BSNN and BSNN-ARX against `LEARNING_CONSTANTS`."""
    curves: dict[str, list[float]] = {}
    for eta in LEARNING_CONSTANTS:
        settings = OnlineSettings(learning_constant=eta)
        errors = _errors(u[None], y[None], instances, seed, settings)
        for model in ("BSNN", "BSNN-ARX"):
            curves.setdefault(model, []).append(float(np.mean(errors[model][0])))
    return curves


class Order(NamedTuple):
    """ARX and BSNN-ARX with one learning constant and one F(0), over noise realisations.

    Attributes:
        learning_constant: Learning constant of BSNN-ARX; ARX has none.
        initial_gain: F(0) of both models is this value times the identity.
        arx: Validation RMS (one step) of ARX, mean over realisations and instances.
        bsnn_arx: Validation RMS of BSNN-ARX, likewise.
        better: Number of realisations in which BSNN-ARX has the smaller mean RMS.
    """

    learning_constant: float
    initial_gain: float
    arx: float
    bsnn_arx: float
    better: int


def orders(u: Array, y: Array, instances: int, seed: int) -> list[Order]:
    """Compares BSNN-ARX with ARX over `INITIAL_GAINS`, for both learning constants.

    Arguments as `initial_gain`.
    """
    rows = []
    for constant in (LEARNING_CONSTANT, PRINTED_LEARNING_CONSTANT):
        for gain in INITIAL_GAINS:
            settings = OnlineSettings(initial_gain=gain, learning_constant=constant)
            errors = _errors(u, y, instances, seed, settings)
            arx, both = errors["ARX"][0], errors["BSNN-ARX"][0]
            means = float(np.mean(arx)), float(np.mean(both))
            rows.append(Order(constant, gain, *means, int(np.sum(both < arx))))
    return rows


def spread(u: Array, y: Array, instances: int, seed: int) -> list[Errors]:
    """Computes scatter over realisations: rows (model, mean, standard deviation, least, largest).

    The value of a realisation is the mean over its instances; arguments as `initial_gain`.
    """
    scores = [compare(a, b, instances, seed).scores for a, b in zip(u, y, strict=True)]
    rows = []
    for model in MODELS:
        rms = np.array([np.mean(s["validation"][model].rms) for s in scores])
        mean, deviation, least, most = (float(f(rms)) for f in (np.mean, np.std, np.min, np.max))
        rows.append((model, mean, deviation, least, most))
    return rows


def spline_shapes() -> tuple[Array, dict[str, Array]]:
    """Evaluates the third spline of paper mode over the input: Eq. 9 corrected and as printed.

    Returns:
        Inputs, shape (n,), and the spline's values by reading, each of shape (n,).
    """
    u = np.linspace(0.0, 0.8, 801)
    shapes = {}
    for reading in ("corrected", "printed"):
        model = static_alone(OnlineSettings(middle_piece=reading).bsnn_arx())
        weights = np.zeros(model.parameters.shape)
        weights[0] = weights[3] = 1.0  # the gain behind the network, and the third weight
        model.parameters = weights
        model.freeze()
        shapes[reading] = model.run(u, np.zeros_like(u))
    return u, shapes


def _errors(
    u: Array, y: Array, instances: int, seed: int, settings: OnlineSettings
) -> dict[str, tuple[Array, Array]]:
    """Returns by model the mean one-step RMS per realisation and all instances' free-run RMS."""
    runs = [run_online(a, b, instances, seed, settings).runs for a, b in zip(u, y, strict=True)]
    targets = y[:, N_TRAINING:, None]
    errors = {}
    for model in ONLINE:
        results = [run[model] for run in runs]
        with np.errstate(over="ignore", invalid="ignore"):
            free = [rms(r.free_run - t, axis=0) for r, t in zip(results, targets, strict=True)]
        one = [
            np.mean(rms(r.validation - t, axis=0)) for r, t in zip(results, targets, strict=True)
        ]
        errors[model] = np.array(one), np.concatenate(free)
    return errors


ORDERS = (1, 2, 3, 5, 8, 12, 20, 32)
"""na = nb of the ARX part; its parameters are twice that."""
ROUNDS = 9
SPLINES = (4, 8, 16, 32, 64, 128)


def multiplications(arx_parameters: int, neurons: int) -> int:
    """Returns the number of multiplications of one step (Sec. 3.2).

    5 N^2 + 3 N for RLS with N parameters, 5 N for the BSNN: 238 for 6 parameters and 8 neurons.
    """
    return 5 * arx_parameters**2 + 3 * arx_parameters + 5 * neurons


def update_times() -> list[tuple[int, int, int, float]]:
    """Times batch updates of models of growing size, the best of `ROUNDS` calls each.

    Returns:
        Rows (ARX parameters, neurons, multiplications as counted, nanoseconds per sample).
    """
    samples = 20_000
    rng = np.random.default_rng(0)
    u = rng.uniform(0.0, 0.8, samples)
    y = 0.5 * np.concatenate([[0.0], u[:-1]]) + 0.01 * rng.standard_normal(samples)
    sizes = [(order, 8) for order in ORDERS] + [(3, n) for n in SPLINES if n != 8]
    models, base = [], PAPER_MODE.bsnn_arx()
    for order, neurons in sizes:
        network = replace(base.network, basis=(Basis.uniform(0.0, 0.8, neurons, kind="paper"),))
        models.append(replace(base, na=order, nb=order, network=network))
    # Sizes alternate, so that a temporary slowdown of the computer does not affect only one.
    rounds = [
        [timeit(partial(BsnnArx(settings).run, u, y), number=1) for settings in models]
        for _ in range(ROUNDS)
    ]
    rows = []
    for (order, neurons), best in zip(sizes, np.min(rounds, axis=0).tolist(), strict=True):
        count = multiplications(2 * order, neurons)
        rows.append((2 * order, neurons, count, best / samples * 1e9))
    return rows


def table_time(u: Array, y: Array, seed: int) -> float:
    """Measures the seconds for Table 1's online models: 100 instances, training and validation."""
    return timeit(lambda: run_online(u, y, INSTANCES, seed), number=1)
