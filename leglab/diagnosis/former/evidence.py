"""Probabilities on rough machines, whose errors are worth few independent numbers."""

from collections.abc import Sequence

import numpy as np

from leglab.diagnosis.thresholds import DEFAULT


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


def within_library(explained: float, odds: float) -> float:
    """Probability that the cause is among the effects that were tried, by the share they explain.

    The right cause explains nearly all that a fault opens, a wrong one that imitates it seldom more
    than half: the likelihood ratio is taken for the square of the explained to the unexplained
    share.

    Args:
        explained: Share of the gap, from 0 to 1: where the model's own error is known, of what is
            beyond that; else of the error's variance.
        odds: That the cause is in the library, where one half is explained: fitted to judged cases
            of the self-test on rough specimens (docs/diagnosis.md).
    """
    share = min(max(explained, 0.0), 1.0)
    return odds * share**2 / (odds * share**2 + (1.0 - share) ** 2)


def beyond_specimens(
    departure: float, spread: float = DEFAULT.specimen_spread, reach: float = DEFAULT.fault_range
) -> float:
    """Probability that a departure from the model is a fault and not this specimen's own.

    Strengths of healthy machines scatter normally about their model, by some share of what is
    barely noticeable; those of faults lie anywhere up to several times that. Bayes' rule with even
    odds: what shows at all is one or the other.

    Args:
        departure: In smallest trials.
        spread: Standard deviation of healthy ones, in smallest trials.
        reach: Of faults, likewise.
    """
    own = np.exp(-0.5 * (departure / spread) ** 2) / (spread * np.sqrt(2.0 * np.pi))
    fault = 1.0 / reach
    return float(fault / (fault + 2.0 * own))
