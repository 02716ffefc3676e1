"""Motors and machines unlike their models.

A rotor, a servo with a link and an arm of two joints (rigs/rough.py) draw their masses,
friction laws, lags, gears' teeth and encoders. Hidden in each is a fault, one in either end joint,
two in either end joint, more inertia with more drag, which a weak drive imitates, or nothing.
"""

import argparse
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from benchmarks import results
from leglab.diagnosis.search.pipeline import DiagnosisSettings
from leglab.diagnosis.verdict.verdict import diagnose
from rigs.rough import RIGS, RoughRig, faults_of, hide, machine, record_rough

HEAD = ("machine", "hidden", "verdict", "named, confidence", "explained", "noise levels", "s")
# Of seven cases in turn: so many faults of either end joint, or these.
_IMITATED = ("armature", "viscous_friction")
_HIDDEN: tuple[int | tuple[str, ...], ...] = (1, 1, 2, 1, 0, 4, _IMITATED)


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
    rig = RIGS[name]
    rng = np.random.default_rng([seed, sorted(RIGS).index(rig.model.stem), number])
    values, faults = machine(rig, rng), drawn(rig, number, rng)
    sizes = [hide(rig, values, *told, rng) for told in faults]
    (recordings,) = record_rough(rig, [values], seed=int(rng.integers(1 << 30)))
    result, _ = diagnose(rig.model, recordings, settings=DiagnosisSettings(threads=1))
    return {
        "machine": rig.model.stem,
        "hidden": [
            {
                "name": name,
                "joint": rig.joints[joint],
                "elements": _elements(rig, joint),
                "size": size,
            }
            for (name, joint), size in zip(faults, sizes, strict=True)
        ],
        "verdict": result.verdict,
        "named": [
            {
                "name": e.name,
                "element": e.element,
                "confidence": e.confidence,
                "tied": e.indistinguishable_from,
            }
            for e in result.effects
        ],
        "explained": result.gap.explained,
        "before": result.gap.before,
        "after": result.gap.after,
        "wall_s": result.seconds,
    }


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """All cases of all machines."""
    cases = [(name, n, options.seed) for n in range(options.cases) for name in RIGS]
    return results.resumed(run, cases, folder=options.out, jobs=options.jobs)


def _elements(rig: RoughRig, joint: int) -> list[str]:
    """What a fault of a joint may sit on: the joint, its drive, its body."""
    model = mujoco.MjModel.from_xml_path(str(rig.model))
    body = model.body(int(model.joint(rig.joints[joint]).bodyid[0]))
    return [rig.joints[joint], rig.drives[joint], body.name]


def summary(rows: list[dict[str, Any]]) -> list[tuple[str, str]]:
    """What was asked of the names, and how often it holds."""
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
    return f"{sum(held)} of {len(held)}"


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
    return (
        f"{results.table(('question', 'reached'), summary(rows))}\n\n{results.table(HEAD, shown)}"
    )


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--cases", type=int, default=14, help="of each machine")
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=2, help="cases at a time")
    parser.add_argument("--out", type=Path, help="keeps each case; an interrupted run goes on")
