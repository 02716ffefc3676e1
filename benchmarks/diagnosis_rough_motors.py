"""Motors and machines unlike their models: `python benchmarks/diagnosis_rough_motors.py`.

A rotor, a servo with a link and an arm of two joints (tests/rigs/rough.py) draw their masses,
friction laws, lags, gears' teeth and encoders; a fault, one in either end joint, or nothing is
hidden in each.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
import results

from leglab.diagnosis.verdict import diagnose
from leglab.diagnosis.workflow import DiagnosisSettings

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.rigs.rough import RIGS, faults_of, hide, machine, record_rough

HEAD = ("machine", "hidden", "verdict", "named, confidence", "explained", "noise levels", "s")
# Of five cases in turn: how many faults.
_HIDDEN = (1, 1, 2, 1, 0)


def run(case: tuple[str, int, int]) -> dict[str, Any]:
    """One row: of a machine by name, the case's number and the seed."""
    name, number, seed = case
    rig = RIGS[name]
    rng = np.random.default_rng([seed, sorted(RIGS).index(rig.model.stem), number])
    values, last = machine(rig, rng), len(rig.joints) - 1
    count = _HIDDEN[number % len(_HIDDEN)]
    faults = [str(name) for name in rng.choice(faults_of(rig), count, replace=False)]
    joints = [int(rng.integers(last + 1))] if count == 1 else [0, last][:count]
    sizes = [hide(rig, values, *told, rng) for told in zip(faults, joints, strict=True)]
    (recordings,) = record_rough(rig, [values], seed=int(rng.integers(1 << 30)))
    result, _ = diagnose(rig.model, recordings, settings=DiagnosisSettings(threads=1))
    return {
        "machine": rig.model.stem,
        "hidden": [
            {"name": name, "joint": rig.joints[joint], "size": size}
            for name, joint, size in zip(faults, joints, sizes, strict=True)
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


def summary(rows: list[dict[str, Any]]) -> list[tuple[str, str]]:
    """What was asked of the names, and how often it holds."""
    names = [{h["name"] for h in row["hidden"]} for row in rows]
    single = [(row, n) for row, n in zip(rows, names, strict=True) if len(n) == 1]
    pairs = [(row, n) for row, n in zip(rows, names, strict=True) if len(n) == 2]
    null = [row for row, n in zip(rows, names, strict=True) if not n]

    def first(row: dict[str, Any], hidden: set[str], sure: float = 0.0) -> bool:
        return any(e["name"] in hidden and e["confidence"] >= sure for e in row["named"][:1])

    def among(row: dict[str, Any], name: str) -> bool:
        return any(name in (e["name"], *e["tied"]) for e in row["named"])

    claims = [
        (e["name"] in hidden)
        for row, hidden in zip(rows, names, strict=True)
        for e in row["named"]
        if e["confidence"] >= 0.9
    ]
    return [
        ("one fault: right name first", _share([first(*one) for one in single])),
        ("... with confidence 0.8 or more", _share([first(*one, 0.8) for one in single])),
        ("... named, or not told apart", _share([among(r, *n) for r, n in single])),
        (
            "... a wrong name above 0.8",
            _share(
                [
                    any(e["name"] not in n and e["confidence"] > 0.8 for e in r["named"])
                    for r, n in single
                ]
            ),
        ),
        ("two faults: a right name first", _share([first(*one) for one in pairs])),
        (
            "... both named, or not told apart",
            _share([all(among(r, x) for x in n) for r, n in pairs]),
        ),
        (
            "nothing hidden: a name above 0.5",
            _share([any(e["confidence"] > 0.5 for e in r["named"]) for r in null]),
        ),
        ("names given with 0.9 or more that are right", _share(claims)),
    ]


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


def main() -> None:
    """Runs the cases, or prints what is kept."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--cases", type=int, default=10, help="of each machine")
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=2, help="cases at a time")
    parser.add_argument("--out", type=Path, help="keeps each case; an interrupted run goes on")
    results.main(
        parser,
        lambda options: results.resumed(
            run,
            [(name, n, options.seed) for n in range(options.cases) for name in RIGS],
            folder=options.out,
            jobs=options.jobs,
        ),
        tables,
    )


if __name__ == "__main__":
    main()
