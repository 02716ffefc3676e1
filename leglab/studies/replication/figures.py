"""Figures 7 to 14, 16 and 17 of the paper, and those of the findings beside them."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from leglab.studies.replication.scores import Score

Array = NDArray[np.float64]

SAMPLING_TIME = 0.005
DPI = 110


def _figure(rows: int = 1, height: float = 2.4, *, share: bool = True) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(7.0, height * rows + 0.6), layout="constrained")
    axes = figure.subplots(rows, 1, squeeze=False, sharex=share)
    return figure, list(axes[:, 0])


def _save(figure: Figure, path: Path) -> Path:
    figure.savefig(path, dpi=DPI)
    return path


def adaptation_of_weights(path: Path, weights: Array, y: Array, prediction: Array) -> Path:
    """Fig. 7: weights of the BSNN, (n, neurons), and its prediction while it adapts."""
    figure, (top, bottom) = _figure(2)
    time = np.arange(len(y)) * SAMPLING_TIME
    top.plot(time, weights)
    top.axvline(300 * SAMPLING_TIME, color="0.5", linestyle=":")
    top.set(ylabel="weight", title="Fig. 7: adaptation of the BSNN (dotted: 300 samples)")
    bottom.plot(time, y, "k", label="process")
    bottom.plot(time, prediction, "r--", label="BSNN", linewidth=1.0)
    bottom.set(xlabel="time [s]", ylabel="y")
    bottom.legend(loc="lower right", ncols=2)
    return _save(figure, path)


def validation(path: Path, title: str, y: Array, predictions: Mapping[str, Array]) -> Path:
    """Figs. 8, 9, 11, 16, 17: prediction and residual on the validation set."""
    figure, (top, bottom) = _figure(2)
    time = np.arange(len(y)) * SAMPLING_TIME
    top.plot(time, y, "k", label="process")
    for style, (label, prediction) in zip(("r--", "b:"), predictions.items(), strict=False):
        top.plot(time, prediction, style, label=label)
        bottom.plot(time, y - prediction, style[0], label=label, linewidth=1.0)
    top.set(ylabel="y", title=title)
    top.legend(loc="best", ncols=3)
    bottom.set(xlabel="time [s]", ylabel="residual")
    return _save(figure, path)


def adaptation_of_theta(path: Path, arx: Array, bsnn_arx: Array) -> Path:
    """Fig. 10: parameters of the ARX model alone (above) and behind the BSNN, each (n, 6)."""
    figure, axes = _figure(2)
    labels = [*(f"a_{i}" for i in (1, 2, 3)), *(f"b_{i}" for i in (1, 2, 3))]
    for axis, theta, name in zip(axes, (arx, bsnn_arx), ("ARX", "BSNN-ARX"), strict=True):
        axis.plot(np.arange(len(theta)) * SAMPLING_TIME, theta, label=labels)
        axis.axvline(1500 * SAMPLING_TIME, color="0.5", linestyle=":")
        axis.set_ylabel(f"theta, {name}")
    axes[0].set_title("Fig. 10: adaptation of the ARX parameters (dotted: 1500 samples)")
    axes[0].legend(ncols=6, fontsize="small")
    axes[1].set_xlabel("time [s]")
    return _save(figure, path)


def instances(path: Path, rms: Array) -> Path:
    """Fig. 12: validation RMS of each BSNN-ARX instance and their mean."""
    figure, (axis,) = _figure()
    axis.plot(np.arange(1, len(rms) + 1), rms, "k.")
    axis.axhline(float(np.mean(rms)), color="b")
    axis.set(xlabel="instance", ylabel="RMS", title="Fig. 12: BSNN-ARX, validation RMS")
    return _save(figure, path)


def boxes(path: Path, title: str, scores: Mapping[str, Score], quantity: str) -> Path:
    """Figs. 13, 14: median, quartiles, adjacent values and outliers over the instances.

    Outliers of the networks that would flatten the boxes are drawn at the edge.
    """
    figure, (axis,) = _figure(height=3.2)
    values = [getattr(s, quantity) for s in scores.values()]
    low, high = _view(values)
    clipped = [np.clip(v, low, high) for v in values]
    axis.boxplot(clipped, tick_labels=list(scores), flierprops={"marker": "+"})
    beyond = sum(int(np.sum((v < low) | (v > high))) for v in values)
    axis.set(ylabel=quantity.upper().replace("R2", "R^2"), title=title)
    if beyond:
        axis.set_xlabel(f"{beyond} outliers lie beyond the edge")
    return _save(figure, path)


def _view(values: Sequence[Array]) -> tuple[float, float]:
    """Range of all boxes and whiskers, a little widened."""
    ends = []
    for value in values:
        first, third = np.percentile(value, (25, 75))
        reach = 3.0 * (third - first)
        ends += [max(np.min(value), first - reach), min(np.max(value), third + reach)]
    margin = 0.06 * (max(ends) - min(ends))
    return float(min(ends) - margin), float(max(ends) + margin)


def lines(
    path: Path,
    title: str,
    x: tuple[str, Sequence[float]],
    y_label: str,
    curves: Mapping[str, Sequence[float]],
    *,
    log_x: bool = True,
    log_y: bool = False,
) -> Path:
    """A line for each named curve over common points x = (label, values)."""
    figure, (axis,) = _figure(height=3.2)
    for label, values in curves.items():
        axis.plot(x[1], values, "o-", label=label, markersize=4)
    axis.set(xlabel=x[0], ylabel=y_label, title=title)
    if log_x:
        axis.set_xscale("log")
    if log_y:
        axis.set_yscale("log")
    axis.grid(alpha=0.3)
    axis.legend()
    return _save(figure, path)


def traces(
    path: Path,
    title: str,
    x: tuple[str, ArrayLike],
    y_label: str,
    curves: Mapping[str, Array],
    *,
    log_y: bool = True,
) -> Path:
    """Dense curves over x = (label, values)."""
    figure, (axis,) = _figure(height=3.2)
    for label, values in curves.items():
        axis.plot(x[1], values, label=label, linewidth=1.0)
    axis.set(xlabel=x[0], ylabel=y_label, title=title, yscale="log" if log_y else "linear")
    axis.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=3, fontsize="small")
    return _save(figure, path)


def cost(path: Path, title: str, x: tuple[str, Sequence[float]], measured: Sequence[float]) -> Path:
    """Time of an update against a size, both from zero."""
    figure, (axis,) = _figure(height=2.8)
    axis.plot(x[1], measured, "o-", markersize=4)
    axis.set(xlabel=x[0], ylabel="ns a sample", title=title)
    axis.set_xlim(left=0)
    axis.set_ylim(0, 1.1 * max(measured))  # flat data leave themselves no room above
    axis.grid(alpha=0.3)
    return _save(figure, path)
