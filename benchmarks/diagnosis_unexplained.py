"""Machines whose cause has no name: is improved.xml a better model, in plain MuJoCo as well?

`python -m benchmarks diagnosis_unexplained [CASE...]`, in a checkout, with $LEGLAB_DATA for the two
measured cases. Each is diagnosed by the command, with the effects that would name the cause left
out. The written model then runs in `leglab run`, and in MuJoCo alone with the plugin's library: a
held-out recording from end to end, its commands corrected by a slow position loop.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import results
from benchmarks.measured import EMPS_HELD_OUT, EMPS_MODEL, emps, shared_data
from leglab import data
from leglab.base.recording import Recording
from leglab.diagnosis.effects.hypothesis import Hypothesis, Library
from leglab.diagnosis.intake.recordings import read_recordings, split_held_out
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.search.pipeline import DiagnosisSettings, set_up
from leglab.machine.plugin import library_path, to_xml
from rigs import PENDULUM, Truth, record
from rigs.bench import FaultyBench, references

# Effects that would name a torque of position, so that nothing that is looked for describes it.
EXCLUDED = ("position_torque", "harmonic_torque", "cogging", "torque_ripple")
HEAD = (
    "machine",
    "hidden",
    "verdict",
    "named, learned",
    "noise levels, held out",
    "plain MuJoCo, whole held-out recording: off",
    "correction it needs",
    "leglab run",
)
# Knows no leglab: a bare model along a recording whose commands drive it, with a slow loop.
_PLAIN = """
import sys
import mujoco
import numpy as np

library, model, recording, stiffness, damping = sys.argv[1:]
mujoco.mj_loadPluginLibrary(library)
bare = mujoco.MjModel.from_xml_path(model)
state = mujoco.MjData(bare)
log = np.load(recording)
state.qpos[:] = log["position"][0]
state.qvel[:] = (log["position"][40] - log["position"][0]) / (log["time"][40] - log["time"][0])
off, added, last = [], [], 0.0
for k in range(log["time"].size - 1):
    error = log["position"][k] - state.qpos[0]
    period = log["time"][k + 1] - log["time"][k]
    more = float(stiffness) * error + float(damping) * (error - last) / period
    last = error
    off.append(error)
    added.append(more)
    state.ctrl[0] = log["command"][k] + more
    for _ in range(max(1, round(period / bare.opt.timestep))):
        mujoco.mj_step(bare, state)
rest = slice(len(off) // 10, None)  # chambers and velocities have settled
print(np.sqrt(np.mean(np.square(off[rest]))), np.sqrt(np.mean(np.square(added[rest]))))
"""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A machine to diagnose."""

    model: str  #: Name or file
    recordings: Mapping[str, Recording]  #: By name
    held: str  #: The recording that no fit sees
    hidden: str  #: What is hidden, in words
    joint: str  #: That is followed
    drive: str  #: Of the joint
    loop: tuple[float, float]  #: Command by error and by its rate
    left_out: tuple[str, ...] = ()  #: Effects that are not looked for
    unit: tuple[float, str] = (1e3, "mrad")  #: Of the joint, with the factor from SI


# Model, the joint that is followed, its drive, and the loop that corrects it.
_PENDULUM = {"model": str(PENDULUM.model), "joint": "hinge", "drive": "drive", "loop": (1.0, 0.1)}
# A positive command bends the knee back.
_KNEE = {"model": "knee_bench", "joint": "knee", "drive": "knee_valve", "loop": (-0.5, 0.0)}
# 3.3 rad/s, well damped, of 95 kg.
_EMPS = {"model": str(EMPS_MODEL), "joint": "slide", "drive": "drive", "loop": (2100.0, 1300.0)}


def known(name: str) -> str:
    """The name of a case, for argparse."""
    if name not in CASES:
        raise argparse.ArgumentTypeError(f"unknown case {name!r}; allowed: {', '.join(CASES)}")
    return name


def drawn(span: float, low: float, high: float) -> tuple[float, float, float]:
    """A torque of position: amplitude [N m], period [rad], phase."""
    rng = np.random.default_rng(7)
    amplitude = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    return amplitude, span * float(rng.uniform(0.2, 1.0)), float(rng.uniform(0.0, 2.0 * np.pi))


def case(name: str) -> Case:
    """One of `CASES`."""
    if name == "e0":
        logs = read_recordings(sorted(shared_data("rough_bench/e0").glob("*.parquet")))
        logs, (held, *_) = split_held_out("knee_bench", logs, [])
        hidden = "its own laws and parameters, no fault; no healthy recordings"
        return Case(recordings=logs, held=held, hidden=hidden, **_KNEE)
    if name == "torque":
        rng, plant = np.random.default_rng(7), FaultyBench()
        motions = references(rng, duration=8.0)
        span = max(m.max() for m in motions.values()) - min(m.min() for m in motions.values())
        force, period, phase = drawn(float(span), 1.5, 10.0)
        plant.fields.append(lambda q: force * np.sin(2.0 * np.pi * q / period + phase))
        logs = {name: plant.record(motion, rng) for name, motion in motions.items()}
        logs, (held, *_) = split_held_out("knee_bench", logs, [])
        hidden = f"{force:.1f} N m every {period:.2f} rad, not looked for"
        return Case(recordings=logs, held=held, hidden=hidden, left_out=EXCLUDED, **_KNEE)
    if name == "EMPS":
        return Case(
            recordings=emps(),
            held=EMPS_HELD_OUT,
            hidden="a measured axis; friction by direction not looked for",
            left_out=("asymmetric_friction",),
            unit=(1e3, "mm"),
            **_EMPS,
        )
    if name == "ripple":
        ripple = drawn(1.8, 0.15, 1.0)
        kinds = enumerate(("multisine", "fast", "slow", "stairs"))
        logs = {k: record(PENDULUM, k, Truth(ripple=ripple), seed=i) for i, k in kinds}
        hidden = f"{ripple[0]:.2f} N m every {ripple[1]:.2f} rad, not looked for"
        return Case(recordings=logs, held="slow", hidden=hidden, left_out=EXCLUDED, **_PENDULUM)
    logs = {
        kind: record(PENDULUM, kind, Truth(), seed=i, seconds=4.0)
        for i, kind in enumerate(("multisine", "fast", "slow"))
    }
    hidden = "nothing: a pendulum as its model"
    return Case(recordings=logs, held="slow", hidden=hidden, **_PENDULUM)


CASES = ("e0", "torque", "ripple", "EMPS", "nothing")


def plain(case: Case, model: Path, folder: Path) -> tuple[float, float]:
    """Deviation [m or rad] and correction [1] of a bare model along the held-out recording."""
    log, path = case.recordings[case.held], folder / "held.npz"
    columns = {
        "position": log[f"{case.joint}_position"],
        "command": log[f"{case.drive}_command"],
    }
    np.savez(path, time=log.time, **columns)
    arguments = [library_path(), model, path, *case.loop]
    done = subprocess.run(
        [sys.executable, "-c", _PLAIN, *map(str, arguments)],
        check=True,
        capture_output=True,
        text=True,
    )
    off, added = map(float, done.stdout.split())
    return off, added / float(np.std(columns["command"]))


def noise_levels(case: Case, model: Path) -> float:
    """Error of a model as it is written, in 0.3 s of the held-out recording."""
    problem = set_up(model, case.recordings, (case.held,), DiagnosisSettings())
    return float(np.sqrt(problem.noise_levels(Hypothesis())[problem.judged].mean()))


def run(name: str) -> dict[str, Any]:
    """Diagnoses a case by the command and runs what it wrote."""
    one = case(name)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        files = []
        for log, recording in one.recordings.items():
            files.append(folder / f"{Path(log).stem}.parquet")
            data.write(recording, files[-1])
        names = set(Library(Machine(one.model)).names) - set(one.left_out)
        command = ["diagnose", one.model, *map(str, files), "--out", str(folder / "out")]
        command += ["--held-out", Path(one.held).stem]
        for effect in sorted(names) if one.left_out else ():
            command += ["--effect", effect]
        _leglab(*command)
        said = json.loads((folder / "out" / "diagnosis.json").read_text())
        row = {
            "case": name,
            "hidden": one.hidden,
            "verdict": said["verdict"],
            "named": {e["name"]: e["confidence"] for e in said["effects"]},
            "learned": said["learned"],
            "model": said["model"],
            "before": said["gap"]["before"],
        }
        better = folder / "out" / "improved.xml"
        if not better.exists():
            return row
        row["after"] = noise_levels(one, better)
        original = folder / "original.xml"
        original.write_text(to_xml(Machine(one.model).spec()))
        row["plain"] = [plain(one, m, folder) for m in (original, better)]
        row["unit"] = list(one.unit)
        if one.model == "knee_bench":
            runs = folder / "run"
            _leglab("run", "nominal", "--model", str(better), "--duration", "4", "--out", str(runs))
            metrics = json.loads((runs / "metrics.json").read_text())
            row["run"] = 1e3 * metrics["phases"][0]["rms_rad"]["knee"]
        return row


def _leglab(*arguments: str) -> None:
    """Runs the command; what it says on stderr is shown, its failure ends the benchmark."""
    command = [sys.executable, "-m", "leglab", *arguments]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def tables(rows: list[dict[str, Any]]) -> str:
    """A row a case."""
    shown = []
    for row in rows:
        named = [f"{name} {sure:.2f}" for name, sure in row["named"].items()] or ["no name"]
        said = [", ".join(named), *([row["learned"]] if row["learned"] else [])]
        start = [row["case"], row["hidden"], row["verdict"], "; ".join(said)]
        if "after" not in row:
            shown.append([*start, f"{row['before']:.3g}; no file is written", "", "", ""])
            continue
        factor, unit = row["unit"]
        (off, added), (off_after, added_after) = row["plain"]
        ran = "" if "run" not in row else f"4 s, {row['run']:.1f} mrad off the reference"
        shown.append(
            [
                *start,
                f"{row['before']:.3g} > {row['after']:.3g}",
                f"{factor * off:.3g} > {factor * off_after:.3g} {unit}",
                f"{100.0 * added:.3g} > {100.0 * added_after:.3g} %",
                ran,
            ]
        )
    return results.table(HEAD, shown)


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """The cases given, or all."""
    return [run(name) for name in options.cases]


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("cases", nargs="*", type=known, default=CASES)
