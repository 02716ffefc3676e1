"""A correction by name where the machine shares no code.

The bench of `rigs/csrc/rough_bench.h`, exact and rough specimens, becomes another one while it
walks: by what the bank of faults has, and by what it has not. RMS error of `bsnn_arx_bank`, with
its whole bank and with one that has not the kind, over that of `bsnn_arx`, by time after the
change, and over any two seconds after it; errors of the last five seconds, over those before the
change, of `bsnn_arx` and of the bank.
"""

import argparse
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from benchmarks import results
from benchmarks.specimens import window_rms
from leglab.causes.fault_names import UNKNOWN as UNNAMED
from leglab.causes.fault_names import FaultEvent
from leglab.causes.table import kind_of
from leglab.runs.metrics import sliding_rms
from rigs.closed_loop import bench_loop, bench_settings
from rigs.rough_bench import RoughBench, exact_specimen, specimen

CHANGE, DURATION = 10.0, 20.0  # s
WINDOWS = ((0.0, 0.3), (0.3, 0.6), (0.6, 1.2), (1.2, 2.4), (2.0, 5.0), (5.0, 10.0))  # after it, s
HEALTHY = (-5.0, 0.0)  # s
BEFORE, BANK, WITHOUT = "bsnn_arx", "bsnn_arx_bank", "kind left out"
REFERENCES = ("walking_stride", "random_stride")


def _more(**added: float) -> Any:
    return lambda b: b.changed(**{name: b[name] + value for name, value in added.items()})


def _times(**factors: float) -> Any:
    return lambda b: b.changed(**{name: b[name] * value for name, value in factors.items()})


def _edges(value: float) -> dict[str, float]:
    return dict.fromkeys(("lap_pa", "lap_at", "lap_pb", "lap_bt"), value)


# What the bank of faults has, with its name there.
KNOWN = {
    "worn seals x25": ("seal_wear", _times(internal_leakage=25.0)),
    "supply -30 bar": ("supply_drop", _more(supply_pressure=-3e6)),
    "null shift .03": ("valve_null_shift", _more(null_bias=0.03)),
    "slow valve": ("slow_valve", _times(bandwidth_hz=0.2)),
    "weak spring": ("spring_fatigue", _times(k1=0.5, k2=0.5)),
    "hot oil": ("hot_oil", _times(viscous=0.25, internal_leakage=4.0)),
    "payload 2.5 kg": (
        "payload",
        lambda b: b.changed(
            mass=b["mass"] + 2.5,
            centre=(b["mass"] * b["centre"] + 2.5 * 0.4) / (b["mass"] + 2.5),
            inertia=b["inertia"] + 2.5 * 0.4**2,
        ),
    ),
    "lap +.03": ("valve_deadband", _more(**_edges(0.03))),
    "hysteresis .06": ("valve_hysteresis", _more(hysteresis=0.06)),
    "Coulomb +250 N": ("coulomb_friction", _more(coulomb=250.0, static_friction=375.0)),
    "one-sided leak": ("chamber_leak", _more(external_leakage_a=4e-12)),
}
# What it has not, or only each for itself.
UNKNOWN = {
    "breakaway +300 N": _more(static_friction=300.0),
    "one-sided valve gain": _times(gain_positive=0.7),
    "droop": _more(droop=5e10),
    "friction extending": _more(coulomb_extending=200.0),
    "leak with friction": lambda b: _more(coulomb=150.0, static_friction=225.0)(
        _times(internal_leakage=15.0)(b)
    ),
}


def judged(case: tuple[str, str, bool, int]) -> dict[str, Any]:
    """Errors of all controllers [rad] by window, and over any two seconds from the change on."""
    change, reference, rough, seed = case
    healthy: RoughBench = (specimen if rough else exact_specimen)(seed)
    fault, become = KNOWN.get(change) or ("", UNKNOWN.get(change))
    plans: dict[str, dict[str, Any]] = {BEFORE: {}, BANK: {}}
    if fault:
        plans[WITHOUT] = {"left_out": list(kind_of(fault))}
    found: dict[str, Any] = {"change": change, "reference": reference, "rough": rough}
    any_two = {}
    for label, config in plans.items():
        settings = bench_settings(
            healthy,
            BEFORE if label == BEFORE else BANK,
            controller_config=config,
            duration=DURATION,
            reference=reference,
            seed=seed,
        )
        loop = bench_loop(settings, [(0.0, healthy), (CHANGE, become(healthy))])
        history = loop.run()
        assert not history.failure, (case, label, history.failure)
        after = history.time - CHANGE
        any_two[label] = sliding_rms(history.time, history.error, 2.0)[after >= 2.0]
        found[label] = {
            "rms": [float(f"{window_rms(history.error, after, *w):.4g}") for w in WINDOWS],
            "any": float(f"{(any_two[label] / any_two[BEFORE]).max():.4g}"),
            "healthy": float(f"{window_rms(history.error, after, *HEALTHY):.4g}"),
        }
        if label == BANK:
            found["said"] = _said(loop.controller.events, fault)  # type: ignore[union-attr]
    return found


def _said(events: list[FaultEvent], fault: str) -> dict[str, Any]:
    """The last name in force after the change, and whether it is right, alone or among others."""
    names = [e.names[-1] for e in events if e.withdrawn is None and e.names[-1].time >= CHANGE]
    if not names or names[-1].fault == UNNAMED:
        return {"name": ""}
    last = names[-1]
    return {
        "name": last.fault,
        "confidence": round(float(last.confidence), 3),
        "among": fault in (last.fault, *(rival.fault for rival in last.rivals)),
    }


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """All cases."""
    cases = [
        (change, reference, rough, seed)
        for seed in range(options.seed, options.seed + options.specimens)
        for change in (*KNOWN, *UNKNOWN)
        for reference in REFERENCES
        for rough in (False, True)
    ]
    made: list[dict[str, Any]] = Parallel(n_jobs=options.jobs)(delayed(judged)(c) for c in cases)
    return made


def tables(found: list[dict[str, Any]]) -> str:
    """All changes together, then one by one, then what was said."""
    spans = [f"{a:g}-{b:g} s" for a, b in WINDOWS] + ["any 2 s"]
    head = ["error over that of `bsnn_arx`", *spans]
    rows = []
    groups = (
        ("changes that the bank has", BANK, [c for c in found if c["change"] in KNOWN]),
        ("the same, kind left out", WITHOUT, [c for c in found if c["change"] in KNOWN]),
        ("changes that it has not", BANK, [c for c in found if c["change"] in UNKNOWN]),
    )
    for name, label, group in groups:
        own = _ratios(group, label)
        for what, of in (
            ("mean", own.mean(axis=0)),
            ("95 %", np.quantile(own, 0.95, axis=0)),
            ("largest", own.max(axis=0)),
        ):
            rows.append([f"{name}, {what}", *(results.number(x, 3) for x in of)])
    text = results.table(head, rows)
    head = ["change", "`bsnn_arx`, mrad", "`bsnn_arx_bank`, mrad", "last 5 s over healthy"]
    head += ["named right", "in a set", "by another name", "of these at 0.9"]
    rows = []
    for change in (*KNOWN, *UNKNOWN):
        own_cases = [case for case in found if case["change"] == change]
        means = [1e3 * np.mean([c[x]["rms"] for c in own_cases], axis=0) for x in (BEFORE, BANK)]
        cells = [" / ".join(results.number(x, 2) for x in mean[1:]) for mean in means]
        floor = [
            np.mean([c[x]["rms"][-1] / c[x]["healthy"] for c in own_cases]) for x in (BEFORE, BANK)
        ]
        cells.append(" / ".join(results.number(x, 2) for x in floor))
        rows.append([change, *cells, *_naming(own_cases, KNOWN.get(change, ("",))[0])])
    return f"{text}\n{results.table(head, rows)}"


def _naming(cases: list[dict[str, Any]], fault: str) -> list[str]:
    """How many were named right, held by what was told, and called something else."""
    said = [case["said"] for case in cases if case["said"]["name"]]
    right = sum(one["name"] == fault for one in said)
    held = sum(one["among"] for one in said) - right
    other = [one["confidence"] for one in said if not one["among"]]
    sure = sum(confidence >= 0.9 for confidence in other)
    return [f"{right} of {len(cases)}", str(held), str(len(other)), str(sure)]


def _ratios(found: list[dict[str, Any]], label: str) -> np.ndarray:
    """Of each case, (cases, windows + 1)."""
    own, base = (np.array([case[name]["rms"] for case in found]) for name in (label, BEFORE))
    return np.column_stack([own / base, [case[label]["any"] for case in found]])


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--specimens", type=int, default=1, help="how many, exact and rough")
    parser.add_argument("--seed", type=int, default=41000, help="of the first specimen")
    parser.add_argument("--jobs", type=int, default=2, help="processes at a time")
