"""All five models of Table 1 on one noise realisation."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leglab.studies.replication import paper
from leglab.studies.replication.networks import LAGS, Network, train
from leglab.studies.replication.online import OnlineRuns, Settings, run_online
from leglab.studies.replication.scores import Scores, score

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Scores of all models and an exemplary validation prediction of each.

    Attributes:
        scores: By set, then by model.
        online: Predictions of the online models.
        examples: First instance of each model on the validation set, shape (n_validation,): one
            step ahead for BSNN, ARX and BSNN-ARX, free run for NNARX and NNOE.
    """

    scores: Scores
    online: OnlineRuns
    examples: dict[str, Array]


def compare(
    u: Array,
    y: Array,
    instances: int,
    seed: int,
    *,
    settings: Settings | None = None,
    progress: Callable[[str], None] | None = None,
) -> Comparison:
    """Runs `instances` instances of each model, which differ in their initial parameters.

    Args:
        u: Input of one realisation, shape (2000,).
        y: Output.
        instances: M of the paper.
        seed: Of the initial parameters.
        settings: Unpublished constants of the online models.
        progress: Called with a line before each part.
    """
    say = progress or (lambda line: None)
    say(f"BSNN, ARX, BSNN-ARX: {instances} instances")
    online = run_online(u, y, instances, seed, settings)
    scores = online.scores(y)
    examples = {model: run.validation[:, 0] for model, run in online.runs.items()}
    n = paper.N_TRAINING
    for model, output_error in (("NNARX", False), ("NNOE", True)):
        say(f"{model}: {instances} instances by Levenberg-Marquardt")
        rng = np.random.default_rng([seed, int(output_error)])
        networks = [
            train(u[:n], y[:n], output_error=output_error, rng=rng) for _ in range(instances)
        ]
        for name, part in (("training", slice(0, n)), ("validation", slice(n, None))):
            runs = _free_runs(networks, u[part], y[part])
            scores[name][model] = score(y[part], runs)
        examples[model] = runs[:, 0]
    return Comparison(scores=scores, online=online, examples=examples)


def _free_runs(networks: list[Network], u: Array, y: Array) -> Array:
    return np.column_stack([network.free_run(u, y[:LAGS]) for network in networks])
