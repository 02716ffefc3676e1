"""Two measured data sets, the Silverbox circuit and a hydraulic actuator, and models of them.

Every model learns in one online pass over the training part and then runs free. The structures of
the deployed identifier were chosen on the training part alone, from a grid that a person made; what
`leglab identify` chooses by itself is in `identify.py`. The recordings are other people's:
`shared_data` says where they are looked for.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from scipy.io import loadmat

from benchmarks.measured import shared_data
from leglab.identification import (
    Basis,
    Constant,
    Identifier,
    Lags,
    Rls,
    Signal,
    Spline,
    SplineNarxSettings,
)
from replication.paper import Array


@dataclass(frozen=True, kw_only=True)
class Dataset:
    """A recording, its published split, and what others reached."""

    name: str  #: Of the benchmark
    u: Array  #: Input, shape (n,)
    y: Array  #: Output, shape (n,)
    train: slice  #: Samples of the online pass
    tests: dict[str, slice]  #: Samples of each free run, by name
    given: int  #: Outputs at the head of a test that are given and not scored
    unit: tuple[str, float]  #: Unit of the table, and the factor that turns units of y into it
    #: Declared half ranges of u and y around zero, known from the training part.
    ranges: tuple[float, float]
    #: Free-run RMSE of others in `unit`, by model, in the order of `tests`.
    published: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


def silverbox() -> Dataset:
    """The Silverbox (Wigren and Schoukens 2013) with the splits of nonlinear_benchmarks 1.0.1.

    Published rows: Champneys et al. 2024, arXiv 2405.10779.
    """
    table = np.loadtxt(
        shared_data("silverbox/SNLS80mV.csv"), delimiter=",", skiprows=1, usecols=(0, 1)
    )
    return Dataset(
        name="Silverbox",
        u=table[:, 0].copy(),
        y=table[:, 1].copy(),
        train=slice(40650, 105712),
        tests={
            "multisine": slice(105712, 127400),
            "arrow, no extrapolation": slice(100, 32100),
            "arrow": slice(100, 40575),
        },
        given=50,
        unit=("mV", 1e3),
        ranges=(0.15, 0.26),
        published={
            "ARX": (6.95, 6.59, 14.2),
            "polynomial NARX": (0.64, 0.57, 2.25),
            "GP-NARX": (0.30, 0.26, 0.60),
            "GRU": (1.49, 0.95, 2.80),
            "SUBNET": (0.36, 0.32, 1.4),
        },
    )


def actuator() -> Dataset:
    """The hydraulic crane actuator (Gunnarsson and Krus 1990): valve to oil pressure.

    Published rows: Sjoberg et al. 1995, as the project's notes on the data remember them.
    """
    table = loadmat(shared_data("hydraulic_actuator/actuator.mat"))
    return Dataset(
        name="hydraulic actuator",
        u=table["u"].ravel().astype(float),
        y=table["p"].ravel().astype(float),
        train=slice(0, 512),
        tests={"second half": slice(512, 1024)},
        given=10,
        unit=("", 1.0),
        ranges=(1.5, 4.0),
        published={
            "linear ARX(2, 8)": (0.990,),
            "sigmoid network": (0.47,),
            "wavelet network": (0.58,),
        },
    )


def spline_narx(
    data: Dataset,
    *,
    na: int,
    nb: int,
    nk: int,
    splines: int = 0,
    output_lags: tuple[int, ...] = (),
    input_lags: tuple[int, ...] = (),
    reach: float = 1.0,
    outside: Literal["clamp", "linear", "quadratic"] = "linear",
    initial_gain: float = 1e4,
    output_error_after: int = 0,
) -> SplineNarxSettings:
    """Lags (na, nb, nk), a constant, and a block of splines for some lags of y and of u.

    The splines lie over the part `reach` of the declared range. The simulation error is minimised
    after so many samples; never where that is 0.
    """
    u_range, y_range = data.ranges
    blocks = [("y", lag, reach * y_range) for lag in output_lags]
    blocks += [("u", lag, reach * u_range) for lag in input_lags]
    features = [
        Spline(signal=name, lag=lag, basis=Basis.uniform(-end, end, splines, outside=outside))
        for name, lag, end in blocks
    ]
    lags = [Lags(signal="y", first=1, count=na), Lags(signal="u", first=nk, count=nb)]
    return SplineNarxSettings(
        output=Signal(name="y", lower=-y_range, upper=y_range),
        inputs=(Signal(name="u", lower=-u_range, upper=u_range),),
        features=(*features, *lags, Constant()),
        rls=Rls(initial_gain=initial_gain),
        output_error_after=output_error_after,
    )


def train(model: Identifier, data: Dataset) -> Identifier:
    """Learns the training part in one online pass and freezes."""
    model.run(data.u[data.train], data.y[data.train])
    model.freeze()
    return model


def free_run_errors(model: Identifier, data: Dataset) -> dict[str, float]:
    """RMSE of the free run on each test, in the unit of the table."""
    return {
        name: free_run_error(model, data.u[part], data.y[part], data.given) * data.unit[1]
        for name, part in data.tests.items()
    }


def free_run_error(model: Identifier, u: Array, y: Array, given: int) -> float:
    """RMSE of a free run that is given its first outputs; infinite where it diverges."""
    with np.errstate(over="ignore", invalid="ignore"):
        residual = model.free_run(u, y[:given])[given:] - y[given:]
        mean_square = np.mean(residual**2)
    return float(np.sqrt(mean_square)) if np.isfinite(mean_square) else float("inf")


SILVERBOX: dict[str, Any] = {
    "na": 4,
    "nb": 5,
    "nk": 0,
    "splines": 10,
    "output_lags": (1, 2),
    "reach": 0.85,
    "outside": "quadratic",
    "output_error_after": 2000,
}

ACTUATOR: dict[str, Any] = {
    "na": 6,
    "nb": 6,
    "nk": 1,
    "splines": 12,
    "input_lags": (1, 2, 3),
    "initial_gain": 30.0,
}
