"""Gain of measured pressures.

Walking leg, specimens of tolerance 0.1, one fault each of all cylinders, sizes and times drawn as
in `live_names.py`. `bsnn_arx_pressure` stands beside `bsnn_arx` and `bsnn_arx_bank`, with positions
only, and `adaptive_backstepping`, with the same sensors; `frozen` is what errors are measured
against, `oracle` the bound for one fixed map of `bsnn_arx`.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import live_names, results
from benchmarks.specimens import window_rms
from leglab import RunSettings
from leglab.base.scale import rms
from leglab.base.scenario import Scenario, get_scenario
from leglab.causes.fault_names import ALL
from leglab.runs.clock import adaptation
from leglab.runs.history import History
from leglab.runs.loop import Loop
from leglab.runs.preparation import Preparation

FROZEN, ORACLE, PEER = "frozen", "oracle", "adaptive_backstepping"
OWN = "bsnn_arx_pressure"
ADAPTIVE = ("bsnn_arx", "bsnn_arx_bank", OWN, PEER)
# Beside whole errors: what is asked of the medians, by window, and of t90, median and worst [s].
ASKED = {(0.3, 0.6): 0.18, (1.2, 2.4): 0.08}
ASKED_T90 = (0.4, 1.2)
# Largest error of the oracle's, and of the peer's in any fault; valve travel over that of `pd`.
OF_ORACLE, OF_PEER, OF_PD = 1.25, 1.3, 1.5

Case = tuple[int, str, float, float]


def cases(seeds: Sequence[int], faults: Sequence[str]) -> Iterator[Case]:
    """Seed, fault, size and time of the change [s] of every case."""
    for seed, fault, element, size, change in live_names.cases(seeds):  # type: ignore[arg-type]
        if element == ALL and (not faults or fault in faults):
            yield seed, fault, size, change


def judged(task: tuple[Case, tuple[str, ...]]) -> dict[str, Any]:
    """Figures of one case by controller."""
    (seed, fault, size, change), controllers = task
    found: dict[str, Any] = {"seed": seed, "fault": fault, "size": size}
    runs: dict[str, History] = {}
    scenario = None
    for controller in (FROZEN, "pd", ORACLE, *controllers):
        settings = RunSettings(
            scenario="nominal",
            controller=controller,
            controller_config={"stop_time": change} if controller == FROZEN else {},
            tolerance=0.1,
            seed=seed,
            vary=True,
        )
        whole = get_scenario(fault, duration=live_names.DURATION, severity=size)
        changes = tuple(replace(c, start=change) for c in whole.changes)
        scenario = Scenario(name=fault, duration=live_names.DURATION, changes=changes)
        loop = Loop(settings, preparation=Preparation(settings), scenario=scenario)
        runs[controller] = history = loop.run()
        assert not history.failure, (task, controller, history.failure)
    base = _errors(runs[FROZEN], change)
    found["frozen_mrad"] = base.tolist()
    end = live_names.DURATION - 4 * live_names.STRIDE
    for controller, history in runs.items():
        clock = adaptation(
            scenario,  # type: ignore[arg-type]
            live_names.STRIDE,
            history.time,
            history.error,
            loop.simulation.joints,
            twin=runs[FROZEN].error,
        )
        last = history.time >= end
        found[controller] = {
            "ratio": (_errors(history, change) / base).tolist(),
            "t90": clock.t90_s,
            "clocked": clock.level_rad is not None,
            "before": 1e3 * clock.before_rad["all"] if clock.before_rad else None,
            "end": 1e3 * float(rms(history.error[last])),
            "travel": float(np.abs(np.diff(history.command, axis=0)).sum()),
            "wall": history.wall_time,
        }
    return found


def _errors(history: History, change: float) -> np.ndarray:
    """RMS errors [mrad] in the windows of `live_names.py`."""
    after = history.time - change
    windows = live_names.WINDOWS
    return np.array([1e3 * window_rms(history.error, after, *window) for window in windows])


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """All cases."""
    seeds = range(options.first, options.first + options.specimens)
    controllers = tuple(options.controllers.split(","))
    if "bsnn_arx_bank" in controllers:  # the bank is made here once; the other processes read it
        Loop(RunSettings(scenario="nominal", controller="bsnn_arx_bank"))
    faults = options.faults.split(",") if options.faults else []
    tasks = [(case, controllers) for case in cases(seeds, faults)]
    found = results.resumed(judged, tasks, folder=options.keep, jobs=options.jobs)
    return sorted(found, key=lambda x: (x["seed"], x["fault"], x["size"]))


def tables(found: list[dict[str, Any]]) -> str:
    """Errors over time; then by fault."""
    shown = [name for name in ADAPTIVE if name in found[0]]
    return "\n".join([_whole(found, shown), _by_fault(found, shown)])


def _whole(found: list[dict[str, Any]], shown: list[str]) -> str:
    windows = [f"{a:g}-{b:g}" for a, b in live_names.WINDOWS]
    head = ["error over that of `frozen`, median, s after the change", *windows]
    head += ["t90 median, s", "worst", "never", "end / oracle, median", "within 1.25"]
    head += [f"end / `{PEER}`, lower in", "largest", "travel / `pd`", "time / `pd`"]
    rows = []
    for name in shown:
        ratio = np.median([case[name]["ratio"] for case in found], axis=0)
        oracle = np.array([case[name]["end"] / case[ORACLE]["end"] for case in found])
        row = [f"`{name}`", *(results.number(float(x), 2) for x in ratio)]
        row += [*live_names.t90_cells(found, name), results.number(float(np.median(oracle)), 3)]
        row += [f"{int((oracle <= OF_ORACLE).sum())} of {len(found)}"]
        peer = _of(found, name, PEER) if PEER in found[0] else {}
        lower = sum(value < 1 for value in peer.values())
        row += [f"{lower} of {len(peer)} faults" if peer and name != PEER else ""]
        row += [results.number(max(peer.values()), 2) if peer and name != PEER else ""]
        travel = np.median([case[name]["travel"] / case["pd"]["travel"] for case in found])
        wall = np.median([case[name]["wall"] / case["pd"]["wall"] for case in found])
        rows.append([*row, results.number(float(travel), 3), results.number(float(wall), 2)])
    asked = [f"{ASKED[w]:g}" if w in ASKED else "" for w in live_names.WINDOWS]
    limits = [f"{OF_PEER:g}", f"{OF_PD:g}", "1.7"]
    goals = [*asked, *map(str, ASKED_T90), "0", "", "all", "19 of 22", *limits]
    rows.append(["asked with pressures", *goals])
    return results.table(head, rows)


def _of(found: list[dict[str, Any]], name: str, other: str) -> dict[str, float]:
    """Mean end error of a controller over that of another, by fault and side of its size."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for case in found:
        groups.setdefault(_kind(case), []).append(case)
    return {
        kind: float(np.mean([c[name]["end"] for c in g]) / np.mean([c[other]["end"] for c in g]))
        for kind, g in groups.items()
    }


def _kind(case: dict[str, Any]) -> str:
    """Fault, with the sign of its size where there are both."""
    return case["fault"] + (" (negative)" if case["size"] < 0 else "")


def _by_fault(found: list[dict[str, Any]], shown: list[str]) -> str:
    head = ["fault", "cases", "frozen, mrad"]
    for name in shown:
        head += [f"`{name}` .3-.6", "1.2-2.4", "t90", "end, mrad"]
    head += ["oracle end"]
    kinds = list(dict.fromkeys(_kind(case) for case in found))
    rows = []
    for kind in kinds:
        group = [case for case in found if _kind(case) == kind]
        row = [kind, str(len(group))]
        row += [results.number(float(np.median([c["frozen_mrad"][3] for c in group])), 2)]
        for name in shown:
            ratio = np.median([case[name]["ratio"] for case in group], axis=0)
            row += [results.number(float(ratio[1]), 2), results.number(float(ratio[3]), 2)]
            row += [live_names.t90_cells(group, name)[0]]
            row += [results.number(float(np.mean([c[name]["end"] for c in group])), 2)]
        row += [results.number(float(np.mean([c[ORACLE]["end"] for c in group])), 2)]
        rows.append(row)
    return results.table(head, rows)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--specimens", type=int, default=3, help="how many")
    parser.add_argument("--first", type=int, default=live_names.FIRST_SEED, help="first seed")
    parser.add_argument("--faults", default="", help="only these, separated by commas")
    parser.add_argument("--controllers", default=",".join(ADAPTIVE), help="separated by commas")
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time")
    parser.add_argument("--keep", type=Path, help="where finished cases are kept, to go on")
