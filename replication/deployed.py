"""The deployed identifier on the paper's plant: free run and its lower bound, re-adaptation."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from leglab.base.scale import rms
from leglab.identification import (
    Basis,
    ChangeDetection,
    Constant,
    Hammerstein,
    Lags,
    Rls,
    Signal,
    Spline,
    SplineNarx,
    SplineNarxSettings,
)
from replication import paper
from replication.paper import Array
from replication.plant import Plant, exact_free_run, simulate

U = Signal(name="u", lower=0.0, upper=1.0)
Y = Signal(name="y", lower=0.0, upper=0.9)
"""Declared ranges: the input's by its distribution, the output's by the plant's static gain."""

DEPLOYED = "deployed: 5 splines of y(t-1) (na 2, nb 3)"
DEPLOYED_MODE = "Fortescue, N_0 400, reset on change"

CHANGE_AT = 4000
AFTER = 4000
"""Samples before and after a change (20 s each)."""
WINDOW = 100
"""Samples (0.5 s) over which the one-step error is averaged."""
CHANGES = ("k_1", "b", "k_2")
FACTOR = 2.0


def settings(
    *,
    na: int = 2,
    nb: int = 3,
    splines: int = 5,
    output_error_after: int = 0,
    rls: Rls | None = None,
) -> SplineNarxSettings:
    """Returns settings with lags of y, of u from u(t) on, a constant, and splines of y(t-1).

    The plant's order (2) and its nonlinearity in y are physical knowledge; five splines are the
    study's default. The validation set had no influence on these choices.
    """
    block = []
    if splines:
        basis = Basis.uniform(-0.1, 0.9, splines, outside="linear")
        block.append(Spline(signal="y", lag=1, basis=basis))
    lags = [Lags(signal="y", first=1, count=na), Lags(signal="u", first=0, count=nb)]
    return SplineNarxSettings(
        output=Y,
        inputs=(U,),
        features=(*block, *lags, Constant()),
        rls=rls or Rls(initial_gain=1e4),
        output_error_after=output_error_after,
    )


_PAST_Y = Lags(signal="y", first=1, count=3)
_PAST_U = Lags(signal="u", first=1, count=3)
_INPUT_SPLINE = Hammerstein(
    signal="u", first=1, count=3, basis=Basis.uniform(0.3, 1.0, 8, outside="linear")
)

MODELS: dict[str, SplineNarxSettings] = {
    "ARX (na 3, nb 3)": replace(settings(), features=(_PAST_Y, _PAST_U)),
    "ARX + constant": replace(settings(), features=(_PAST_Y, _PAST_U, Constant())),
    "BSNN-ARX, spline adapted through the ARX sensitivity, constant": replace(
        settings(), features=(_PAST_Y, _INPUT_SPLINE, Constant())
    ),
    "ARX + constant + u(t) (na 3, nb 4)": settings(na=3, nb=4, splines=0),
    "with 5 splines of y(t-1) (na 3, nb 4)": settings(na=3, nb=4),
    "the same, output error after 300": settings(na=3, nb=4, output_error_after=300),
    DEPLOYED: settings(),
}


def free_runs(seeds: range) -> tuple[float, list[tuple[str, int, float, float, float, float]]]:
    """Learns in one online pass over the training part, then scores on the validation part.

    Args:
        seeds: Noise realisations.

    Returns:
        The lower bound or floor (RMS of the exact plant with linearly interpolated input) and rows
        (model, parameters, one step, free run, worst free run, free run / floor); RMS are means
        over the realisations.
    """
    n = paper.N_TRAINING
    u, y = simulate(seeds, paper.N_SAMPLES)
    floor = float(np.mean(rms(exact_free_run(u)[:, n:] - y[:, n:], axis=1)))
    rows = []
    for name, model_settings in MODELS.items():
        one, free = [], []
        for inputs, outputs in zip(u, y, strict=True):
            model = SplineNarx(model_settings)
            model.run(inputs[:n], outputs[:n])
            model.freeze()
            one.append(model.one_step(inputs[n:], outputs[n:], resume=True) - outputs[n:])
            free.append(model.free_run(inputs[n:]) - outputs[n:])
        errors = rms(free, axis=1)
        mean = float(np.mean(errors))
        row = (name, model.parameters.size, float(np.mean(rms(one, axis=1))), mean)
        rows.append((*row, float(np.max(errors)), mean / floor))
    return floor, rows


def forgetting_modes() -> dict[str, Rls]:
    """Returns all forgetting modes by name; the last is the deployed one."""
    gain = 1e4
    change = ChangeDetection(gain=gain)
    plain = Rls(initial_gain=gain)
    fortescue = Rls(initial_gain=gain, forgetting="variable", forgetting_factor=0.9, memory=400.0)
    modes = {"plain": plain}
    ways: tuple[Literal["exponential", "directional"], ...] = ("exponential", "directional")
    for factor, way in product((0.99, 0.998), ways):
        modes[f"{way} {factor}"] = replace(plain, forgetting=way, forgetting_factor=factor)
    modes |= {
        "Fortescue, N_0 400": fortescue,
        "plain, reset on change": replace(plain, change=change),
        "exponential 0.998, reset": replace(modes["exponential 0.998"], change=change),
        DEPLOYED_MODE: replace(fortescue, change=change),
    }
    return modes


@dataclass(frozen=True, kw_only=True)
class Recovery:
    """Re-adaptation of one mode after one change."""

    #: Samples until the one-step RMS over the next `WINDOW` samples is back to 1.1 times its value
    #: before the change, for each seed; `AFTER` if it never is. Shape (S,).
    samples: Array
    pooled: int  #: `samples` for the root mean square over all seeds, which fluctuates less
    before: float  #: One-step RMS over the last 2000 samples before the change, mean over the seeds
    after: float  #: One-step RMS over the last 2000 samples of the run, mean over the seeds
    #: One-step RMS over `WINDOW` samples against the sample it starts at, from 1000 samples before
    #: the change on, root mean square over the seeds.
    error: Array


def readaptation(
    seeds: range, modes: Mapping[str, Rls] | None = None
) -> dict[str, dict[str, Recovery]]:
    """Computes the recovery by mode and by changed constant: k_1, b and k_2, each doubled.

    Args:
        seeds: Noise realisations.
        modes: Forgetting modes by name; all of `forgetting_modes` if None.
    """
    plants = [Plant().changed(name, FACTOR) for name in CHANGES for _ in seeds]
    u, y = simulate([*seeds] * len(CHANGES), CHANGE_AT + AFTER, after=plants, change_at=CHANGE_AT)
    parts = {name: slice(i * len(seeds), (i + 1) * len(seeds)) for i, name in enumerate(CHANGES)}
    modes = forgetting_modes() if modes is None else modes
    return {
        mode: {name: _recovery(u[part], y[part], rls) for name, part in parts.items()}
        for mode, rls in modes.items()
    }


def _recovery(u: Array, y: Array, rls: Rls) -> Recovery:
    model = SplineNarx(settings(na=3, nb=4, rls=rls), joints=len(u))
    squared = (model.run(u.T, y.T) - y.T).T ** 2
    before = np.sqrt(np.mean(squared[:, CHANGE_AT - 2000 : CHANGE_AT], axis=1))
    total = np.cumsum(np.pad(squared, ((0, 0), (1, 0))), axis=1)
    windowed = (total[:, WINDOW:] - total[:, :-WINDOW]) / WINDOW
    back = np.sqrt(np.abs(windowed[:, CHANGE_AT:])) <= 1.1 * before[:, None]
    together = np.mean(windowed, axis=0)
    level = 1.21 * np.mean(before**2)
    return Recovery(
        samples=np.array([_first(seed) for seed in back]),
        pooled=_first(together[CHANGE_AT:] <= level),
        before=float(np.mean(before)),
        after=float(np.mean(np.sqrt(np.mean(squared[:, -2000:], axis=1)))),
        error=np.sqrt(np.abs(together[CHANGE_AT - 1000 :])),
    )


def _first(met: NDArray[np.bool_]) -> int:
    """Returns the first sample at which a condition is met, `AFTER` if never."""
    return int(np.argmax(met)) if met.any() else AFTER
