"""Recordings that are not of leglab: measured machines, and the simulated benches of shared data.

Each case of `data/measured`, `data/knee_bench` and `data/rough_bench` goes through
`leglab diagnose` as a user calls it, within a time; page and verdict of each are kept below
`--out`. The recordings are looked for in $LEGLAB_DATA and ../shared/data.
"""

import argparse
import json
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

from benchmarks import results
from benchmarks.measured import shared_data
from benchmarks.registry import ROOT
from leglab.base.errors import LeglabError, SettingsError

HEAD = ("machine", "known", "said", "names and sets", "judged", "s")
# A name above this is held to be true.
SURE = 0.5


@dataclass(frozen=True, kw_only=True)
class Case:
    """A machine."""

    name: str  #: What it is
    folder: str  #: Of its recordings, below `data`
    model: str = "knee_bench"  #: File in the folder, or name of a model
    recordings: str = "*"  #: Pattern of their files
    most: int = 99  #: How many of them
    healthy: str = ""  #: Pattern of recordings before it changed; empty for none
    known: str  #: What is known to be missing, in words
    #: Effects that are right, each with the elements where; none for nothing.
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


def _damper(name: str, recordings: str, known: str, healthy: str = "sine_*_0A") -> Case:
    return Case(
        name=f"damper, {name}", folder="measured/mr_damper", model="resists.xml",
        recordings=recordings, healthy=healthy, known=known, causes=_RESISTS,
    )  # fmt: skip


def _dog(leg: str, name: str) -> Case:
    return Case(
        name=f"robot dog, {name} leg", folder="measured/robot_dog", model=f"{leg}.xml",
        recordings=f"{leg}_*", causes=_LEG,
        known="less damping, more armature, friction of the calf, a delay",
    )  # fmt: skip


def _rotary(name: str, recordings: str, healthy: str, known: str, *causes: str) -> Case:
    return Case(
        name=f"rotary actuator, {name}", folder="measured/rotary", model="rotary.xml",
        recordings=recordings, most=6, healthy=healthy, known=known,
        causes=dict.fromkeys(causes, ("",)),
    )  # fmt: skip


def _bench(folder: str, name: str, healthy: str = "") -> Case | None:
    """A simulated bench, with what its file says of it; None where the data are not there."""
    try:
        truth = tomllib.loads((shared_data(folder) / "truth.toml").read_text())
    except LeglabError:
        return None
    told = [f"{key} {value}" for key, value in truth.items() if key != "effects"]
    return Case(
        name=name, folder=folder, healthy=healthy,
        known=truth.get("description", ", ".join(told) or "nothing"),
        causes=dict.fromkeys(truth["effects"], ("",)),
    )  # fmt: skip


_BENCHES = (
    *(
        _bench(f"knee_bench/{n}", f"bench {n}")
        for n in ("nominal", *(f"d{i}" for i in range(1, 8)))
    ),
    *(
        _bench(f"rough_bench/e{i}", f"rough bench e{i}{told}", healthy)
        for told, healthy in (("", "healthy/*"), (", no healthy recordings", ""))
        for i in range(7)
    ),
)
CASES = (
    _damper("1 A", "sine_*_1A", "Coulomb friction six to nine times, viscous friction"),
    _damper("0.5 A", "sine_*_0x5A", "Coulomb friction four to six times, viscous friction"),
    _damper("1 A, no healthy recordings", "sine_*_1A", "Coulomb and viscous friction", healthy=""),
    _dog("FL", "front left"),
    _dog("RR", "rear right"),
    Case(
        name="six-servo arm", folder="measured/servo_arm", model="so101.xml", causes=_ARM,
        known="delay of 0.06 to 0.14 s or a lag, on all joints; sag",
    ),
    _rotary(
        "bad seal", "butterfly_seal_*", "butterfly_healthy_*", "less resistance, other specimen",
        "viscous_friction", "coulomb_friction",
    ),
    _rotary("unchanged", "free_healthy_b_*", "free_healthy_a_*", "nothing changed"),
    *(case for case in _BENCHES if case),
)  # fmt: skip


def files(case: Case, pattern: str) -> list[str]:
    """Recordings of a pattern."""
    return [
        str(p) for p in sorted(shared_data(case.folder).glob(f"{pattern}.parquet"))[: case.most]
    ]


def run(case: Case, out: Path, patience: float) -> dict[str, Any]:
    """One row: what the command said, within a time [s]."""
    folder = out / case.name.replace(",", "").replace(" ", "_")
    model = str(shared_data(case.folder) / case.model) if ".xml" in case.model else case.model
    healthy = [f"--healthy={f}" for f in files(case, case.healthy)] if case.healthy else []
    command = [
        sys.executable,
        "-m",
        "leglab",
        "diagnose",
        model,
        *files(case, case.recordings),
        *healthy,
    ]
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


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """The cases given, or all."""
    cases = {case.name: case for case in CASES}
    for name in options.cases:
        if name not in cases:
            raise SettingsError.unknown("case", name, cases)
    chosen = [cases[name] for name in options.cases] or CASES
    return [run(case, options.out, options.patience) for case in chosen]


def add_options(parser: argparse.ArgumentParser) -> None:
    told = f"default: {'; '.join(case.name for case in CASES)}"
    parser.add_argument("cases", nargs="*", help=told)
    parser.add_argument("--out", type=Path, default=ROOT / "runs" / "diagnosis_measured")
    parser.add_argument("--patience", type=float, default=900.0, help="time of a case [s]")
