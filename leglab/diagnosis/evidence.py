"""What the errors of a rough machine say between explanations: they are few numbers."""

from collections.abc import Sequence

import numpy as np


def posterior(
    costs: Sequence[float], numbers: float, parameters: Sequence[int] | None = None
) -> np.ndarray:
    """Probability of each explanation among some, whose model errors have an unknown size.

    With the size of a Gaussian error replaced by its estimate, n numbers of mean square c have the
    likelihood c^(-n/2) (concentrated likelihood; Seber and Wild 1989, Sec. 2.2), and k fitted
    parameters cost a factor n^(-k/2) (Schwarz 1978). Errors of a model go together in time and
    across channels, so that they are few numbers.

    Args:
        costs: Mean square of each explanation.
        numbers: How many independent numbers the errors are worth.
        parameters: How many each explanation has; None for as many.
    """
    log = -0.5 * numbers * np.log(np.maximum(np.asarray(costs, dtype=float), 1e-300))
    if parameters is not None:
        log -= 0.5 * np.log(max(numbers, 1.0)) * np.asarray(parameters, dtype=float)
    weights = np.exp(log - log.max())
    return weights / weights.sum()
