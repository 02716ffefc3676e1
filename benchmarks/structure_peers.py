"""Peers of `leglab identify`: the paper's model, and other libraries with usual settings.

Each gives the RMS of the free run on every test, in the unit of the output; infinite where it
diverges. A peer that takes a single input gives nothing for several. No peer chooses its lags,
degree or size: the constants below are a person's choice. PyTorch is in no dependency group.
"""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from leglab.base.recording import Recording
from leglab.identification import Basis, BsnnArx
from replication.online import OnlineSettings

LAGS, DEGREE = 4, 2
SAMPLES = 5000  # of FROLS, whose time grows with samples and candidates
# GRU: units of its one layer, samples of a training window, windows of a step, steps, step size.
UNITS, WINDOW, BATCH, STEPS, RATE = 16, 100, 32, 1500, 5e-3
GIVEN = 50  # samples of the test from which a state is found

Errors = dict[str, float]


class Scaled:
    """Signals with mean zero and deviation one over the training record."""

    def __init__(self, train: Recording) -> None:
        self.names = [c for c in train.columns if c.startswith("u")]
        columns = np.column_stack([train["y"], *(train[c] for c in self.names)])
        self.centre, self.scale = columns.mean(axis=0), columns.std(axis=0)

    def signals(self, one: Recording) -> tuple[np.ndarray, np.ndarray]:
        """Inputs (N, m) and output (N,)."""
        u = np.column_stack([one[c] for c in self.names])
        return (u - self.centre[1:]) / self.scale[1:], (one["y"] - self.centre[0]) / self.scale[0]

    def error(self, run: np.ndarray, y: np.ndarray) -> float:
        """RMS in the unit of the output."""
        error = float(np.sqrt(np.mean((run - y) ** 2))) * self.scale[0]
        return error if np.isfinite(error) else float("inf")


def sysidentpy(train: Recording, tests: dict[str, Recording]) -> Errors:
    """Polynomials of lags, chosen by FROLS with an information criterion."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS

    scaled = Scaled(train)
    u, y = (part[:SAMPLES] for part in scaled.signals(train))
    lags = list(range(1, LAGS + 1))
    xlag: Any = lags if len(scaled.names) == 1 else [lags] * len(scaled.names)
    basis = Polynomial(degree=DEGREE)
    model = FROLS(
        order_selection=True, n_info_values=20, ylag=LAGS, xlag=xlag, basis_function=basis
    )
    out = {}
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model.fit(X=u, y=y[:, None])
        for name, test in tests.items():
            u_test, y_test = scaled.signals(test)
            run = model.predict(X=u_test, y=y_test[: model.max_lag, None])[:, 0]
            out[name] = scaled.error(run[model.max_lag :], y_test[model.max_lag :])
    return out


def padasip_arx(train: Recording, tests: dict[str, Recording]) -> Errors:
    """ARX of recursive least squares, one pass; its free run."""
    from padasip.filters import FilterRLS

    scaled = Scaled(train)

    def past(u: np.ndarray, y: np.ndarray, t: int) -> np.ndarray:
        return np.concatenate([y[t - LAGS : t], u[t - LAGS + 1 : t + 1].ravel()])

    u, y = scaled.signals(train)
    learned = FilterRLS(n=LAGS * (1 + u.shape[1]), mu=1.0, eps=1e-4, w="zeros")
    for t in range(LAGS, len(y)):
        learned.adapt(y[t], past(u, y, t))
    out = {}
    with np.errstate(all="ignore"):
        for name, test in tests.items():
            u, y = scaled.signals(test)
            run = y.copy()
            for t in range(LAGS, len(y)):
                run[t] = learned.w @ past(u, run, t)
            out[name] = scaled.error(run[LAGS:], y[LAGS:])
    return out


def gru(train: Recording, tests: dict[str, Recording]) -> Errors:
    """A small GRU of PyTorch, trained by Adam on windows whose first samples find the state."""
    import torch

    torch.manual_seed(0)
    scaled = Scaled(train)

    class Network(torch.nn.Module):
        def __init__(self, inputs: int) -> None:
            super().__init__()
            self.cell = torch.nn.GRU(inputs, UNITS, batch_first=True)
            self.out = torch.nn.Linear(UNITS, 1)

        def forward(self, u: Any) -> Any:
            return self.out(self.cell(u)[0])[..., 0]

    u, y = (torch.tensor(part, dtype=torch.float32) for part in scaled.signals(train))
    network = Network(u.shape[1])
    descent = torch.optim.Adam(network.parameters(), RATE)
    slower = torch.optim.lr_scheduler.CosineAnnealingLR(descent, STEPS)
    length = min(WINDOW + GIVEN, len(y))
    for _ in range(STEPS):
        starts = torch.randint(0, len(y) - length + 1, (BATCH,))
        at = starts[:, None] + torch.arange(length)
        error = (network(u[at]) - y[at])[:, min(GIVEN, length // 2) :].square().mean()
        descent.zero_grad()
        error.backward()
        descent.step()
        slower.step()
    out = {}
    with torch.no_grad():
        for name, test in tests.items():
            u_test, y_test = scaled.signals(test)
            run = network(torch.tensor(u_test, dtype=torch.float32)[None])[0].numpy()
            out[name] = scaled.error(run[GIVEN:], y_test[GIVEN:])
    return out


def bsnn_arx(train: Recording, tests: dict[str, Recording]) -> Errors:
    """The paper's model, of one input: one pass with F(0) = 5.6 I, then the free run."""
    scaled = Scaled(train)
    if len(scaled.names) > 1:
        return {}
    # The model does not scale its signals, and its weights saturate at 1.
    reach = [np.abs(part).max() for part in scaled.signals(train)]
    base = OnlineSettings(initial_gain=5.6).bsnn_arx()
    basis = Basis.uniform(-1.0, 1.0, 8)
    model = BsnnArx(replace(base, network=replace(base.network, basis=(basis,))))
    model.randomise(np.random.default_rng(0))
    u, y = scaled.signals(train)
    model.run(u[:, 0] / reach[0], y / reach[1], missing="skip")
    model.freeze()
    out = {}
    for name, test in tests.items():
        u, y = scaled.signals(test)
        run = model.free_run(u[:, 0] / reach[0], y[: model.lags] / reach[1]) * reach[1]
        out[name] = scaled.error(run[model.lags :], y[model.lags :])
    return out


PEERS = {
    "paper's BSNN-ARX": bsnn_arx,
    "SysIdentPy": sysidentpy,
    "GRU": gru,
    "padasip RLS": padasip_arx,
}


def errors(train: Recording, tests: dict[str, Recording]) -> dict[str, Errors]:
    """Errors of all peers that are installed."""
    out = {}
    for name, peer in PEERS.items():
        try:
            out[name] = peer(train, tests)
        except ImportError:
            continue
    return out
