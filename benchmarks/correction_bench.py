"""A correction by name where the machine shares no code: `python benchmarks/correction_bench.py`.

The bench of `csrc/studies/rough_bench.h`, exact and rough specimens, becomes another one while it
walks: by what the bank of faults has, and by what it has not. RMS error of `bsnn_arx_bank` over
that of `bsnn_arx`, by time after the change, and over any two seconds after it.
"""

import argparse
from typing import Any

import numpy as np
import results
from joblib import Parallel, delayed

from leglab.runs.metrics import sliding_rms
from leglab.studies.blind.rough_bench import RoughBench, exact_specimen, specimen
from leglab.studies.blind.rough_loop import bench_settings, run_bench

CHANGE, DURATION = 10.0, 16.0  # s
WINDOWS = ((0.0, 0.3), (0.3, 0.6), (0.6, 1.2), (1.2, 2.4), (2.0, 5.0))  # after the change, s
FIRST_SEED = 8100  # of no run that a setting was chosen by
CONTROLLERS = ("bsnn_arx", "bsnn_arx_bank")
REFERENCES = ("walking_stride", "random_stride")


def _more(**added: float) -> Any:
    return lambda b: b.changed(**{name: b[name] + value for name, value in added.items()})


def _times(**factors: float) -> Any:
    return lambda b: b.changed(**{name: b[name] * value for name, value in factors.items()})


def _edges(value: float) -> dict[str, float]:
    return dict.fromkeys(("lap_pa", "lap_at", "lap_pb", "lap_bt"), value)


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


def judged(case: tuple[str, str, bool, int]) -> dict[str, Any]:
    """Errors of both controllers [rad] by window, and over any two seconds from the change on."""
    change, reference, rough, seed = case
    healthy: RoughBench = (specimen if rough else exact_specimen)(seed)
    changed = (KNOWN | UNKNOWN)[change](healthy)
    found: dict[str, Any] = {"change": change, "reference": reference, "rough": rough}
    any_two = {}
    for name in CONTROLLERS:
        settings = bench_settings(healthy, name, duration=DURATION, reference=reference, seed=seed)
        history = run_bench(settings, [(0.0, healthy), (CHANGE, changed)])
        assert not history.failure, (case, name, history.failure)
        after = history.time - CHANGE
        parts = [history.error[(after >= a) & (after < b)] for a, b in WINDOWS]
        found[name] = [float(np.sqrt(np.mean(part**2))) for part in parts]
        any_two[name] = sliding_rms(history.time, history.error, 2.0)[after >= 2.0]
    found["any"] = float((any_two["bsnn_arx_bank"] / any_two["bsnn_arx"]).max())
    return found


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """All cases."""
    cases = [
        (change, reference, rough, seed)
        for seed in range(FIRST_SEED, FIRST_SEED + options.specimens)
        for change in KNOWN | UNKNOWN
        for reference in REFERENCES
        for rough in (False, True)
    ]
    made: list[dict[str, Any]] = Parallel(n_jobs=options.jobs)(delayed(judged)(c) for c in cases)
    return made


def tables(found: list[dict[str, Any]]) -> str:
    """All changes together, then one by one."""
    spans = [f"{a:g}-{b:g} s" for a, b in WINDOWS] + ["any 2 s"]
    head = ["error over that of `bsnn_arx`", *spans]
    rows = []
    for label, names in (("the bank has", KNOWN), ("it has not", UNKNOWN)):
        own = _ratios([case for case in found if case["change"] in names])
        for what, of in (
            ("mean", own.mean(axis=0)),
            ("95 %", np.quantile(own, 0.95, axis=0)),
            ("largest", own.max(axis=0)),
        ):
            rows.append([f"changes that {label}, {what}", *(results.number(x, 3) for x in of)])
    text = results.table(head, rows)
    head = ["change", "`bsnn_arx`, mrad", "`bsnn_arx_bank`, mrad"]
    rows = []
    for change in KNOWN | UNKNOWN:
        own = [case for case in found if case["change"] == change]
        means = [1e3 * np.mean([case[name] for case in own], axis=0) for name in CONTROLLERS]
        cells = [" / ".join(results.number(x, 2) for x in mean[1:]) for mean in means]
        rows.append([change, *cells])
    return f"{text}\n{results.table(head, rows)}"


def _ratios(found: list[dict[str, Any]]) -> np.ndarray:
    """Of each case, (cases, windows + 1)."""
    own, base = (np.array([case[name] for case in found]) for name in CONTROLLERS[::-1])
    return np.column_stack([own / base, [case["any"] for case in found]])


def main() -> None:
    """Measures, or prints what is kept."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--specimens", type=int, default=2, help="how many, exact and rough")
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time")
    results.main(parser, measure, tables)


if __name__ == "__main__":
    main()
