"""Single faults on one joint of leglab's own leg: named first, at the right joint?

`python -m benchmarks diagnosis_leg --cases 22 --nothing 5 --out runs/diagnosis_leg` goes on where
it was interrupted. A case has five recordings of 8 s at 500 Hz, three of strides and two of random
strides, by the leg's own model at a tenth of its step; fault, joint and size are drawn.
"""

import argparse
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from pydantic import TypeAdapter
from scipy.stats import binomtest

from benchmarks import results
from benchmarks.self_test.outcomes import run_missing
from leglab import RunSettings, run_scenario
from leglab.base.recording import Recording
from leglab.base.scenario import Options, ParameterChange, register_scenario
from leglab.diagnosis.intake.recordings import held_out_choice
from leglab.diagnosis.plant.model import Machine
from leglab.diagnosis.search.pipeline import DiagnosisSettings
from leglab.diagnosis.verdict.verdict import diagnose

HEAD = ("question", "reached", "95 % interval", "cases", "asked")
CASE_HEAD = ("hidden", "verdict", "named, confidence", "gap before > after", "s")
MOTIONS = ("walking_stride", "random_stride", "walking_stride", "random_stride", "walking_stride")
DURATION, STEP = 8.0, 1e-4  # s
SURE, DOUBT = 0.8, 0.5


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Parameters of a joint's cylinder, spring ("spring") or encoder ("") that change together.

    Attributes:
        part: Suffix of the element.
        parameters: Names.
        kind: "scale", "set", or "add" for a difference to what the model has.
        low: Smallest size, log-uniform.
        high: Largest.
        signed: Whether either sign is drawn.
    """

    part: str
    parameters: tuple[str, ...]
    kind: str
    low: float
    high: float
    signed: bool = False


FAULTS = {
    "internal_leakage": Fault(
        part="valve", parameters=("internal_leakage",), kind="scale", low=3.0, high=30.0
    ),
    "external_leakage": Fault(
        part="valve", parameters=("external_leakage_a",), kind="set", low=3e-13, high=3e-12
    ),
    "valve_deadband": Fault(part="valve", parameters=("lap",), kind="set", low=0.035, high=0.08),
    "valve_hysteresis": Fault(
        part="valve", parameters=("hysteresis",), kind="set", low=0.01, high=0.05
    ),
    "valve_bias": Fault(
        part="valve", parameters=("null_bias",), kind="set", low=0.015, high=0.05, signed=True
    ),
    "valve_bandwidth": Fault(
        part="valve", parameters=("bandwidth_hz",), kind="set", low=20.0, high=70.0
    ),
    "valve_gain": Fault(
        part="valve", parameters=("rated_flow",), kind="scale", low=0.65, high=0.88
    ),
    "viscous_friction": Fault(
        part="valve", parameters=("viscous",), kind="scale", low=1.8, high=5.0
    ),
    "coulomb_friction": Fault(
        part="valve", parameters=("coulomb", "static"), kind="add", low=60.0, high=300.0
    ),
    "stiction": Fault(part="valve", parameters=("static",), kind="scale", low=1.6, high=3.0),
    "spring_stiffness": Fault(part="spring", parameters=("k1",), kind="scale", low=0.3, high=0.7),
    "entrained_air": Fault(
        part="valve", parameters=("entrained_air",), kind="scale", low=3.0, high=10.0
    ),
    "encoder_offset": Fault(
        part="", parameters=("encoder_offset",), kind="set", low=0.015, high=0.08, signed=True
    ),
}


@dataclass(frozen=True, kw_only=True)
class Case:
    """A hidden fault, or nothing."""

    kind: str
    number: int
    effect: str = ""
    joint: str = ""
    size: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """A case and what the diagnosis said."""

    kind: str
    number: int
    effect: str
    joint: str
    size: float
    diagnosis: dict[str, Any]
    seconds: float

    @property
    def claims(self) -> list[tuple[str, str, float]]:
        """Names with element and confidence."""
        found = self.diagnosis["effects"]
        return [(e["name"], e["element"], float(e["confidence"] or 0.0)) for e in found]

    def right(self, confidence: float = 0.0) -> bool:
        """Whether the first name and its element are right, with this confidence at least."""
        return any(
            (n, c >= confidence) == (self.effect, True) and _of_joint(e, self.joint)
            for n, e, c in self.claims[:1]
        )

    def wrong(self) -> bool:
        """Whether a name that is not there has more than half the confidence."""
        return any(
            c > DOUBT and not (n == self.effect and _of_joint(e, self.joint))
            for n, e, c in self.claims
        )


def _of_joint(element: str, joint: str) -> bool:
    return element == joint or element.startswith(f"{joint}_")


def cases(count: int, nothing: int, seed: int) -> list[Case]:
    """Faults in turn, joints and sizes drawn; a spring sits on five of the six joints."""
    joints = Machine("leg").joints
    found = []
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        effect = [*FAULTS][number % len(FAULTS)]
        fault = FAULTS[effect]
        able = joints if fault.part != "spring" else tuple(j for j in joints if j != "hip_yaw")
        size = float(np.exp(rng.uniform(np.log(fault.low), np.log(fault.high))))
        if fault.signed:
            size *= float(rng.choice((-1.0, 1.0)))
        joint = able[int(rng.integers(len(able)))]
        found.append(Case(kind="fault", number=number, effect=effect, joint=joint, size=size))
    return found + [Case(kind="nothing", number=number) for number in range(nothing)]


def recordings(case: Case) -> dict[str, Recording]:
    """Records a case; the fault is there from the start."""
    changes: tuple[ParameterChange, ...] = ()
    if case.effect:
        fault, machine = FAULTS[case.effect], Machine("leg")
        element = f"{case.joint}_{fault.part}".rstrip("_")
        for name in fault.parameters:
            add = fault.kind == "add"
            changes += (
                ParameterChange(
                    parameter=name,
                    element=element,
                    kind="set" if add else fault.kind,
                    value=case.size + (machine.parameter(element, name) if add else 0.0),
                    start=0.0,
                ),
            )
    scenario = f"case_{case.kind}_{case.number}"

    @register_scenario(scenario, summary="a fault that is there from the start", duration=DURATION)
    def _(options: Options) -> tuple[ParameterChange, ...]:
        return changes

    found = {}
    for i, motion in enumerate(MOTIONS):
        settings = RunSettings(
            scenario=scenario,
            reference=motion,
            seed=100 * case.number + i,
            timestep=STEP,
            vary=True,
        )
        found[f"{motion} {i}"] = run_scenario(settings).recording
    return found


def judged(given: dict[str, Any]) -> dict[str, Any]:
    """Records and diagnoses a case on one thread."""
    case = Case(**given["case"])
    made = recordings(case)
    began = perf_counter()
    held = held_out_choice(made, Machine("leg"))
    result, _ = diagnose("leg", made, held_out=held, settings=DiagnosisSettings(threads=1))
    found = Outcome(**vars(case), diagnosis=result.to_json(), seconds=perf_counter() - began)
    return asdict(found)


def measure(options: argparse.Namespace) -> Any:
    outcomes = run_missing(
        options.out / f"outcomes-{options.seed}.jsonl",
        cases(options.cases, options.nothing, options.seed),
        judged,
        key=lambda one: (one.kind, one.number),
        parse=TypeAdapter(Outcome).validate_python,
        processes=options.jobs,
        progress=lambda done, total, last: print(f"{done} of {total} {last}", flush=True),
    )
    rows = [
        {
            "hidden": f"{o.effect} {o.size:.3g} at {o.joint}" if o.effect else "nothing",
            "verdict": o.diagnosis["verdict"],
            "named": "; ".join(f"{n} at {e} {c:.2f}" for n, e, c in o.claims) or "nothing",
            "gap": f"{o.diagnosis['gap']['before']:.3g} > {o.diagnosis['gap']['after']:.3g}",
            "seconds": o.seconds,
        }
        for o in outcomes
    ]
    faulty = [o for o in outcomes if o.effect]
    healthy = [o for o in outcomes if not o.effect]
    questions = (
        ("name and joint first", [o.right() for o in faulty], "90 %"),
        ("... with confidence of 0.8 or more", [o.right(SURE) for o in faulty], "90 %"),
        ("a wrong name above 0.5", [o.wrong() for o in faulty], ""),
        ("nothing hidden: a name above 0.5", [o.wrong() for o in healthy], "0"),
    )
    return {"cases": rows, "questions": [(q, sum(g), len(g), asked) for q, g, asked in questions]}


def tables(kept: Any) -> str:
    """Questions, then a row a case."""
    told = []
    for question, good, count, asked in kept["questions"]:
        if count:
            low, high = binomtest(good, count).proportion_ci(method="wilson")
            told.append((question, f"{good}", f"{low:.0%} to {high:.0%}", f"{count}", asked))
    shown = [
        (*(row[key] for key in ("hidden", "verdict", "named", "gap")), f"{row['seconds']:.0f}")
        for row in kept["cases"]
    ]
    return results.table(HEAD, told) + "\n" + results.table(CASE_HEAD, shown)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--cases", type=int, default=22, help="with a single fault")
    parser.add_argument("--nothing", type=int, default=5, help="without any")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2, help="cases at a time")
    parser.add_argument("--out", type=Path, default=Path("runs/diagnosis_leg"))
