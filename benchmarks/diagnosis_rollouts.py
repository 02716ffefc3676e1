"""Replays a second of the diagnosis and of mujoco.sysid.

Measuring needs the benchmarks group (mujoco[sysid]). The same model at the same time step, the same
four recordings of 12 s, the same threads, taking turns; one replay is all recordings once with
another flow gain of the valve. mujoco.sysid gets the recordings as in its documentation, whole and
one after the other, and also as the windows of the diagnosis with their start states, all in one
call, which uses its threads best. It compares positions; the diagnosis makes the start states anew,
compares pressures as well, and whitens.
"""

import argparse
import statistics
import time
from typing import Any

import mujoco
import numpy as np

from benchmarks import results
from benchmarks.measured import shared_data
from leglab.diagnosis.effects.hypothesis import Hypothesis
from leglab.diagnosis.intake.recordings import read_recordings, split_held_out
from leglab.diagnosis.plant.model import Change
from leglab.diagnosis.replay import starts
from leglab.diagnosis.replay.residual import Problem
from leglab.diagnosis.search.pipeline import DiagnosisSettings, set_up

KEY = ("valve_gain", "knee_valve")
NAME = "rated_flow"


def trajectories(problem, windows):
    """Controls, positions and start states for mujoco.sysid: of windows, or of whole recordings."""
    from mujoco import sysid

    replay, change = problem.replay, Change(problem.machine)
    states, controls, sensors = [], [], []
    for cut in replay.cuts:
        measured, _ = starts.measure(cut, replay.channels, change)
        begun = starts.start_states(cut, change, measured, replay.channels, replay.rest_time)
        for first, start in zip(cut.firsts, begun, strict=True):
            end = first + replay.samples if windows else cut.series.time.size
            part = slice(first, end)
            at = cut.series.period * np.arange(end - first)
            start[0] = 0.0  # time
            states.append(start)
            controls.append((at, cut.series.columns["knee_valve_command"][part, None]))
            sensors.append((at, cut.series.columns["knee_position"][part, None]))
            if not windows:
                break
    ctrl = {"knee_valve_ctrl": (sysid.SignalType.MjCtrl, np.array([0]))}
    seen = {"knee_qpos": (sysid.SignalType.MjStateQPos, np.array([0]))}
    return (
        states,
        [sysid.TimeSeries(t, u, ctrl) for t, u in controls],
        [sysid.TimeSeries(t, q, seen) for t, q in sensors],
    )


def peer(problem: Problem, threads: int, *, windows: bool):
    """mujoco.sysid's residual as a function of the rated flow [m^3/s]."""
    from mujoco import sysid

    spec = problem.machine.spec()
    spec.option.timestep = problem.machine.timestep
    spec.compiler.discardvisual = True
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    nominal = problem.machine.parameter("knee_valve", NAME)

    def write(spec: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
        plugin = spec.actuator("knee_valve").plugin
        plugin.config = {**plugin.config, NAME: repr(float(parameter.value[0]))}

    parameters = sysid.ParameterDict(
        {NAME: sysid.Parameter(NAME, nominal, 0.2 * nominal, 3 * nominal, modifier=write)}
    )
    states, controls, sensors = trajectories(problem, windows)
    names = [str(i) for i in range(len(states))]
    sequences = sysid.ModelSequences(
        "knee", spec, names, states, controls, sensors, allow_missing_sensors=True
    )
    wanted = [("knee_qpos", sysid.SignalType.MjStateQPos)]
    if not windows:
        function = sysid.build_residual_fn(
            models_sequences=[sequences], n_threads=threads, enabled_observations=wanted
        )
        return lambda value: function(np.array([value]), parameters)

    def at_once(value: float):
        return sysid.model_residual(
            np.array([value]),
            parameters,
            lambda p: sysid.apply_param_modifiers(p, spec),
            sequences.measured_rollout,
            n_threads=threads,
            enabled_observations=wanted,
        )

    return at_once


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Seconds of a replay, by tool."""
    from absl import logging

    logging.set_verbosity(logging.ERROR)  # it warns that not all sensors of the model are used
    recordings = read_recordings(sorted(shared_data("knee_bench/nominal").glob("*.parquet")))
    recordings, held = split_held_out("knee_bench", recordings, [])
    problem = set_up("knee_bench", recordings, held, DiagnosisSettings(threads=options.threads))
    runs = {
        "leglab diagnose": lambda v: problem.residual(Hypothesis({KEY: np.array([v])})),
        "mujoco.sysid, recordings whole": peer(problem, options.threads, windows=False),
        "mujoco.sysid, windows in one call": peer(problem, options.threads, windows=True),
    }
    nominal = problem.machine.parameter("knee_valve", NAME)
    wall: dict[str, list[float]] = {name: [] for name in runs}
    spent: dict[str, list[float]] = {name: [] for name in runs}
    for i in range(options.rounds + 1):
        for name, run in runs.items():
            began, processor = time.perf_counter(), time.process_time()
            run(nominal * (1.0 + 1e-3 * i))
            if i:  # the first of each warms up
                wall[name].append(time.perf_counter() - began)
                spent[name].append(time.process_time() - processor)
    return {
        "setting": f"{len(recordings)} recordings, {problem.replay.windows} windows, time step "
        f"{1e3 * problem.machine.timestep:g} ms, {options.threads} threads",
        "replays": {
            name: {
                "best_per_s": 1 / min(wall[name]),
                "median_per_s": 1 / statistics.median(wall[name]),
                "processor_s": statistics.median(spent[name]),
            }
            for name in runs
        },
    }


def tables(found: dict[str, Any]) -> str:
    """A row a tool."""
    rows = [
        (
            name,
            f"{row['best_per_s']:.2f}",
            f"{row['median_per_s']:.2f}",
            f"{row['processor_s']:.3f}",
        )
        for name, row in found["replays"].items()
    ]
    head = ("tool", "replays/s, best", "median", "processor s a replay, median")
    return f"{results.table(head, rows)}\n{found['setting']}"


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=15)
