"""One hinge at a tenth and a hundred times its inertia.

The machine is the pendulum of rigs, an arm on a geared motor with an encoder, and its copies
are of other density: lengths, times and angles stay; masses, inertias, damping, motor torque, the
gains of its loop and all forces of a fault are multiplied by the scale. So the copies move alike,
with the same noise of the encoder [rad], and their commands [N m] alone differ, by the scale. What
a diagnosis says of them differs only where a number in its code has a unit, or by rounding.

Hidden is one effect at a time, ten times as large as on the rough bench of the same arm
(rigs/rough.py, the geometric middle of what it draws; for what that bench lacks, of the knee
bench's or the rigs'), or the largest one with which the machine still works, which `EFFECTS` says.
`base_tilt` is left out: on one hinge without a spring it is `encoder_offset`, up to the 0.6 rad
that it may be at most and that the offset hidden here is beyond. A late command and a late encoder
are the same motion as well, so that no recording of this machine tells them apart.
"""

import argparse
import math
import sys
import textwrap
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import mujoco
from matplotlib.figure import Figure

from benchmarks import results
from benchmarks.self_test.command import diagnosed
from benchmarks.self_test.outcomes import TIMEOUT, lines
from leglab.base.errors import SimulationError
from leglab.base.output import write_atomically
from leglab.jobs.engine import executor, make_missing
from leglab.report.style import DARK_GREY, LIGHT_GREY, SERIES, VERMILION, style
from rigs import PENDULUM
from rigs.hinge import record_hinge
from rigs.rough import FAULTS, SERVO_LINK

KINDS = ("multisine", "fast", "slow", "stairs")
SURE = 0.8
_HIGH = 0.95  # lines above lie on each other


def _middle(name: str) -> float:
    low, high, _ = FAULTS[name]
    return math.sqrt(low * high)


_TORQUE, _DRY, _DAMPING = SERVO_LINK.torque[0], SERVO_LINK.coulomb[0], SERVO_LINK.damping[0]
_INERTIA, _FASTEST = PENDULUM.load + PENDULUM.motor, 5.0 * SERVO_LINK.reach[0]
# By effect: what `record_hinge` calls it, its size on the bench [SI units], how many times as large
# it is here, and the power of the scale that it grows with.
EFFECTS: dict[str, tuple[str, float, float, int]] = {
    "viscous_friction": ("viscous", _middle("viscous_friction") * _DAMPING, 10, 1),
    "coulomb_friction": ("coulomb", _middle("coulomb_friction") * _DRY, 10, 1),
    "asymmetric_friction": ("forward", _middle("asymmetric_friction") * _DRY, 10, 1),
    "stiction": ("breakaway", _middle("stiction") * _DRY, 10, 1),
    # A gear that takes all of the motor's torque would lock itself; this one takes a half.
    "load_dependent_friction": ("loss", _middle("load_dependent_friction"), 3.2, 0),
    "quadratic_damping": ("quadratic", _middle("quadratic_damping") * _TORQUE / _FASTEST**2, 10, 1),
    "armature": ("armature", _middle("armature") * _INERTIA, 10, 1),
    "payload": ("payload", _middle("payload") * SERVO_LINK.links[0][0], 10, 1),
    "spring_stiffness": ("stiffness", _middle("spring_stiffness") * _TORQUE, 10, 1),
    "spring_hardening": ("cubic", _middle("spring_stiffness") * _TORQUE, 10, 1),
    "cogging": ("ripple", _middle("cogging") * _TORQUE, 10, 1),
    "backlash": ("play", 0.022, 10, 0),  # rad
    "joint_flexibility": ("compliance", 1.0 / 60.0, 10, -1),  # rad/(N m), the rigs' test
    "force_offset": ("force", _middle("force_offset") * _TORQUE, 10, 1),
    "actuator_gain": ("gain", _middle("actuator_gain"), 10, 0),  # added to 1
    "encoder_offset": ("offset", _middle("encoder_offset"), 10, 0),  # rad
    "encoder_scale": ("scale", _middle("encoder_scale"), 10, 0),  # added to 1
    "sensor_delay": ("late", _middle("command_delay"), 10, 0),  # s
    # Of a delay beyond seven times the loop swings itself up.
    "command_delay": ("delay", _middle("command_delay"), 5, 0),  # s
    "command_deadband": ("dead", _middle("command_deadband") * _TORQUE, 10, 1),
    "command_hysteresis": ("hysteresis", 0.022 * PENDULUM.limit, 10, 1),  # the valves' of full
    "command_bandwidth": ("lag", 0.0053, 10, 0),  # s, a valve at 30 of 250 Hz
}


def size(effect: str, scale: float) -> float:
    """Of the hidden effect on a copy of that inertia [SI units]."""
    _, bench, times, power = EFFECTS[effect]
    return bench * times * scale**power


def model(scale: float) -> str:
    """MJCF of a copy."""
    spec = mujoco.MjSpec.from_file(str(PENDULUM.model))
    arm, joint, drive = spec.body("arm"), spec.joint(PENDULUM.joint), spec.actuator("drive")
    arm.mass, arm.inertia = scale * arm.mass, scale * arm.inertia
    joint.armature, joint.damping = scale * joint.armature, scale * joint.damping
    drive.ctrlrange = scale * drive.ctrlrange
    spec.compile()
    return str(spec.to_xml())


def run(given: dict[str, Any]) -> dict[str, Any]:
    """One row, of `effect` and `scale`; the copy's model is kept in `folder`."""
    effect, scale = given["effect"], given["scale"]
    path = Path(given["folder"]) / f"hinge_{scale:g}.xml"
    write_atomically(path, lambda file: file.write(model(scale).encode()))
    hidden = {EFFECTS[effect][0]: size(effect, scale)}
    logs = {k: record_hinge(k, hidden, scale=scale, seed=i) for i, k in enumerate(KINDS)}
    began = perf_counter()
    content = diagnosed(path, logs)
    named, gap = content["effects"], content["gap"]
    sure = [e["confidence"] for e in named if e["name"] == effect]
    told = [[e["name"], e["confidence"], e["indistinguishable_from"]] for e in named]
    values = [[e["name"], p, v["value"]] for e in named for p, v in e["parameters"].items()]
    row = {"effect": effect, "scale": scale, "size": size(effect, scale), "named": told}
    row |= {"verdict": content["verdict"], "confidence": max(sure, default=0.0), "values": values}
    row |= {"explained": content["explained"], "before": gap["before"], "after": gap["after"]}
    row |= {"seconds": perf_counter() - began}
    return {**results.rounded(row), "sets": content["sets"]}


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Makes the rows that the file lacks, adds each to it, and draws all that were asked for."""
    cases = [(effect, scale) for scale in options.scales for effect in options.effects]
    rows = lines(options.out, lambda row: (row["effect"], row["scale"]))
    problems = make_missing(
        executor(run, options.jobs, timeout=TIMEOUT),
        cases,
        rows,
        lambda case: {"effect": case[0], "scale": case[1], "folder": str(options.out.parent)},
        progress=lambda done, total, last: print(f"{done} of {total} {last}", file=sys.stderr),
    )
    for case, problem in problems.items():
        raise SimulationError(f"case {case}: {problem}")
    asked = [{k: v for k, v in rows[case].items() if k != "sets"} for case in cases]
    with style():
        path = options.figure or options.out.with_suffix(".png")
        write_atomically(path, partial(figure(asked).savefig, format="png"))
    return asked


def right(row: dict[str, Any]) -> bool:
    """Whether the hidden effect is named first, and surely enough."""
    return _first(row) and row["confidence"] >= SURE


def _first(row: dict[str, Any]) -> bool:
    return bool(row["named"]) and row["named"][0][0] == row["effect"]


def tables(rows: list[dict[str, Any]]) -> str:
    """Effect by scale, then what was said where it was not the hidden effect alone, surely."""
    scales = sorted({row["scale"] for row in rows})
    cells = {(row["effect"], row["scale"]): row for row in rows}
    shown = []
    for effect in dict.fromkeys(row["effect"] for row in rows):
        line = [f"`{effect}`", f"{size(effect, 1.0):.2g}", f"{EFFECTS[effect][2]:g}"]
        for row in (cells.get((effect, scale)) for scale in scales):
            first = "first, " if row and _first(row) else ""
            line.append(f"{first}{row['confidence']:.2f}, {row['seconds']:.0f} s" if row else "")
        shown.append(line)
    for words, most in ((f"first, {SURE:g} or more", 9), ("... and no other name", 1)):
        kept = [row for row in rows if right(row) and len(row["named"]) <= most]
        counts = [[sum(r["scale"] == one for r in of) for of in (kept, rows)] for one in scales]
        shown.append([words, "", "", *(f"{count} of {among}" for count, among in counts)])
    missed = [
        (
            f"`{row['effect']}`",
            f"{row['scale']:g}",
            row["verdict"],
            "; ".join(
                f"{name} {sure:.2f}" + (f" (or {', '.join(tied)})" if tied else "")
                for name, sure, tied in row["named"]
            ),
            results.number(row["explained"], 2),
            f"{results.number(row['before'])} > {results.number(row['after'])}",
        )
        for row in rows
        if not right(row) or len(row["named"]) > 1
    ]
    head = (
        "effect",
        "size",
        "times the bench's",
        *(f"scale {scale:g}: confidence" for scale in scales),
    )
    misses = ("hidden", "scale", "verdict", "named", "explained", "noise levels")
    return f"{results.table(head, shown)}\n{results.table(misses, missed)}"


def figure(rows: list[dict[str, Any]]) -> Figure:
    """Confidence of the hidden effect's name against scale, a line an effect."""
    drawn = Figure(figsize=(7.2, 5.2))
    axes = drawn.add_axes((0.08, 0.24, 0.68, 0.67))
    lines: dict[str, list[tuple[float, float]]] = {}
    for row in sorted(rows, key=lambda row: row["scale"]):
        lines.setdefault(row["effect"], []).append((row["scale"], row["confidence"]))
    same = sorted(e for e, line in lines.items() if min(y for _, y in line) >= _HIGH)
    for effect in same:
        axes.plot(*zip(*lines[effect], strict=True), color=LIGHT_GREY, marker="o", clip_on=False)
    beside = {row["effect"] for row in rows if len(row["named"]) > 1}
    listed = ", ".join(f"{effect}*" if effect in beside else effect for effect in same)
    note = " (* beside a false name)" if beside.intersection(same) else ""
    listed = textwrap.fill(f"Grey, {_HIGH:g} or more at all scales: {listed}{note}", 105)
    drawn.text(0.08, 0.02, listed, va="bottom", color=DARK_GREY, size=8)
    place = 1.0
    own = sorted(lines.keys() - same, key=lambda effect: -lines[effect][-1][1])
    for effect, ink in zip(own, [VERMILION, *SERIES] * len(own), strict=False):
        x, y = zip(*lines[effect], strict=True)
        axes.plot(x, y, color=ink, marker="o", clip_on=False)
        place = min(place, y[-1] + 0.02)  # a line of text apart
        axes.annotate(
            effect,
            (x[-1], y[-1]),
            xytext=(1.06, place),
            textcoords=axes.get_yaxis_transform(),
            va="center",
            color=ink,
            arrowprops={"arrowstyle": "-", "color": ink, "linewidth": 0.5, "relpos": (0.0, 0.5)},
        )
        place -= 0.05
    axes.axhline(SURE, color=DARK_GREY, linewidth=0.6, linestyle=(0, (4, 3)))
    axes.set(xscale="log", ylim=(-0.02, 1.02), xlabel="inertia over that of the rig")
    axes.set_xticks(sorted({row["scale"] for row in rows}), minor=False)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()
    axes.set_ylabel("confidence of the hidden effect's name")
    drawn.text(0.08, 0.95, "One hinge in three sizes, one effect hidden at a time", fontsize=10)
    return drawn


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--scales", type=float, nargs="+", default=[1.0, 0.1, 100.0])
    parser.add_argument("--effects", nargs="+", choices=EFFECTS, default=list(EFFECTS))
    parser.add_argument("--out", type=Path, default=Path("runs/diagnosis_scales/cases.jsonl"))
    parser.add_argument("--jobs", type=int, default=1, help="cases at a time")
    parser.add_argument("--figure", type=Path, help="PNG; default: beside the cases")
