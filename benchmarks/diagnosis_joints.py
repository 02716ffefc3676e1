"""Faults in joints of four machines: named first, at the right joint?

A fault in one joint of leglab's own leg is recorded by its own model at a tenth of its step: three
recordings of strides, two of random strides, each of 8 s at 500 Hz. A rotor, a servo with a link
and an arm of two joints (rigs/rough.py) draw their masses, friction laws, lags, gears' teeth and
encoders; hidden in each is a fault, one in either end joint, two in either end joint, more inertia
with more drag, which a weak drive imitates, or nothing. An interrupted call goes on.
"""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import mujoco
import numpy as np
from scipy.stats import binomtest

from benchmarks import results
from benchmarks.self_test.command import diagnosed
from leglab import RunSettings, run_scenario
from leglab.base.recording import Recording
from leglab.base.scenario import Options, ParameterChange, register_scenario
from leglab.diagnosis.plant.model import Machine
from rigs.rough import RIGS, RoughRig, faults_of, hide, machine, record_rough

HEAD = ("machine", "hidden", "verdict", "named, confidence", "explained", "noise levels", "s")
MOTIONS = ("walking_stride", "random_stride", "walking_stride", "random_stride", "walking_stride")
DURATION, STEP = 8.0, 1e-4  # s
# Of seven cases of a rough machine in turn: so many faults of either end joint, or these.
_IMITATED = ("armature", "viscous_friction")
_HIDDEN: tuple[int | tuple[str, ...], ...] = (1, 1, 2, 1, 0, 4, _IMITATED)


@dataclass(frozen=True)
class Fault:
    """Parameters of a joint's cylinder, spring ("spring") or encoder ("") that change together."""

    part: str  #: Suffix of the element
    parameters: tuple[str, ...]  #: Names
    kind: str  #: "scale", "set", or "add" for a difference to what the model has
    low: float  #: Smallest size, log-uniform
    high: float  #: Largest
    signed: bool = False  #: Whether either sign is drawn


FAULTS = {
    "internal_leakage": Fault("valve", ("internal_leakage",), "scale", 3.0, 30.0),
    "external_leakage": Fault("valve", ("external_leakage_a",), "set", 3e-13, 3e-12),
    "valve_deadband": Fault("valve", ("lap",), "set", 0.035, 0.08),
    "valve_hysteresis": Fault("valve", ("hysteresis",), "set", 0.01, 0.05),
    "valve_bias": Fault("valve", ("null_bias",), "set", 0.015, 0.05, signed=True),
    "valve_bandwidth": Fault("valve", ("bandwidth_hz",), "set", 20.0, 70.0),
    "valve_gain": Fault("valve", ("rated_flow",), "scale", 0.65, 0.88),
    "viscous_friction": Fault("valve", ("viscous",), "scale", 1.8, 5.0),
    "coulomb_friction": Fault("valve", ("coulomb", "static"), "add", 60.0, 300.0),
    "stiction": Fault("valve", ("static",), "scale", 1.6, 3.0),
    "spring_stiffness": Fault("spring", ("k1",), "scale", 0.3, 0.7),
    "entrained_air": Fault("valve", ("entrained_air",), "scale", 3.0, 10.0),
    "encoder_offset": Fault("", ("encoder_offset",), "set", 0.015, 0.08, signed=True),
}


def drawn(rig: RoughRig, number: int, rng: np.random.Generator) -> list[tuple[str, int]]:
    """The faults of a case, and the joint of each."""
    hidden, last = _HIDDEN[number % len(_HIDDEN)], len(rig.joints) - 1
    if isinstance(hidden, tuple):
        return [(name, last) for name in hidden]
    # A single joint bears no four at once.
    count = min(hidden, 2 * len(rig.joints))
    faults = [str(name) for name in rng.choice(faults_of(rig), count, replace=False)]
    joints = sorted([0, last] * (count // 2)) if count > 1 else [int(rng.integers(last + 1))]
    # A payload is carried by the last link.
    own = [last if name == "payload" else j for name, j in zip(faults, joints[:count], strict=True)]
    return list(zip(faults, own, strict=True))


def run(case: tuple[str, int, int]) -> dict[str, Any]:
    """One row: of a machine by name, the case's number and the seed."""
    name, number, seed = case
    rng = np.random.default_rng([seed, ["leg", *sorted(RIGS)].index(name), number])
    model: Any = "leg"
    if name == "leg":
        recordings, hidden = _leg(number, rng)
    else:
        rig = RIGS[name]
        model, values, faults = rig.model, machine(rig, rng), drawn(rig, number, rng)
        sizes = [hide(rig, values, *told, rng) for told in faults]
        (recordings,) = record_rough(rig, [values], seed=int(rng.integers(1 << 30)))
        hidden = [
            {"name": n, "joint": rig.joints[j], "elements": _elements(rig, j), "size": size}
            for (n, j), size in zip(faults, sizes, strict=True)
        ]
    began = perf_counter()
    content = diagnosed(model, recordings)
    return {
        "machine": name,
        "hidden": hidden,
        "verdict": content["verdict"],
        "named": [
            {
                "name": e["name"],
                "element": e["element"],
                "confidence": e["confidence"],
                "tied": e["indistinguishable_from"],
            }
            for e in content["effects"]
        ],
        "explained": content["explained"],
        "before": content["gap"]["before"],
        "after": content["gap"]["after"],
        "wall_s": perf_counter() - began,
    }


def _leg(
    number: int, rng: np.random.Generator
) -> tuple[Mapping[str, Recording], list[dict[str, Any]]]:
    """Recordings of the leg with a fault from the start, and what it is; each 14th has none."""
    effect = [*FAULTS, ""][number % (len(FAULTS) + 1)]
    changes: list[ParameterChange] = []
    hidden = []
    if effect:
        fault, leg = FAULTS[effect], Machine("leg")
        able = [j for j in leg.joints if fault.part != "spring" or j != "hip_yaw"]
        joint = able[int(rng.integers(len(able)))]
        size = float(np.exp(rng.uniform(np.log(fault.low), np.log(fault.high))))
        size *= float(rng.choice((-1.0, 1.0))) if fault.signed else 1.0
        element, add = f"{joint}_{fault.part}".rstrip("_"), fault.kind == "add"
        for name in fault.parameters:
            value = size + (leg.parameter(element, name) if add else 0.0)
            kind = "set" if add else fault.kind
            changes.append(
                ParameterChange(parameter=name, element=element, kind=kind, value=value, start=0.0)
            )
        elements = [joint, *(f"{joint}_{part}" for part in ("valve", "spring"))]
        hidden = [{"name": effect, "joint": joint, "elements": elements, "size": size}]
    scenario = f"case_{number}"

    @register_scenario(scenario, summary="a fault that is there from the start", duration=DURATION)
    def _(options: Options) -> tuple[ParameterChange, ...]:
        return tuple(changes)

    found = {}
    for i, motion in enumerate(MOTIONS):
        settings = RunSettings(
            scenario=scenario, reference=motion, seed=100 * number + i, timestep=STEP, vary=True
        )
        found[f"{motion} {i}"] = run_scenario(settings).recording
    return found, hidden


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """All cases of all machines."""
    cases = [(m, n, options.seed) for n in range(options.cases) for m in options.machines]
    return results.resumed(run, cases, folder=options.out, jobs=options.jobs)


def _elements(rig: RoughRig, joint: int) -> list[str]:
    """Elements on which a fault of a joint may sit: the joint, its drive, its body."""
    model = mujoco.MjModel.from_xml_path(str(rig.model))
    body = model.body(int(model.joint(rig.joints[joint]).bodyid[0]))
    return [rig.joints[joint], rig.drives[joint], body.name]


def summary(rows: list[dict[str, Any]]) -> list[tuple[str, str]]:
    """Requirements on the names, and how often they hold."""
    single = [row for row in rows if len(row["hidden"]) == 1]
    several = [row for row in rows if len(row["hidden"]) > 1]
    nothing = [row for row in rows if not row["hidden"]]

    def first(row: dict[str, Any], sure: float = 0.0) -> bool:
        return any(_right(e, row) and e["confidence"] >= sure for e in row["named"][:1])

    def among(row: dict[str, Any], hidden: dict[str, Any]) -> bool:
        return any(
            hidden["name"] in (e["name"], *e["tied"]) and e["element"] in hidden["elements"]
            for e in row["named"]
        )

    def wrong(row: dict[str, Any]) -> bool:
        return any(not _right(e, row) and e["confidence"] > 0.8 for e in row["named"])

    claims = [_right(e, row) for row in rows for e in row["named"] if e["confidence"] >= 0.9]
    return [
        ("one fault: right name and joint first", _share([first(row) for row in single])),
        ("... with confidence 0.8 or more", _share([first(row, 0.8) for row in single])),
        ("... named, or not told apart", _share([among(r, *r["hidden"]) for r in single])),
        ("... a wrong name above 0.8", _share([wrong(row) for row in single])),
        ("several faults: a right name first", _share([first(row) for row in several])),
        (
            "... of all of them named, or not told apart",
            _share([among(row, hidden) for row in several for hidden in row["hidden"]]),
        ),
        ("... a wrong name above 0.8", _share([wrong(row) for row in several])),
        (
            "nothing hidden: a name above 0.5",
            _share([any(e["confidence"] > 0.5 for e in row["named"]) for row in nothing]),
        ),
        ("names given with 0.9 or more that are right", _share(claims)),
    ]


def _right(effect: dict[str, Any], row: dict[str, Any]) -> bool:
    return any(
        effect["name"] == hidden["name"] and effect["element"] in hidden["elements"]
        for hidden in row["hidden"]
    )


def _share(held: list[bool]) -> str:
    if not held:
        return "0 of 0"
    low, high = binomtest(sum(held), len(held)).proportion_ci(method="wilson")
    return f"{sum(held)} of {len(held)} ({low:.0%} to {high:.0%})"


def tables(rows: list[dict[str, Any]]) -> str:
    """How often names are right, then a row a case."""
    shown = [
        (
            row["machine"],
            ", ".join(f"{h['name']} {h['size']:.2g} at {h['joint']}" for h in row["hidden"])
            or "nothing",
            row["verdict"],
            "; ".join(
                f"{e['name']} at {e['element']} {e['confidence']:.2f}"
                + (f" (or {', '.join(e['tied'])})" if e["tied"] else "")
                for e in row["named"]
            )
            or "nothing",
            "" if row["explained"] is None else f"{row['explained']:.2f}",
            f"{row['before']:.3g} > {row['after']:.3g}",
            f"{row['wall_s']:.0f}",
        )
        for row in rows
    ]
    asked = results.table(("question", "reached (95 % interval)"), summary(rows))
    return f"{asked}\n{results.table(HEAD, shown)}"


def add_options(parser: argparse.ArgumentParser) -> None:
    known = ["leg", *RIGS]
    parser.add_argument("--machines", nargs="+", choices=known, default=known)
    parser.add_argument("--cases", type=int, default=14, help="of each machine")
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=2, help="cases at a time")
    parser.add_argument("--out", type=Path, help="keeps each case; an interrupted run goes on")
