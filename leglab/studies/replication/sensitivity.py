"""What Table 1 hangs on: constants the paper does not give, and readings of it."""

import numpy as np
from numpy.typing import NDArray

from leglab.studies.replication import paper
from leglab.studies.replication.comparison import compare
from leglab.studies.replication.online import OnlineRuns, Settings, run_online, static_alone
from leglab.studies.replication.plant import Excitation, simulate

Array = NDArray[np.float64]
Row = tuple[str, float, float, float, float]

ONLINE = ("BSNN", "ARX", "BSNN-ARX")
INITIAL_GAINS = (1.0, 2.0, 5.6, 10.0, 20.0, 50.0, 100.0, 1e3, 1e4)
LEARNING_CONSTANTS = (0.004, 0.01, 0.02, 0.05, 0.1, 0.14, 0.2)
VARIANCES = (0.07**2, 0.02, 0.035, 0.07, 0.14)
"""Of the noise before the filter; the first reads the paper's 0.07 as a standard deviation."""
DIVERGED = 1.0
"""RMS of a free run [units of y] above which it counts as diverged; y itself is about 0.5."""


def readings(u: Array, y: Array, instances: int, seed: int) -> list[Row]:
    """Validation RMS (one step) of the online models under other readings of the paper.

    Args:
        u: Input of the paper-mode realisation, shape (n,).
        y: Its output.
        instances: Instances a model.
        seed: Of the initial parameters.

    Returns:
        Rows (reading, standard deviation of y on the validation set, BSNN, ARX, BSNN-ARX).
    """
    cases = (
        ("paper mode", Settings()),
        ("Eq. 9 as printed", Settings(middle_piece="printed")),
        ("learning constant .004 as printed", Settings(learning_constant=0.004)),
        ("F(0) = 1e4 I", Settings(initial_gain=1e4)),
    )
    return [_row(name, u, y, instances, seed, settings) for name, settings in cases]


def input_variance(instances: int, seed: int) -> list[Row]:
    """The same for `VARIANCES` of the noise, the realisation otherwise that of paper mode."""
    rows = []
    for variance in VARIANCES:
        u, y = (s[0] for s in simulate([seed], excitation=Excitation(variance=variance)))
        rows.append(_row(f"{variance:.2g}", u, y, instances, seed, Settings()))
    return rows


def _row(name: str, u: Array, y: Array, instances: int, seed: int, settings: Settings) -> Row:
    scores = run_online(u, y, instances, seed, settings).scores(y)["validation"]
    bsnn, arx, both = (float(np.mean(scores[m].rms)) for m in ONLINE)
    return name, float(np.std(y[paper.N_TRAINING :])), bsnn, arx, both


def initial_gain(u: Array, y: Array, instances: int, seed: int) -> dict[str, list[float]]:
    """RMS against `INITIAL_GAINS`: one step and free run of ARX and BSNN-ARX.

    Args:
        u: Inputs of several realisations, shape (R, n).
        y: Outputs, shape (R, n).
        instances: Instances a model on each.
        seed: Of the initial parameters.

    Returns:
        Curves by label; free runs are medians, for some of them diverge.
    """
    curves: dict[str, list[float]] = {}
    for gain in INITIAL_GAINS:
        runs = [
            run_online(a, b, instances, seed, Settings(initial_gain=gain))
            for a, b in zip(u, y, strict=True)
        ]
        for model in ONLINE[1:]:
            one, free = _errors(runs, y, model)
            curves.setdefault(f"{model}, one step", []).append(float(np.mean(one)))
            curves.setdefault(f"{model}, free run (median)", []).append(float(np.median(free)))
            share = float(np.mean(~(free < DIVERGED)))
            curves.setdefault(f"{model}, share diverged", []).append(share)
    return curves


def learning_constant(u: Array, y: Array, instances: int, seed: int) -> dict[str, list[float]]:
    """Validation RMS (one step) of BSNN and BSNN-ARX against `LEARNING_CONSTANTS`."""
    curves: dict[str, list[float]] = {}
    for eta in LEARNING_CONSTANTS:
        runs = [run_online(u, y, instances, seed, Settings(learning_constant=eta))]
        for model in ("BSNN", "BSNN-ARX"):
            one, _ = _errors(runs, y[None], model)
            curves.setdefault(model, []).append(float(np.mean(one)))
    return curves


def spread(u: Array, y: Array, instances: int, seed: int) -> list[Row]:
    """Spread over noise realisations: rows (model, mean, standard deviation, least, largest).

    Args:
        u: Inputs of R realisations, shape (R, n).
        y: Outputs, shape (R, n).
        instances: Instances a model on each; a realisation counts with their mean.
        seed: Of the initial parameters.
    """
    scores = [compare(a, b, instances, seed).scores for a, b in zip(u, y, strict=True)]
    rows = []
    for model in paper.MODELS:
        rms = np.array([np.mean(s["validation"][model].rms) for s in scores])
        mean, deviation, least, most = (float(f(rms)) for f in (np.mean, np.std, np.min, np.max))
        rows.append((model, mean, deviation, least, most))
    return rows


def spline_shapes() -> tuple[Array, dict[str, Array]]:
    """Third spline of paper mode over the input: Eq. 9 corrected and as printed.

    Returns:
        Inputs, shape (n,), and the spline's values by reading, each of shape (n,).
    """
    u = np.linspace(0.0, 0.8, 801)
    shapes = {}
    for reading in ("corrected", "printed"):
        model = static_alone(Settings(middle_piece=reading).bsnn_arx())
        weights = np.zeros(model.parameters.shape)
        weights[0] = weights[3] = 1.0  # the gain behind the network, and the third weight
        model.parameters = weights
        model.freeze()
        shapes[reading] = model.run(u, np.zeros_like(u))
    return u, shapes


def _errors(runs: list[OnlineRuns], y: Array, model: str) -> tuple[Array, Array]:
    """Mean one-step RMS of each realisation, and the free-run RMS of each instance of each."""
    n = paper.N_TRAINING
    one, free = [], []
    for run, output in zip(runs, y, strict=True):
        result, target = run.runs[model], output[n:, None]
        one.append(np.mean(np.sqrt(np.mean((result.validation - target) ** 2, axis=0))))
        with np.errstate(over="ignore", invalid="ignore"):
            free.append(np.sqrt(np.mean((result.free_run - target) ** 2, axis=0)))
    return np.array(one), np.concatenate(free)
