"""Structures for the measured benchmarks, chosen on their training parts alone."""

from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from leglab.identification import SplineNarx
from leglab.studies.replication.real_data import Dataset, free_run_error, spline_narx


class Candidate(NamedTuple):
    """A structure as `spline_narx` takes it, and its error in the unit of the table."""

    error: float
    structure: dict[str, Any]


def select(
    data: Dataset, grid: Sequence[dict[str, Any]], splits: Sequence[tuple[slice, slice]]
) -> list[Candidate]:
    """Ranks structures by their mean free-run error over splits of the training part.

    Args:
        data: Only its training part is looked at.
        grid: Arguments of `spline_narx`, one candidate each.
        splits: (learn online, run free) as parts of the training part.

    Returns:
        Candidates, best first.
    """
    u, y = data.u[data.train], data.y[data.train]
    ranked = []
    for structure in grid:
        settings, errors = spline_narx(data, **structure), []
        for learned, held_out in splits:
            model = SplineNarx(settings)
            model.run(u[learned], y[learned])
            errors.append(free_run_error(model, u[held_out], y[held_out], data.given))
        ranked.append(Candidate(float(np.mean(errors)) * data.unit[1], structure))
    return sorted(ranked, key=lambda candidate: candidate.error)


def _product(**choices: Sequence[Any]) -> Iterator[dict[str, Any]]:
    for values in product(*choices.values()):
        yield dict(zip(choices, values, strict=True))


def actuator_grid() -> list[dict[str, Any]]:
    """Orders, blocks of u and of y, their number of splines, and F(0) as regularisation."""
    inputs = ((), (1,), (1, 2), (1, 2, 3), (0, 1), (0, 1, 2))
    return [
        {**orders, **rest}
        for orders, rest in product(
            ({"nb": nb, "nk": nk} for nb, nk in ((2, 1), (3, 1), (4, 1), (6, 1), (4, 0))),
            _product(
                na=(2, 3, 4, 5, 6, 8),
                splines=(5, 8, 12, 16),
                input_lags=inputs,
                output_lags=((), (1,)),
                initial_gain=(10.0, 30.0, 100.0, 1e4),
            ),
        )
    ]


ACTUATOR_SPLITS = (
    (slice(0, 340), slice(340, 512)),
    (slice(172, 512), slice(0, 172)),
    (slice(0, 256), slice(256, 512)),
    (slice(256, 512), slice(0, 256)),
)
"""A third or half of the first 512 samples held out, at either end."""


def silverbox_grid() -> list[dict[str, Any]]:
    """Orders, splines of y over the range of the training output (+-2 %), start of stage 2."""
    return [
        {**rest, "nb": rest["na"] + 1}
        for rest in _product(
            na=(2, 3, 4, 5, 6),
            nk=(0,),
            splines=(5, 6, 7, 8, 9, 10, 12, 14),
            output_lags=((1,), (1, 2)),
            reach=(0.85,),
            outside=("quadratic",),
            output_error_after=(1000, 2000, 5000),
        )
    ]


SILVERBOX_SPLITS = ((slice(0, 52050), slice(52050, 65062)),)
"""The last fifth of the training part held out."""
