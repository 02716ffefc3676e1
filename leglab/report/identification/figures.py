"""Figures of an identified model."""

import numpy as np
from matplotlib.figure import Figure

from leglab.identification.features import Spline, Term
from leglab.identification.spline_state_space import SplineStateSpace, StateSpace
from leglab.identification.structure import library
from leglab.identification.structure.identified import Errors, Identified
from leglab.identification.structure.residuals import ResidualTest
from leglab.report.style import BLACK, BLUE, DARK_GREY, LIGHT_GREY, VERMILION, style

_WIDTH = 6.6  # inch: readable on a page and, scrolled sideways, on a phone
_MOST_SAMPLES = 1500  # maximum samples of a curve
_MOST_PARAMETERS = 6  # maximum number of drawn parameters, one colour each
_POINTS = 800  # approximate number of points of a parameter's curve
_REST = 101  # number of points of a static curve


def free_run_figure(found: Identified, errors: Errors) -> Figure:
    """Draws measured output and free run, with the free-run error below.

    Of a long record, the stretch with the largest RMS error is drawn.
    """
    residual = errors.measured - errors.simulated
    shown = _worst(residual)
    time = np.arange(len(errors.measured))[shown] * found.period
    with style():
        figure = Figure(figsize=(_WIDTH, 4.0), layout="constrained")
        top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        top.plot(time, errors.measured[shown], color=BLACK, linewidth=0.9, label="measured")
        top.plot(
            time,
            errors.simulated[shown],
            color=VERMILION,
            linestyle="--",
            linewidth=1.0,
            label="free run",
        )
        top.set_ylabel(found.output)
        top.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
        top.set_title(f"free run, fit {errors.fit:.1f} %")
        bottom.plot(time, residual[shown], color=BLUE, linewidth=0.7)
        bottom.axhline(0, color=DARK_GREY, linewidth=0.6)
        bottom.set(ylabel="error", xlabel="time [s]")
    return figure


def free_run_caption(errors: Errors) -> str:
    """Returns the name of the recording, and which part of a long one is drawn."""
    caption, samples = f"Free run over {errors.recording}", len(errors.measured)
    if samples > _MOST_SAMPLES:
        caption += f": the {_MOST_SAMPLES:,} of {samples:,} samples with the largest error"
    return f"{caption}."


def _worst(residual: np.ndarray) -> slice:
    """Returns the stretch of `_MOST_SAMPLES` samples with the largest RMS error."""
    length = min(len(residual), _MOST_SAMPLES)
    square = np.concatenate([[0.0], np.cumsum(np.nan_to_num(residual) ** 2)])
    first = int(np.argmax(square[length:] - square[:-length])) if length else 0
    return slice(first, first + length)


def residual_figure(tests: tuple[ResidualTest, ...]) -> Figure:
    """Draws the correlations of one-step residuals with their 99 % bands."""
    with style():
        figure = Figure(figsize=(_WIDTH, 1.5 * len(tests) + 0.5), layout="constrained")
        axes = np.atleast_1d(figure.subplots(len(tests), 1, sharex=True))
        for one, test in zip(axes, tests, strict=True):
            one.axhspan(-test.band, test.band, color=LIGHT_GREY, alpha=0.5, linewidth=0)
            first = 1 if test.name == "itself" else 0  # autocorrelation at lag 0 is 1
            one.vlines(test.lags[first:], 0, test.correlation[first:], color=BLUE, linewidth=2.0)
            one.axhline(0, color=DARK_GREY, linewidth=0.6)
            past = "its past" if test.name == "itself" else f"past {test.name}"
            one.set_title(f"correlation of the one-step residual with {past}", fontsize=9)
            most = 1.2 * max(float(np.max(np.abs(test.correlation[first:]))), test.band)
            one.set_ylim(-most, most)
        axes[-1].set_xlabel("lag [samples]")
    return figure


def parameter_figure(found: Identified) -> Figure | None:
    """Draws the parameters that change most in `Identified.online`; None without samples."""
    _, trajectory = found.online
    if not len(trajectory):
        return None
    step = max(1, len(trajectory) // _POINTS)
    rows = trajectory[::step]
    time = np.arange(len(trajectory))[::step] * found.period
    moved = np.ptp(trajectory, axis=0)
    most = np.argsort(-moved, kind="stable")[:_MOST_PARAMETERS]
    names = [name for _, own, _ in library.named_parameters(found.model) for name in own]
    with style():
        figure = Figure(figsize=(_WIDTH, 3.6), layout="constrained")
        axes = figure.subplots()
        for k in sorted(most):
            axes.plot(time, rows[:, k], linewidth=0.9, label=names[k])
        figure.legend(loc="outside lower left", ncols=2, fontsize=7)
        low, high = np.quantile(rows[len(rows) // 10 :, most], (0.005, 0.995))
        slack = 0.2 * max(high - low, 1e-9)
        axes.set_ylim(low - slack, high + slack)
        axes.set_title("parameters that move most in one pass")
        axes.set(xlabel="time [s]", ylabel="scaled parameter")
    return figure


def bent_signals(found: Identified) -> list[str]:
    """Returns signals in nonlinear features; for a nonlinear state-space model, all inputs."""
    (first, *_) = features = found.chosen.fit.features
    if isinstance(first, StateSpace):
        return list(found.inputs) if first.curves else []
    return list(dict.fromkeys(f.signal for f in features if isinstance(f, Spline | Term)))


def curve_figure(found: Identified) -> Figure | None:
    """Draws the output over each of `bent_signals`, other signals at means; None if linear."""
    bent = bent_signals(found)
    if not bent:
        return None
    lags = not isinstance(found.model, SplineStateSpace)
    columns = min(3, len(bent))
    rows = -(-len(bent) // columns)
    with style():
        figure = Figure(figsize=(_WIDTH, 2.1 * rows + 0.2), layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False)
        for axes, name in zip(grid.flat, bent, strict=False):
            samples = found.problem.samples[name]
            x = np.linspace(float(samples.min()), float(samples.max()), _REST)
            axes.plot(x, found.at_rest(name, x), color=BLUE)
            axes.set_xlabel(f"{name}, all lags" if lags else name)
            axes.set_ylabel(f"{found.output}(t)" if lags else f"{found.output} at rest")
        for axes in grid.flat[len(bent) :]:
            axes.set_visible(False)
    return figure


def inner_figure(found: Identified) -> Figure | None:
    """Draws the static curves of a state-space model over z; None if it has no curves."""
    model = found.model
    if not isinstance(model, SplineStateSpace) or not model.parts().curves:
        return None
    curves = model.parts().curves
    z = np.linspace(-1.0, 1.0, _REST)
    with style():
        figure = Figure(figsize=(_WIDTH, 2.3), layout="constrained")
        for k, axes in enumerate(np.atleast_1d(figure.subplots(1, len(curves))), 1):
            spline = model.settings.structure.basis.spline(curves[k - 1].e)
            axes.plot(z, spline(z), color=BLUE)
            axes.set(xlabel=f"z{k}", title=f"curve {k}")
    return figure
