"""Tables of docs/concepts/identification.md: `python -m benchmarks identification_tables NAME`.

`free_runs` and `recovery` compute what the deployed identifier does on the paper's plant; `asked`
does so as well and takes the rest from docs/data.
"""

import sys

import numpy as np

from benchmarks import results
from replication import deployed, paper
from replication.page import free_run_table, recovery_table
from replication.run import CHANGE_SEEDS, REALISATIONS

REPLICATE, IDENTIFY = "`leglab replicate`", "`benchmarks/identify.py`"


def free_runs() -> str:
    """One step and free run against the floor."""
    floor, rows = deployed.free_runs(range(REALISATIONS))
    return f"{free_run_table(rows)}\nThe floor: {floor:.4f}.\n"


def recovery() -> str:
    """Samples to recover by mode of forgetting."""
    return recovery_table(deployed.readaptation(range(CHANGE_SEEDS)))


def asked() -> str:
    """Requirements on the identifiers, and what they reach."""
    paper_run = results.load("replication")
    free_runs_of = {name: error for name, _, _, error, *_ in results.load("identify")["rows"]}
    scores = paper_run["scores"]["validation"]
    worst = 100.0 * paper_run["worst_deviation"]
    rms = 100.0 * max(
        abs(scores[model]["rms_mean"] / row.rms_mean - 1.0)
        for model, row in paper.TABLE_1["validation"].items()
    )
    online = " < ".join(f"{scores[m]['rms_mean']:.4f}" for m in ("BSNN-ARX", "ARX", "BSNN"))

    _, runs = deployed.free_runs(range(REALISATIONS))
    to_floor = next(row[-1] for row in runs if row[0] == deployed.DEPLOYED)
    modes = deployed.forgetting_modes()
    modes = {name: modes[name] for name in ("plain", deployed.DEPLOYED_MODE)}
    recoveries = deployed.readaptation(range(CHANGE_SEEDS), modes)
    by_change = recoveries[deployed.DEPLOYED_MODE]
    changes = ", ".join(deployed.CHANGES)
    pooled = ", ".join(str(by_change[name].pooled) for name in deployed.CHANGES)
    longest = ", ".join(f"{np.max(by_change[name].samples):.0f}" for name in deployed.CHANGES)
    first = deployed.CHANGES[0]
    steady = by_change[first].before / recoveries["plain"][first].before

    peers = next(iter(results.load("identification_peers").values()))
    single = peers["leglab, paper's BSNN-ARX, single calls"]["nanoseconds"]
    rls = next(row["nanoseconds"] for name, row in peers.items() if name.startswith("padasip"))
    rows = [
        (
            "Table 1, validation means of the five models",
            "within 15 %",
            f"{worst:.1f} % at worst, RMS within {rms:.0f} %",
            REPLICATE,
        ),
        (
            f"order of the online models, learning constant {paper.LEARNING_CONSTANT}",
            "BSNN-ARX < ARX < BSNN",
            online,
            REPLICATE,
        ),
        (
            "three online models, 100 instances",
            "2 s",
            f"{paper_run['online_seconds']:.2g} s",
            REPLICATE,
        ),
        (
            "deployed, free run on the plant of Eq. 23",
            "1.15 times the floor",
            f"{to_floor:.2f} times",
            "below",
        ),
        (
            f"samples to recover after a step of {changes} by 2",
            "400",
            f"{pooled} ({CHANGE_SEEDS} seeds pooled); worst seed {longest}",
            "below",
        ),
        ("its steady-state error", "1.1 times plain RLS", f"{steady:.2f} times", "below"),
        (
            "Silverbox, multisine / arrow without extrapolation / arrow [mV]",
            "0.50 / 0.50 / 2.3",
            " / ".join(f"{error:.3f}" for n, error in free_runs_of.items() if "Silverbox" in n),
            IDENTIFY,
        ),
        ("hydraulic actuator", "0.55", f"{free_runs_of['hydraulic actuator']:.3f}", IDENTIFY),
        (
            "single call of the paper's model from Python",
            "1/5 of padasip's RLS",
            f"1/{rls / single:.0f}",
            "`benchmarks/identification_peers.py`",
        ),
    ]
    return results.table(("", "asked", "measured", "by"), rows)


def main() -> None:
    """Prints a table."""
    known = {"free_runs": free_runs, "recovery": recovery, "asked": asked}
    if len(sys.argv) != 2 or sys.argv[1] not in known:
        raise SystemExit(f"usage: identification_tables.py {'|'.join(known)}")
    print(known[sys.argv[1]](), end="")
