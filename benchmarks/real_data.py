"""Every model of this project on the measured benchmarks, next to the published rows.

python -m benchmarks real_data
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks import data_sets, results
from benchmarks.data_sets import ACTUATOR, SILVERBOX, Dataset
from leglab.base.scale import rms
from leglab.identification import (
    Basis,
    BsnnArx,
    Constant,
    Hammerstein,
    Identifier,
    Lags,
    SplineNarx,
)
from leglab.studies.replication.networks import LAGS
from leglab.studies.replication.networks import train as train_network
from leglab.studies.replication.online import OnlineSettings

DIVERGED = 1e3  # in the unit of the table


class Scaled:
    """The paper's model has no scaling of its own: its weights saturate at 1."""

    def __init__(self, data: Dataset, initial_gain: float) -> None:
        base = OnlineSettings(initial_gain=initial_gain).bsnn_arx()
        basis = Basis.uniform(-1.0, 1.0, 8)
        self.model = BsnnArx(replace(base, network=replace(base.network, basis=(basis,))))
        self.model.randomise(np.random.default_rng(0))
        u, y = data.u / data.ranges[0], data.y / data.ranges[1]
        unit = (data.unit[0], data.unit[1] * data.ranges[1])
        self.data = replace(data, u=u, y=y, unit=unit)


def online_models(data: Dataset, deployed: dict) -> dict[str, tuple[Identifier, Dataset]]:
    """Identifiers by name with the data they learn from, the deployed one last."""
    linear = {"na": 3, "nb": 3, "nk": 1}
    base = data_sets.spline_narx(data, **linear)
    spline = Hammerstein(
        signal="u",
        first=1,
        count=3,
        basis=Basis.uniform(-data.ranges[0], data.ranges[0], 8, outside="linear"),
    )
    sensitivity = replace(base, features=(Lags(signal="y", count=3), spline, Constant()))
    over = data_sets.spline_narx(data, **linear, splines=8, input_lags=(1, 2, 3))
    models = {}
    for gain in ("5.6", "1e4"):
        scaled = Scaled(data, float(gain))
        models[f"BSNN-ARX (paper), F(0) = {gain} I"] = (scaled.model, scaled.data)
    models["ARX (3, 3) + constant"] = (SplineNarx(base), data)
    models["BSNN-ARX, spline through the ARX sensitivity"] = (SplineNarx(sensitivity), data)
    models["Hammerstein, over-parameterised (3, 3)"] = (SplineNarx(over), data)
    same = {**deployed, "output_error_after": 0}
    without = data_sets.spline_narx(data, **{**same, "input_lags": (), "output_lags": ()})
    models["deployed, without its splines"] = (SplineNarx(without), data)
    if deployed.get("output_error_after"):
        equation = data_sets.spline_narx(data, **same)
        models["deployed, equation error only"] = (SplineNarx(equation), data)
    models["deployed"] = (SplineNarx(data_sets.spline_narx(data, **deployed)), data)
    return models


def compared(data: Dataset, deployed: dict, *, networks: bool) -> dict[str, Any]:
    """Free-run errors of every model, in the order of the tests."""
    rows = []
    for name, (model, its_data) in online_models(data, deployed).items():
        data_sets.train(model, its_data)
        errors = data_sets.free_run_errors(model, its_data)
        rows.append((name, len(model.parameters), *errors.values()))
    if networks:
        rows += network_rows(data)
    rows += [(f"published: {name}", None, *row) for name, row in data.published.items()]
    unit = f", {data.unit[0]}" if data.unit[0] else ""
    return {"tests": [test + unit for test in data.tests], "rows": rows}


def network_rows(data: Dataset) -> list[tuple]:
    rows = []
    for name, output_error in (("NNARX (batch)", False), ("NNOE (batch)", True)):
        rng = np.random.default_rng(0)
        u, y = data.u[data.train], data.y[data.train]
        network = train_network(u, y, output_error=output_error, rng=rng)
        errors = []
        for part in data.tests.values():
            run = network.free_run(data.u[part], data.y[part][:LAGS])
            residual = (run - data.y[part])[data.given :]
            errors.append(float(rms(residual)) * data.unit[1])
        rows.append((name, len(network.weights), *errors))
    return rows


def figures(data: Dataset, deployed: dict, folder: Path) -> None:
    """Free run of the deployed identifier on each test: output, and residual below it."""
    model = data_sets.train(SplineNarx(data_sets.spline_narx(data, **deployed)), data)
    unit, factor = data.unit
    for test, part in data.tests.items():
        if "no extrapolation" in test:  # the head of the arrow
            continue
        y = data.y[part]
        run = model.free_run(data.u[part], y[: data.given])
        figure = Figure(figsize=(7.0, 4.6), layout="constrained")
        top, bottom = figure.subplots(2, 1, sharex=True)
        top.plot(y * factor, "k", linewidth=0.8, label="measured")
        if len(y) < 2000:  # they could not be told apart on longer ones
            top.plot(run * factor, "r--", linewidth=1.0, label="free run")
            top.legend(loc="lower center", ncols=2)
        shown = f" [{unit}]" if unit else ""
        top.set(title=f"{data.name}, {test}: one online pass, then free run")
        top.set_ylabel(f"measured output{shown}")
        bottom.plot((y - run) * factor, "r", linewidth=0.6)
        bottom.set(ylabel=f"residual{shown}", xlabel="sample")
        stem = f"{data.name} {test}".lower().replace(" ", "_")
        figure.savefig(folder / f"{stem}.png", dpi=110)


def measure(options: argparse.Namespace) -> dict[str, Any] | None:
    """Tables by data set; None where figures were wanted."""
    cases = (
        (data_sets.silverbox(), SILVERBOX),
        (data_sets.actuator(), ACTUATOR),
    )
    found = {}
    for data, deployed in cases:
        if options.figures:
            options.figures.mkdir(parents=True, exist_ok=True)
            figures(data, deployed, options.figures)
        else:
            found[data.name] = compared(data, deployed, networks=not options.no_networks)
    return found or None


def tables(found: dict[str, Any]) -> str:
    """A table a data set."""
    grids = []
    for name, part in found.items():
        rows = [
            (model, "" if size is None else str(size), *map(shown, errors))
            for model, size, *errors in part["rows"]
        ]
        grids.append(results.table((name, "parameters", *part["tests"]), rows))
    return "\n".join(grids)


def shown(error: float | None) -> str:
    """A free run's error; None where it overflows."""
    return f"{error:.3g}" if error is not None and error < DIVERGED else "diverges"


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--no-networks", action="store_true", help="leave out NNARX and NNOE")
    parser.add_argument("--figures", type=Path, help="folder for figures of the free runs")
