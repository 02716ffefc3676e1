"""Figures of an identified model."""

import numpy as np
from matplotlib.figure import Figure

from leglab.identification.structure.identified import Errors, Identified
from leglab.identification.structure.residuals import ResidualTest
from leglab.report.style import BLACK, BLUE, DARK_GREY, LIGHT_GREY, VERMILION, style

_WIDTH = 6.6  # inch: readable on a page and, scrolled sideways, on a phone
_MOST_SAMPLES = 1500  # of a curve; longer records show their beginning
_MOST_PARAMETERS = 12
_POINTS = 800  # of a parameter's curve


def free_run_figure(found: Identified, errors: Errors) -> Figure:
    """Measured output and free run, and the error below."""
    shown = slice(0, min(len(errors.measured), _MOST_SAMPLES))
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
        top.set_title(f"{errors.recording}: free run, fit {errors.fit:.1f} %")
        residual = errors.measured - errors.simulated
        bottom.plot(time, residual[shown], color=BLUE, linewidth=0.7)
        bottom.axhline(0, color=DARK_GREY, linewidth=0.6)
        bottom.set(ylabel="error", xlabel="time [s]")
    return figure


def residual_figure(tests: tuple[ResidualTest, ...]) -> Figure:
    """Correlations with their bands."""
    with style():
        figure = Figure(figsize=(_WIDTH, 1.5 * len(tests) + 0.5), layout="constrained")
        axes = np.atleast_1d(figure.subplots(len(tests), 1, sharex=True))
        for one, test in zip(axes, tests, strict=True):
            one.axhspan(-test.band, test.band, color=LIGHT_GREY, alpha=0.5, linewidth=0)
            one.vlines(test.lags, 0, test.correlation, color=BLUE, linewidth=2.0)
            one.axhline(0, color=DARK_GREY, linewidth=0.6)
            one.set_title(f"correlation of the one-step residual with {_with(test)}", fontsize=9)
            counted = test.correlation[1:] if test.name == "itself" else test.correlation
            most = 1.2 * max(float(np.max(np.abs(counted))), test.band)
            one.set_ylim(-most, most)
        axes[-1].set_xlabel("lag [samples]")
    return figure


def _with(test: ResidualTest) -> str:
    return "itself (lag 0 is 1)" if test.name == "itself" else f"past {test.name}"


def parameter_figure(found: Identified) -> Figure | None:
    """Parameters of one pass from nothing over the first record; None where there are none."""
    _, trajectory = found.online
    if not len(trajectory):
        return None
    step = max(1, len(trajectory) // _POINTS)
    rows = trajectory[::step]
    time = np.arange(len(trajectory))[::step] * found.period
    largest = np.argsort(-np.abs(trajectory[-1]), kind="stable")[:_MOST_PARAMETERS]
    with style():
        figure = Figure(figsize=(_WIDTH, 3.0), layout="constrained")
        axes = figure.subplots()
        for k in sorted(largest):
            axes.plot(time, rows[:, k], linewidth=0.9)
        low, high = np.quantile(rows[len(rows) // 10 :, largest], (0.005, 0.995))
        slack = 0.2 * max(high - low, 1e-9)
        axes.set_ylim(low - slack, high + slack)
        axes.set_title("parameters while learning in one pass from nothing, the largest")
        axes.set(xlabel="time [s]", ylabel="scaled parameter")
    return figure


def curve_figure(found: Identified) -> Figure | None:
    """Static curves of the model, over the range of their data; None without any."""
    from leglab.identification.features import Spline

    features = found.model.settings.features
    at = [k for k, feature in enumerate(features) if isinstance(feature, Spline)]
    if not at:
        return None
    columns = min(3, len(at))
    rows = -(-len(at) // columns)
    with style():
        figure = Figure(figsize=(_WIDTH, 2.1 * rows + 0.2), layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False)
        for axes, k in zip(grid.flat, at, strict=False):
            feature = features[k]
            assert isinstance(feature, Spline)
            x = np.linspace(feature.basis.knots[0], feature.basis.knots[-1], 200)
            axes.plot(x, found.model.static_spline(k)(x), color=BLUE)
            axes.set_xlabel(
                f"{feature.signal}(t-{feature.lag})" if feature.lag else f"{feature.signal}(t)"
            )
        for axes in grid.flat[len(at) :]:
            axes.set_visible(False)
        figure.suptitle(f"share of {found.output} of each curve", fontsize=10, x=0.01, ha="left")
    return figure
