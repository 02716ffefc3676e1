"""Scores over instances and the tables that show them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leglab.studies.replication import paper

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Score:
    """Errors of one model on one set.

    Attributes:
        rms: RMS of the residual for each instance, in units of y, shape (M,).
        r2: 1 - mean squared residual / variance of y, shape (M,).
    """

    rms: Array
    r2: Array


def score(y: Array, predictions: Array) -> Score:
    """Scores predictions of shape (n,) or (n, M) of the output y, shape (n,)."""
    residuals = y[:, None] - predictions.reshape(len(y), -1)
    mean_square = np.mean(residuals**2, axis=0)
    return Score(rms=np.sqrt(mean_square), r2=1.0 - mean_square / np.var(y))


Scores = dict[str, dict[str, Score]]
"""By set ("training", "validation"), then by model."""


def table_1(scores: Scores) -> str:
    """Table 1 as Markdown: each measured value with the printed one in brackets behind it."""
    rows = []
    for name in paper.SETS:
        for model in paper.MODELS:
            if model not in scores[name]:
                continue
            got, printed = scores[name][model], paper.TABLE_1[name][model]
            off = f"{100.0 * (float(np.mean(got.rms)) / printed.rms_mean - 1.0):+.0f} %"
            cells = (
                (np.mean(got.rms), printed.rms_mean, ".4f"),
                (np.var(got.rms), printed.rms_var, ".1e"),
                (np.mean(got.r2), printed.r2_mean, ".3f"),
                (np.var(got.r2), printed.r2_var, ".1e"),
            )
            texts = [f"{value:{form}} ({_printed(ref, form)})" for value, ref, form in cells]
            rows.append((name, model, texts[0], off, *texts[1:]))
    head = ("set", "model", "RMS mean (paper)", "off by", "RMS var (paper)")
    return markdown((*head, "R^2 mean (paper)", "R^2 var (paper)"), rows)


def worst_deviation(scores: Scores) -> float:
    """Largest relative deviation of a validation mean of RMS or R^2 from the printed one."""
    worst = 0.0
    for model, got in scores["validation"].items():
        printed = paper.TABLE_1["validation"][model]
        worst = max(worst, abs(float(np.mean(got.rms)) / printed.rms_mean - 1.0))
        if printed.r2_mean is not None:
            worst = max(worst, abs(float(np.mean(got.r2)) / printed.r2_mean - 1.0))
    return worst


def markdown(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table; floats are shown with four significant digits."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(_cell(cell) for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def _cell(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _printed(value: float | None, form: str) -> str:
    return "NS" if value is None else f"{value:{form}}"
