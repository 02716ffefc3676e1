"""Gain of adapting on a changing machine: every scenario and controller, many seeds.

A seed draws the specimen about the machine that controllers know, the phase of the stride, the time
of the change and the sensor noise. Errors are RMS over joints and time in mrad, of the true
positions; intervals are 95 % over seeds. With `--faults` sixteen faults in three sizes with
adaptive controllers, as `leglab benchmark adaptation` has them. An interrupted call goes on where
it was.
"""

import argparse
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.progress import Progress

from benchmarks import adaptation_faults, results
from benchmarks.adaptation_tables import ADAPTIVE, CALIBRATED, Cells, by_rig, claims
from benchmarks.specimens import TOLERANCE
from leglab import RunSettings
from leglab.base.errors import SimulationError
from leglab.base.scenario import get_scenario, scenario_names
from leglab.runs.comparison import run_all
from leglab.runs.sweeps.engine import run_sweep

PEERS = ("pid", "arx", "bsnn_arx_paper", "adaptive_backstepping")
NEEDED = (CALIBRATED, ADAPTIVE, "oracle")
# Those of `--faults`, without what no real controller could be or what stops where a fault begins.
FAULTY = (
    "adaptive_backstepping", "adrc", "arx", "bsnn_arx", "bsnn_arx_bank", "bsnn_arx_paper",
    "bsnn_arx_pressure", "ilc", "pid",
)  # fmt: skip
# Beside the defaults, as the scenario's documentation names them.
SIZES = {"seal_wear": (2.0, 50.0)}


@dataclass(frozen=True, kw_only=True)
class Rig:
    """A machine with a motion."""

    model: str  #: Name of the model
    reference: str | None  #: Name of the reference; None for the scenario's own
    controllers: tuple[str, ...]  #: Which ones run in every scenario
    seeds: int = 3  #: Number of them
    peer_seeds: int = 2  #: Number of them for controllers that no claim but the comparison needs
    only: tuple[str, ...] | None = None  #: Scenarios; None for all
    #: Whether the machine is the one that controllers know, and no seed draws more than sensor
    #: noise.
    exact: bool = False

    def runs(self) -> dict[tuple[str, float | None], list[RunSettings]]:
        """Settings of all runs, by scenario and size (None for its own)."""
        cases: list[tuple[str, float | None]] = [
            (name, None) for name in self.only or scenario_names() if self._has(name)
        ]
        if self.only is None:
            cases += [(name, value) for name, values in SIZES.items() for value in values]
        return {
            (name, size): [
                RunSettings(
                    scenario=name,
                    severity=size,
                    controller=controller,
                    model=self.model,
                    reference=self.reference,
                    seed=seed,
                    duration=max(20.0, get_scenario(name).duration),
                    tolerance=0.0 if self.exact else TOLERANCE,
                    vary=not self.exact,
                )
                for controller in self._of(name)
                for seed in range(self.peer_seeds if controller in PEERS else self.seeds)
            ]
            for name, size in cases
        }

    def _has(self, scenario: str) -> bool:
        # The bench's supply is ideal: no pump that could give too little.
        return self.model != "knee_bench" or scenario != "supply_droop"

    def _of(self, scenario: str) -> tuple[str, ...]:
        return ("pd", *self.controllers) if scenario == "nominal" else self.controllers


FULL = (*NEEDED, *PEERS)
EXACT = ("nominal", "seal_wear", "cold_oil", "supply_drop")
FEW = (*EXACT, "friction_rise", "valve_wear")
RIGS = {
    "leg, walking": Rig(model="leg", reference=None, controllers=FULL, seeds=10),
    "leg, walking, exact machine": Rig(
        model="leg", reference=None, controllers=FULL, seeds=1, peer_seeds=1, exact=True, only=EXACT
    ),
    "knee_bench, walking": Rig(model="knee_bench", reference=None, controllers=NEEDED),
    "leg, squat": Rig(model="leg", reference="squat", controllers=NEEDED, seeds=2),
    "leg, random stride": Rig(model="leg", reference="random_stride", controllers=NEEDED, only=FEW),
    "leg_rail, squat": Rig(
        model="leg_rail", reference="squat", controllers=(CALIBRATED, ADAPTIVE), seeds=2
    ),
}


def measure(options: argparse.Namespace) -> Any:
    """Makes what the folder lacks; by rig a dictionary a run, with `--faults` rows of text."""
    if options.faults:
        plan, _ = adaptation_faults.adaptation_plan(FAULTY, specimens=1)
        found = run_sweep(plan, options.out / "benchmark", workers=options.jobs)
        scores = adaptation_faults.scores(found.table().to_pylist())
        return [[score.fault, *adaptation_faults.cells(score)] for score in scores]
    return {name: _runs(name, options) for name in options.rigs}


def _runs(rig: str, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Numbers of each run of a rig."""
    folder = options.out / re.sub(r"\W+", "-", rig)
    cells: Cells = {}
    with Progress() as bar:
        cases = RIGS[rig].runs()
        task = bar.add_task(folder.name, total=sum(len(runs) for runs in cases.values()))
        for (name, size), runs in cases.items():
            at = folder / (name if size is None else f"{name}-{size:g}")
            for result in run_all(runs, at, jobs=options.jobs):
                controller = result["settings"]["controller"]
                cells.setdefault((name, size, controller), []).append(result)
            bar.advance(task, len(runs))
    return [
        {"scenario": case[0], "severity": case[1], "controller": case[2], **_row(cells, case, run)}
        for case, runs in cells.items()
        for run in runs
    ]


def _row(cells: Cells, case: tuple[str, float | None, str], run: dict[str, Any]) -> dict[str, Any]:
    """Numbers of a run of `leglab.runs.comparison.run_all`.

    `seed`, `completed` and, as `leglab.runs.clock` defines them, `before`, `after`, `end`,
    `damage`, `twin_end` [rad], `recovered` and `t90` [s], None where they cannot be told; `told`
    says whether `recovered` can. Nominal ones have `end_by_joint` and `travel` [rad]; those of
    `bsnn_arx` have `safety`: the worst ratio to `static_feedforward` in a 2 s window, its time [s],
    and both errors [mrad].
    """
    (name, size, controller), metrics = case, run["metrics"]
    if not metrics["phases"]:
        raise SimulationError(f"{name}, {controller}: {metrics['failure']}")
    found = metrics["adaptation"]
    before, end = found["before_rad"], found["end_rad"]
    row = {
        "seed": run["settings"]["seed"],
        "completed": metrics["completed"],
        "before": before and before["all"],
        "after": metrics["phases"][-1]["rms_rad"]["all"],
        "end": end and end["all"],
        "damage": found["damage_rad"],
        "twin_end": found["twin_end_rad"],
        "recovered": found["recovered"],
        "t90": found["t90_s"],
        "told": found["reason"] is None,
    }
    if name == "nominal":
        row |= {"end_by_joint": end, "travel": run["travel_rad"]}
    if controller == ADAPTIVE:
        row["safety"] = _safety(run, cells.get((name, size, CALIBRATED), []))
    return row


def _safety(run: dict[str, Any], statics: list[dict[str, Any]]) -> tuple[float, ...]:
    worst = (0.0, 0.0, 0.0, 0.0)
    for other in statics:
        if other["settings"]["seed"] != run["settings"]["seed"]:
            continue
        pairs = zip(run["time"], run["safety_error_rad"], other["safety_error_rad"], strict=False)
        for t, ours, theirs in pairs:
            if t >= adaptation_faults.SAFE_FROM and ours is not None and theirs:
                worst = max(worst, (ours / theirs, t, 1e3 * ours, 1e3 * theirs))
    return worst


def tables(kept: Any) -> str:
    """Tables of each rig, or of all faults together and then the time to nine tenths of each."""
    if isinstance(kept, dict):
        return "\n\n".join(
            table for name, cells in by_rig(kept).items() for table in claims(cells, name)
        )
    head, every = list(adaptation_faults.HEAD), [row[1:] for row in kept if row[0] == "all"]
    together = results.table(head, every)
    controllers = list(dict.fromkeys(row[1] for row in kept))
    median, never = (1 + head.index(name) for name in ("90 % after, s", "never"))
    cells = {(row[0], row[1]): (row[median], row[never]) for row in kept}
    lines = []
    for fault in dict.fromkeys(row[0] for row in kept if row[0] != "all"):
        line = [f"`{fault}`"]
        for name in controllers:
            time, of = cells[fault, name]
            line.append(f"{time} ({of})" if of and not of.startswith("0 ") else time)
        lines.append(line)
    head = ["90 % after, s (never)", *(f"`{name}`" for name in controllers)]
    return together + "\n" + results.table(head, lines)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--faults", action="store_true", help="sixteen faults in three sizes")
    parser.add_argument("--rigs", nargs="*", default=list(RIGS), choices=list(RIGS))
    parser.add_argument("--jobs", type=int, default=-1, help="processes; -1: one a core")
    parser.add_argument("--out", type=Path, default=Path("runs/adaptation"))
