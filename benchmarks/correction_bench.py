"""A correction by name where the machine shares no code: `python benchmarks/correction_bench.py`.

The bench of `csrc/studies/rough_bench.h`, exact and rough specimens, becomes another one while it
walks: by what the bank of faults has, and by what it has not. RMS error of `bsnn_arx_bank` over
that of `bsnn_arx`, by time after the change.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from leglab.studies.blind.rough_bench import RoughBench, exact_specimen, specimen
from leglab.studies.blind.rough_loop import bench_settings, run_bench

CHANGE, DURATION = 10.0, 16.0  # s
WINDOWS = ((0.0, 0.3), (0.3, 0.6), (0.6, 1.2), (1.2, 2.4), (2.0, 5.0))  # after the change, s
REFERENCES = ("walking_stride", "random_stride")


def _more(**added: float) -> Any:
    return lambda b: b.changed(**{name: b[name] + value for name, value in added.items()})


def _times(**factors: float) -> Any:
    return lambda b: b.changed(**{name: b[name] * value for name, value in factors.items()})


def _edges(value: float) -> dict[str, float]:
    return {edge: value for edge in ("lap_pa", "lap_at", "lap_pb", "lap_bt")}


# What the bank of faults has.
KNOWN = {
    "worn seals x25": _times(internal_leakage=25.0),
    "supply -30 bar": _more(supply_pressure=-3e6),
    "null shift .02": _more(null_bias=0.02),
    "slow valve": _times(bandwidth_hz=0.2),
    "weak spring": _times(k1=0.5, k2=0.5),
    "hot oil": _times(viscous=0.25, internal_leakage=4.0),
    "payload 2.5 kg": lambda b: b.changed(
        mass=b["mass"] + 2.5,
        centre=(b["mass"] * b["centre"] + 2.5 * 0.4) / (b["mass"] + 2.5),
        inertia=b["inertia"] + 2.5 * 0.4**2,
    ),
}
# What it has not.
UNKNOWN = {
    "lap +.03": _more(**_edges(0.03)),
    "Coulomb +250 N": _more(coulomb=250.0, static_friction=375.0),
    "hysteresis .06": _more(hysteresis=0.06),
    "breakaway +300 N": _more(static_friction=300.0),
    "one-sided leak": _more(external_leakage_a=4e-12),
    "one-sided valve gain": _times(gain_positive=0.75),
    "droop": _more(droop=5e10),
    "friction extending": _more(coulomb_extending=200.0),
    "leak with friction": lambda b: _more(coulomb=150.0, static_friction=225.0)(
        _times(internal_leakage=15.0)(b)
    ),
}


def case(
    change: str, reference: str, rough: bool, seed: int, controllers: tuple[str, ...]
) -> dict[str, Any]:
    """Errors of controllers [rad] by window, and what was said."""
    healthy: RoughBench = (specimen if rough else exact_specimen)(seed)
    changed = (KNOWN | UNKNOWN)[change](healthy)
    found: dict[str, Any] = {
        "change": change,
        "reference": reference,
        "rough": rough,
        "known": change in KNOWN,
        "seed": seed,
    }
    for name in controllers:
        settings = bench_settings(healthy, name, duration=DURATION, reference=reference, seed=seed)
        history = run_bench(settings, [(0.0, healthy), (CHANGE, changed)])
        after, error = history.time - CHANGE, history.error
        rms = [
            float(np.sqrt(np.mean(error[(after >= a) & (after < b)] ** 2))) for a, b in WINDOWS
        ]
        found[name] = {"rms": rms, "failure": history.failure}
    return found


def main() -> None:
    """Runs the cases and prints ratios."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--changes", nargs="*", default=[*KNOWN, *UNKNOWN])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--base", type=Path, help="cases with `bsnn_arx` made before")
    parser.add_argument("--controllers", nargs="+", default=["bsnn_arx", "bsnn_arx_bank"])
    options = parser.parse_args()
    cases = [
        (change, reference, rough, seed)
        for seed in options.seeds
        for change in options.changes
        for reference in REFERENCES
        for rough in (False, True)
    ]
    found = Parallel(n_jobs=2)(
        delayed(case)(*one, tuple(options.controllers)) for one in cases
    )
    if options.base:
        for one, old in zip(found, json.loads(options.base.read_text()), strict=True):
            one |= {k: v for k, v in old.items() if k not in one}
    if options.out:
        options.out.write_text(json.dumps(found))
    for one in found:
        base, own = (np.array(one[n]["rms"]) for n in ("bsnn_arx", options.controllers[-1]))
        cells = " ".join(f"{1e3 * b:6.2f} {o / b:5.2f}" for b, o in zip(base, own, strict=True))
        kind = "rough" if one["rough"] else "exact"
        print(f"{one['change']:22s}{one['reference'][:4]} {kind} {cells}")
    for known in (True, False):
        ratios = np.array(
            [
                np.array(one[options.controllers[-1]]["rms"]) / np.array(one["bsnn_arx"]["rms"])
                for one in found
                if one["known"] is known
            ]
        )
        if ratios.size:
            print("bank's" if known else "others", "mean", ratios.mean(axis=0).round(2),
                  "95 %", np.quantile(ratios, 0.95, axis=0).round(2), "worst",
                  ratios.max(axis=0).round(2))


if __name__ == "__main__":
    main()
