"""Structures that `leglab identify` chooses by itself, beside what is known of each data set.

Public sets from $LEGLAB_DATA or ../shared/data, and machines that are simulated: four whose
equations are fitted as well, and a family that is drawn by a seed (`--drawn SEED NUMBER`).
Everything is chosen from the training part; the free run on the test part is scored. Each chosen
model also goes on learning online: its time per sample is compared with that of dense
recursive least squares, and a stream of wild samples must leave it finite.
"""

import argparse
import ctypes
import tempfile
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from scipy.io import loadmat

from benchmarks import bsnn_arx_speed, data_sets, results, structure_peers
from benchmarks.measured import shared_data
from benchmarks.simulated_machines import MACHINES, drawn
from leglab.base.errors import LeglabError
from leglab.base.recording import Recording
from leglab.identification import Identifier, StateSpace
from leglab.identification.structure import Identified, identify

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
PEERS = tuple(structure_peers.PEERS)
HEAD = (
    *("data", "samples", "structure", "free run", "after one pass", "best linear", "a constant"),
    *("known", "s"),
)
ONLINE = ("data", "structure", "parameters", "ns a sample", "over a bare loop", "10^6 samples")
TOLD = ("data", "samples", "noise", "free run", "equations known", "ratio with the noise")
MISSING = "-"  # the library is not installed, or takes no such data
STREAM = 1_000_000
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


def simulated(sizes: tuple[int, ...], noises: tuple[int, ...]) -> Iterator[tuple[str, Callable]]:
    """Machines with known equations by name, in some sizes and noises [dB]."""
    for name in MACHINES:
        for n in sizes:
            for noise in noises:
                yield f"{name}, {noise} dB, {n}", lambda a=(name, n, noise): _simulated(*a)


def _simulated(name: str, n: int, noise: int) -> Set:
    rng = np.random.default_rng([len(name), n, noise])
    machine = MACHINES[name]
    u = machine.drive(rng, 2 * n)
    y = machine.output(u)
    disturbed = y[:n] + np.std(y) * 10 ** (-noise / 20) * rng.normal(size=n)
    # The test is free of noise: what is scored is the machine.
    return recording(u[:n], disturbed), {f"{name}, {noise} dB, {n}": recording(u[n:], y[n:])}, 1.0


def equations(name: str, n: int, noise: int, free_run: float) -> list[Any]:
    """Row of the free run beside a fit that knows the equations.

    Both errors of the ratio include the noise of the sensor, as on a measured test.
    """
    rng = np.random.default_rng([len(name), n, noise, 1])
    machine = MACHINES[name]
    train, tests, _ = _simulated(name, n, noise)
    (test,) = tests.values()
    u = [np.column_stack([r[c] for c in r.columns if c != "y"]).squeeze() for r in (train, test)]
    theta = machine.fitted(rng, u[0], train["y"])
    # The test begins in the state in which training ends: both parts are simulated in one go.
    run = machine.run(theta[:, None], np.concatenate(u))[n:, 0]
    error = float(np.sqrt(np.mean((run - test["y"]) ** 2)))
    level = float(np.std(np.concatenate([train["y"], test["y"]]))) * 10 ** (-noise / 20)
    ratio = np.hypot(free_run, level) / np.hypot(error, level)
    return [name, n, noise, free_run, error, float(ratio)]


def _drawn(seed: int, number: int) -> Set:
    name, u, y = drawn(seed, number)
    half = len(y) // 2
    return recording(u[:half], y[:half]), {name: recording(u[half:], y[half:])}, 1.0


def online(found: Identified) -> list[Any]:
    """Row of the model as it goes on learning: parameters, ns, over a bare loop, stream.

    The bare loop is dense recursive least squares with as many parameters and nothing else: no
    regressors, no forgetting, no guards.
    """
    record = found.problem.records[0]
    u = record.u[:, 0] if found.model.inputs == 1 else record.u
    use = np.isfinite(record.y)
    u, y = u[use][:20_000], record.y[use][:20_000]
    native = _native()
    count, samples = len(found.model.parameters), len(y)
    phi = np.random.default_rng(0).normal(size=(samples, count))
    works = {
        "online": (lambda: found.model.copy().run(u, y), samples),
        "bare": (
            lambda: native.bare_rls(
                *(a.ctypes.data_as(ctypes.c_void_p) for a in (phi, y)), samples, count
            ),
            samples,
        ),
    }
    best = bsnn_arx_speed.fastest(works, 20)
    return [count, best["online"], best["online"] / best["bare"], stays_finite(found.model)]


_LIBRARIES: list[ctypes.CDLL] = []


def _native() -> ctypes.CDLL:
    if not _LIBRARIES:
        with tempfile.TemporaryDirectory() as folder:
            _LIBRARIES.append(bsnn_arx_speed.library(folder))
    return _LIBRARIES[0]


def stays_finite(model: Identifier) -> bool:
    """Whether all stays finite over jumps, NaN, rests and changes of scale in a stream."""
    rng = np.random.default_rng(0)
    learner = model.copy()
    signals = model.settings.signals
    for _ in range(STREAM // 10_000):
        columns = []
        for signal in signals:
            x = rng.normal(size=10_000).cumsum() * 10 ** rng.uniform(-12, 12)
            x[rng.integers(0, 10_000, 20)] *= 1e6
            x[rng.integers(0, 10_000, 20)] = rng.choice([np.nan, np.inf, -np.inf, 1e308])
            at = rng.integers(0, 8000)
            x[at : at + 2000] = x[at]
            if rng.random() < 0.5:  # as often within the range of training
                x = signal.lower + (signal.upper - signal.lower) * (0.5 + 0.5 * np.tanh(x))
            columns.append(x)
        y, inputs = columns[0], np.column_stack(columns[1:])
        predicted = learner.run(inputs[:, 0] if learner.inputs == 1 else inputs, y, missing="skip")
        if not (np.isfinite(predicted).all() and np.isfinite(learner.parameters).all()):
            return False
    return True


def rows_of(made: Set, jobs: int) -> tuple[list[Any], list[Any], list[Any]]:
    """Rows of one set: errors, peers, and learning online."""
    train, tests, factor = made
    begun = time.perf_counter()
    (found,) = identify(train, tests=tests, jobs=jobs).values()
    took = time.perf_counter() - begun
    peers = structure_peers.errors(train, tests)
    rows, beside = [], []
    for errors in found.tested:
        name = errors.recording
        own = (errors.free_run, errors.online, errors.linear, errors.mean)
        known = " ".join(KNOWN.get(name, ("", ""))).strip()
        rows.append([name, len(train), structure(found), *(factor * e for e in own), known, took])
        found_by = [peers.get(peer, {}).get(name) for peer in PEERS]
        told_by = [MISSING if error is None else factor * error for error in found_by]
        beside.append([name, factor * errors.free_run, *told_by])
    return rows, beside, [[next(iter(tests)), structure(found), *online(found)]]


def structure(found: Identified) -> str:
    """The chosen structure in a few words."""
    plan = found.chosen.plan
    if isinstance(state_space := found.chosen.fit.features[0], StateSpace):
        return f"{state_space.states} states, {state_space.curves} curves"
    bent = len(found.chosen.fit.features) - len(plan.orders.linear(found.problem))
    what = "linear" if not bent else f"{bent} {plan.kind}"
    return f"{what}, {plan.orders.outputs} + {plan.orders.inputs} lags"


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Rows of all sets that are wanted."""
    if options.drawn:
        seed, number = options.drawn
        wanted = [("", lambda k=k: _drawn(seed, k)) for k in range(number)]
    else:
        wanted = [*measured(), *simulated(tuple(options.samples), tuple(options.noise))]
    kept: dict[str, Any] = {"rows": [], "peers": [], "online": [], "equations": []}
    for name, make in wanted:
        if options.sets and not any(one.lower() in name.lower() for one in options.sets):
            continue
        try:
            made = make()
        except LeglabError as error:
            print(f"{name}: {error}")
            continue
        for part, rows in zip(
            ("rows", "peers", "online"), rows_of(made, options.jobs), strict=True
        ):
            kept[part] += rows
            print(*rows, sep="\n", flush=True)
        if (machine := name.split(", ")[0]) in MACHINES:
            _, noise, n = name.split(", ")
            free_run = kept["rows"][-1][3]
            kept["equations"].append(equations(machine, int(n), int(noise.split()[0]), free_run))
            print(kept["equations"][-1], flush=True)
    return {**kept, "drawn": bool(options.drawn)}


def tables(kept: dict[str, Any]) -> str:
    """Errors of all sets; peers; learning online; known equations; counts of a drawn family."""
    rows = [
        (name, str(n), chosen, *map(_shown, errors), known, f"{s:.0f}")
        for name, n, chosen, *errors, known, s in kept["rows"]
    ]
    peers = [(name, *map(_shown, errors)) for name, *errors in kept["peers"]]
    learning = [
        (name, chosen, str(p), f"{ns:.0f}", f"{ratio:.2f}", "finite" if finite else "NOT FINITE")
        for name, chosen, p, ns, ratio, finite in kept["online"]
    ]
    text = results.table(HEAD, rows)
    text += "\n" + results.table(("data", "leglab", *PEERS), peers)
    text += "\n" + results.table(ONLINE, learning)
    if kept["equations"]:
        known = [
            (a, str(n), f"{dB} dB", *map(_shown, rest)) for a, n, dB, *rest in kept["equations"]
        ]
        text += "\n" + results.table(TOLD, known)
    if kept["drawn"]:
        ratios = np.array([[row[3] / row[5], row[3] / row[6]] for row in kept["rows"]])
        linear, constant = ratios.T
        text += (
            f"\nOf {len(ratios)} machines: worse than the best linear model in "
            f"{np.sum(linear > 1.0005)} (at most {linear.max():.3f} of it), worse than a constant "
            f"in {np.sum(constant > 1.0005)}, better than linear by a tenth in "
            f"{np.sum(linear <= 0.9)}.\n"
        )
    return text


def _shown(error: float | str | None) -> str:
    if isinstance(error, str):
        return error
    return f"{error:.3g}" if error is not None and error < 1e6 else "diverges"


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("sets", nargs="*", help="part of the names of those wanted; default: all")
    parser.add_argument("--samples", type=int, nargs="+", default=[1000])
    parser.add_argument("--noise", type=int, nargs="+", default=[20, 40], help="dB")
    parser.add_argument(
        "--drawn",
        type=int,
        nargs=2,
        metavar=("SEED", "NUMBER"),
        help="machines of a family instead",
    )
    parser.add_argument("--jobs", type=int, default=2)
