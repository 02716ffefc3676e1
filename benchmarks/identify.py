"""Structures that `leglab identify` chooses by itself, beside what is known of each data set.

Public sets from $LEGLAB_DATA or ../shared/data, and machines that are simulated here: a
Wiener-Hammerstein system, the Bouc-Wen hysteresis by its equations (Wen 1976), a tank with an
overflow, and a heater of two inputs. Everything is chosen from the training part; the free run on
the test part is scored.
"""

import argparse
import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from scipy.io import loadmat
from scipy.signal import lfilter

from benchmarks import data_sets, results
from leglab.base.errors import LeglabError
from leglab.base.recording import Recording
from leglab.identification.structure import Identified, identify
from leglab.studies.shared_data import shared_data

# Published, or computed for the set's description: free run on the test part, unit of the table.
KNOWN = {
    "Silverbox multisine": ("GP-NARX .30", "mV"),
    "Silverbox, no extrapolation": ("GP-NARX .26", "mV"),
    "Silverbox arrow": ("GP-NARX .60", "mV"),
    "hydraulic actuator": ("by hand .412", ""),
    "EMPS": ("linear .015", "m/s"),
    "dryer": ("ARX .119", ""),
    "heating system": ("ARX 5.50", "°C"),
    "exchanger": ("ARX .544", "°C"),
    "robot arm": ("ARX .0082", ""),
    "Bouc-Wen damper": ("ARX 251; SysIdentPy with sign(v) 30", "N"),
}
PUBLIC = {
    "dryer": "dryer",
    "heating system": "heating_system",
    "exchanger": "exchanger",
    "robot arm": "robot_arm",
    "Bouc-Wen damper": "bouc_wen_damper",
}
HEAD = (
    *("data", "samples", "structure", "free run", "best linear", "a constant"),
    *("SysIdentPy", "known", "s"),
)
# Lags and degree of the peer: FROLS with its own order selection needs both from a person.
PEER_LAGS, PEER_DEGREE, PEER_SAMPLES = 4, 2, 5000
# Training part, tests by name, factor of the table's unit.
Set = tuple[Recording, dict[str, Recording], float]


def recording(u: np.ndarray, y: np.ndarray, period: float = 1.0) -> Recording:
    """Signals as a recording with columns u, or u1, u2 ..., and y."""
    u = np.asarray(u, float).reshape(len(y), -1)
    names = ["u"] if u.shape[1] == 1 else [f"u{j + 1}" for j in range(u.shape[1])]
    columns = {name: u[:, j].copy() for j, name in enumerate(names)}
    return Recording(time=np.arange(len(y)) * period, columns={**columns, "y": np.array(y, float)})


def measured() -> Iterator[tuple[str, Callable[[], Set]]]:
    """Public sets by name."""
    yield "Silverbox", _silverbox
    yield "hydraulic actuator", _actuator
    yield "EMPS", _emps
    for name, file in PUBLIC.items():
        yield name, lambda file=file: _public(file)


def _silverbox() -> Set:
    data = data_sets.silverbox()
    names = {
        "multisine": "Silverbox multisine",
        "arrow, no extrapolation": "Silverbox, no extrapolation",
        "arrow": "Silverbox arrow",
    }
    tests = {names[n]: recording(data.u[s], data.y[s]) for n, s in data.tests.items()}
    return recording(data.u[data.train], data.y[data.train]), tests, 1e3


def _actuator() -> Set:
    data = data_sets.actuator()
    (part,) = data.tests.values()
    tests = {"hydraulic actuator": recording(data.u[part], data.y[part])}
    return recording(data.u[data.train], data.y[data.train]), tests, 1.0


def _emps() -> Set:
    parts = []
    for name in ("DATA_EMPS", "DATA_EMPS_PULSES"):
        content = loadmat(shared_data(f"emps/{name}.mat"))
        velocity = np.gradient(content["qm"].ravel(), 1e-3)
        parts.append(recording(content["vir"].ravel()[::20], velocity[::20], 0.02))
    return parts[0], {"EMPS": parts[1]}, 1.0


def _public(file: str) -> Set:
    from leglab.data import read

    title = next(name for name, one in PUBLIC.items() if one == file)
    train, test = (read(shared_data(f"identify/{file}_{part}.csv")) for part in ("train", "test"))
    return train, {title: test}, 1.0


def drive(rng: np.random.Generator, n: int, hold: int) -> np.ndarray:
    """Random levels in [-1, 1], each held for so many samples on average."""
    change = rng.random(n) < 1 / hold
    return rng.uniform(-1, 1, n)[np.maximum.accumulate(np.where(change, np.arange(n), 0))]


def wiener_hammerstein(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """A dead zone that saturates between two linear filters of second order."""
    u = drive(rng, n, 5)
    x = lfilter([0.1, 0.1], [1, -1.5, 0.7], u)
    bent = np.clip(np.sign(x) * np.maximum(np.abs(x) - 0.1, 0), -0.6, 0.6)
    return u, lfilter([0.2, 0.1], [1, -1.2, 0.5], bent)


def bouc_wen(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """M y'' + c y' + k y + z = F, z' = a y' - b (g |y'| |z|^(v-1) z + d y' |z|^v), v = 1 (Wen)."""
    force = 100 * lfilter([0.05], [1, -0.95], rng.normal(size=n)) * 3
    m, c, k, a, b, g, d = 2.0, 10.0, 5e4, 5e4, 1e3, 0.8, -1.1
    steps, dt = 20, 1 / 750
    y = v = z = 0.0
    out = np.empty(n)
    for t in range(n):
        for _ in range(steps):
            rate = a * v - b * (g * abs(v) * z + d * v * abs(z))
            v += dt / steps * (force[t] - c * v - k * y - z) / m
            y += dt / steps * v
            z += dt / steps * rate
        out[t] = 1e3 * y
    return force, out


def tank(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Two tanks in a row, the upper with an overflow into the lower; the lower level is seen."""
    u = np.clip(2.6 + 2.6 * drive(rng, n, 40), 0, None)
    upper = lower = 3.0
    out = np.empty(n)
    for t in range(n):
        spill = max(upper - 10.0, 0.0)
        upper += 0.25 * u[t] - 0.30 * np.sqrt(upper) - spill
        lower += 0.30 * np.sqrt(upper) - 0.28 * np.sqrt(lower) + 0.5 * spill
        upper, lower = max(upper, 0.0), min(max(lower, 0.0), 10.0)
        out[t] = lower
    return u, out


def heater(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Temperature by electric power (a square of voltage, late by 4 samples) and air flow."""
    u = np.column_stack([1 + drive(rng, n, 30), 1.2 + drive(rng, n, 50)])
    y = 30.0
    out = np.empty(n)
    for t in range(n):
        power = u[max(t - 4, 0), 0] ** 2
        y += 0.6 * power - 0.02 * (y - 20) * (0.3 + u[t, 1])
        out[t] = y
    return u, out


MACHINES = {
    "Wiener-Hammerstein": wiener_hammerstein,
    "Bouc-Wen": bouc_wen,
    "tank with overflow": tank,
    "two-input heater": heater,
}


def simulated(sizes: tuple[int, ...], noises: tuple[int, ...]) -> Iterator[tuple[str, Callable]]:
    """Machines of this page by name, in some sizes and noises [dB]."""
    for name in MACHINES:
        for n in sizes:
            for noise in noises:
                yield f"{name}, {noise} dB, {n}", lambda a=(name, n, noise): _simulated(*a)


def _simulated(name: str, n: int, noise: int) -> Set:
    rng = np.random.default_rng([len(name), n, noise])
    u, y = MACHINES[name](rng, 2 * n)
    scale = np.std(y) * 10 ** (-noise / 20)
    train = recording(u[:n], y[:n] + scale * rng.normal(size=n))
    # The test is free of noise: what is scored is the machine.
    return train, {f"{name}, {noise} dB, {n}": recording(u[n:], y[n:])}, 1.0


def sysidentpy(train: Recording, tests: dict[str, Recording]) -> dict[str, float]:
    """RMS free run of SysIdentPy's FROLS, polynomials of lags; infinite where it diverges."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS

    def signals(one: Recording) -> tuple[np.ndarray, np.ndarray]:
        u = np.column_stack([one[c] for c in one.columns if c.startswith("u")])
        return (u - centre[1:]) / scale[1:], (one["y"][:, None] - centre[0]) / scale[0]

    names = [c for c in train.columns if c.startswith("u")]
    columns = np.column_stack([train["y"], *(train[c] for c in names)])[:PEER_SAMPLES]
    centre, scale = columns.mean(axis=0), columns.std(axis=0)
    u, y = (part[:PEER_SAMPLES] for part in signals(train))
    lags = list(range(1, PEER_LAGS + 1))
    xlag: Any = lags if len(names) == 1 else [lags] * len(names)
    model = FROLS(
        order_selection=True,
        n_info_values=20,
        ylag=PEER_LAGS,
        xlag=xlag,
        basis_function=Polynomial(degree=PEER_DEGREE),
    )
    out = {}
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model.fit(X=u, y=y)
        for name, test in tests.items():
            u_test, y_test = signals(test)
            run = model.predict(X=u_test, y=y_test[: model.max_lag])
            error = float(np.sqrt(np.mean((run - y_test)[model.max_lag :] ** 2))) * scale[0]
            out[name] = error if np.isfinite(error) else float("inf")
    return out


def rows_of(made: Set, jobs: int) -> list[list[Any]]:
    """Rows of the table for one set."""
    train, tests, factor = made
    begun = time.perf_counter()
    (found,) = identify(train, tests=tests, jobs=jobs).values()
    took = time.perf_counter() - begun
    peer = sysidentpy(train, tests)
    return [
        [
            errors.recording,
            len(train),
            structure(found),
            factor * errors.free_run,
            factor * errors.linear,
            factor * errors.mean,
            factor * peer[errors.recording],
            KNOWN.get(errors.recording, ("", ""))[0],
            took,
        ]
        for errors in found.tested
    ]


def structure(found: Identified) -> str:
    """The chosen structure in a few words."""
    plan = found.chosen.plan
    bent = len(found.chosen.fit.features) - len(plan.orders.linear(found.problem))
    what = "linear" if not bent else f"{bent} {plan.kind}"
    return f"{what}, {plan.orders.outputs} + {plan.orders.inputs} lags"


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Rows of all sets that are wanted."""
    wanted = [*measured(), *simulated(tuple(options.samples), tuple(options.noise))]
    rows: list[list[Any]] = []
    for name, make in wanted:
        if options.sets and not any(one.lower() in name.lower() for one in options.sets):
            continue
        try:
            made = make()
        except LeglabError as error:
            print(f"{name}: {error}")
            continue
        rows += rows_of(made, options.jobs)
        print(rows[-1], flush=True)
    return {"rows": rows}


def tables(kept: dict[str, Any]) -> str:
    """The table."""
    rows = [
        (name, str(n), chosen, *map(_shown, errors), known, f"{s:.0f}")
        for name, n, chosen, *errors, known, s in kept["rows"]
    ]
    return results.table(HEAD, rows)


def _shown(error: float | None) -> str:
    return f"{error:.3g}" if error is not None and error < 1e6 else "diverges"


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("sets", nargs="*", help="part of the names of those wanted; default: all")
    parser.add_argument("--samples", type=int, nargs="+", default=[1000])
    parser.add_argument("--noise", type=int, nargs="+", default=[20, 40], help="dB")
    parser.add_argument("--jobs", type=int, default=2)
