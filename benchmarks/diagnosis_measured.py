"""Measured machines that nobody built the diagnosis for: `python benchmarks/diagnosis_measured.py`.

Each case of `data/measured` goes through `leglab diagnose` as a user calls it, within a time; page
and verdict of each are kept below `--out`. The recordings are looked for in $LEGLAB_DATA and
../shared/data.
"""

import argparse
import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import results

from leglab.studies.shared_data import shared_data

HEAD = ("machine", "known", "said", "names and sets", "judged", "s")
# A name above this is held to be true.
SURE = 0.5


@dataclass(frozen=True, kw_only=True)
class Case:
    """A measured machine.

    Attributes:
        name: What it is.
        model: File below `data/measured`.
        recordings: Pattern of their files, and how many of them.
        healthy: The same of recordings before it changed; None for none.
        known: What is known to be missing, in words.
        causes: Effects that are right, each with the elements where; none for nothing.
    """

    name: str
    model: str
    recordings: tuple[str, int]
    healthy: tuple[str, int] | None
    known: str
    causes: dict[str, tuple[str, ...]]


_JOINTS = ("thigh", "calf", "every")
_RESISTS = {"viscous_friction": ("rod",), "coulomb_friction": ("rod",)}
_LEG = {
    "armature": _JOINTS,
    "viscous_friction": ("hip", *_JOINTS),
    "coulomb_friction": _JOINTS,
    "sensor_delay": ("hip", *_JOINTS),
    "command_delay": ("hip", *_JOINTS),
}
_ARM = {"command_delay": ("",), "command_bandwidth": ("",), "sensor_delay": ("",)}
CASES = (
    Case(
        name="damper, 1 A",
        model="mr_damper/resists.xml",
        recordings=("sine_*_1A", 99),
        healthy=("sine_*_0A", 99),
        known="Coulomb friction six to nine times, viscous friction",
        causes=_RESISTS,
    ),
    Case(
        name="damper, 0.5 A",
        model="mr_damper/resists.xml",
        recordings=("sine_*_0x5A", 99),
        healthy=("sine_*_0A", 99),
        known="Coulomb friction four to six times, viscous friction",
        causes=_RESISTS,
    ),
    Case(
        name="damper, 1 A, no healthy recordings",
        model="mr_damper/resists.xml",
        recordings=("sine_*_1A", 99),
        healthy=None,
        known="Coulomb and viscous friction",
        causes=_RESISTS,
    ),
    Case(
        name="robot dog, front left leg",
        model="robot_dog/FL.xml",
        recordings=("FL_*", 99),
        healthy=None,
        known="less damping, more armature, friction of the calf, a delay",
        causes=_LEG,
    ),
    Case(
        name="robot dog, rear right leg",
        model="robot_dog/RR.xml",
        recordings=("RR_*", 99),
        healthy=None,
        known="less damping, more armature, friction of the calf, a delay",
        causes=_LEG,
    ),
    Case(
        name="six-servo arm",
        model="servo_arm/so101.xml",
        recordings=("*", 99),
        healthy=None,
        known="delay of 0.06 to 0.14 s or a lag, on all joints; sag",
        causes=_ARM,
    ),
    Case(
        name="rotary actuator, bad seal",
        model="rotary/rotary.xml",
        recordings=("butterfly_seal_*", 6),
        healthy=("butterfly_healthy_*", 6),
        known="less resistance, other specimen",
        causes={
            "viscous_friction": ("",),
            "coulomb_friction": ("",),
        },
    ),
    Case(
        name="rotary actuator, unchanged",
        model="rotary/rotary.xml",
        recordings=("free_healthy_b_*", 6),
        healthy=("free_healthy_a_*", 6),
        known="nothing changed",
        causes={},
    ),
)


def files(case: Case, pattern: tuple[str, int]) -> list[str]:
    """Recordings of a pattern."""
    folder = shared_data(f"measured/{Path(case.model).parent}")
    return [str(p) for p in sorted(folder.glob(f"{pattern[0]}.parquet"))[: pattern[1]]]


def run(case: Case, out: Path, patience: float) -> dict[str, Any]:
    """One row: what the command said, within a time [s]."""
    folder = out / case.name.replace(",", "").replace(" ", "_")
    model = str(shared_data(f"measured/{case.model}"))
    healthy = [f"--healthy={f}" for f in files(case, case.healthy)] if case.healthy else []
    command = ["leglab", "diagnose", model, *files(case, case.recordings), *healthy]
    began = perf_counter()
    try:
        subprocess.run(
            [*command, "--out", str(folder), "--overwrite"],
            check=True,
            capture_output=True,
            timeout=patience,
        )
    except subprocess.TimeoutExpired:
        return {"case": case.name, "verdict": "none in time", "wall_s": patience, "said": []}
    found = json.loads((folder / "diagnosis.json").read_text())
    print(f"{case.name}: {found['verdict']}", file=sys.stderr, flush=True)
    said = [(e["name"], e["element"], e["confidence"]) for e in found["effects"]]
    said += [(name, "", None) for e in found["effects"] for name in e["indistinguishable_from"]]
    wall = perf_counter() - began
    return {"case": case.name, "verdict": found["verdict"], "wall_s": wall, "said": said}


def judged(case: Case, row: dict[str, Any]) -> str:
    """Whether what was said is right."""

    def right(name: str, element: str) -> bool:
        places = case.causes.get(name, ())
        return any(part in element for part in places) or bool(places and not element)

    surely = [(n, e) for n, e, c in row["said"] if c is not None and c > SURE]
    if any(not right(n, e) for n, e in surely):
        return "wrong name"
    if row["verdict"] == "nothing_missing":
        return "wrong" if case.causes else "right"
    if surely:
        return "right"
    if any(right(n, e) for n, e, _ in row["said"]):
        return "a right cause in the set"
    return "abstained" if row["verdict"] in ("unexplained", "none in time") else "wrong set"


def tables(rows: list[dict[str, Any]]) -> str:
    """A row a case."""
    cases = {case.name: case for case in CASES}
    shown = []
    for row in rows:
        case = cases[row["case"]]
        said = [
            f"{name} {element}" + ("" if sure is None else f" {sure:.2f}")
            for name, element, sure in row["said"]
        ]
        verdict, wall = row["verdict"].replace("_", " "), f"{row['wall_s']:.0f}"
        shown.append((case.name, case.known, verdict, ", ".join(said), judged(case, row), wall))
    return results.table(HEAD, shown)


def main() -> None:
    """Runs the cases given, or all, or prints what is kept."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("cases", nargs="*", type=int, default=[*range(len(CASES))])
    parser.add_argument("--out", type=Path, default=results.ROOT / "runs" / "diagnosis_measured")
    parser.add_argument("--patience", type=float, default=900.0, help="time of a case [s]")
    results.main(
        parser,
        lambda options: [run(CASES[i], options.out, options.patience) for i in options.cases],
        tables,
    )


if __name__ == "__main__":
    main()
