"""All shipped controllers in `leglab benchmark adaptation`.

`python benchmarks/adaptation_benchmark.py`: sixteen faults in three sizes of the walking leg on
specimens of tolerance 0.1. Goes on where a call with the same `--out` was interrupted.
"""

import argparse
from pathlib import Path

import results

from leglab.runs.sweeps.engine import run_sweep
from leglab.studies import adaptation

# Those that no real controller could be, or that stop where the fault begins, are left out.
CONTROLLERS = (
    "adaptive_backstepping",
    "adrc",
    "arx",
    "bsnn_arx",
    "bsnn_arx_bank",
    "bsnn_arx_paper",
    "bsnn_arx_pressure",
    "ilc",
    "pid",
)


def measure(options: argparse.Namespace) -> list[list[str]]:
    plan, _ = adaptation.adaptation_plan(CONTROLLERS, specimens=options.specimens)
    result = run_sweep(plan, options.out, workers=options.workers)
    found = adaptation.scores(result.table().to_pylist())
    return [[score.fault, *adaptation.cells(score)] for score in found]


def tables(rows: list[list[str]]) -> str:
    """All faults together; then the time to nine tenths, of each fault."""
    together = results.table(list(adaptation.HEAD), [row[1:] for row in rows if row[0] == "all"])
    controllers = list(dict.fromkeys(row[1] for row in rows))
    median, never = (1 + adaptation.HEAD.index(name) for name in ("90 % after, s", "never"))
    cells = {(row[0], row[1]): (row[median], row[never]) for row in rows}
    lines = []
    for fault in dict.fromkeys(row[0] for row in rows if row[0] != "all"):
        line = [f"`{fault}`"]
        for name in controllers:
            time, of = cells[fault, name]
            line.append(f"{time} ({of})" if of and not of.startswith("0 ") else time)
        lines.append(line)
    head = ["90 % after, s (never)", *(f"`{name}`" for name in controllers)]
    return together + "\n" + results.table(head, lines)


def main() -> None:
    """Measures, or prints what is kept."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--specimens", type=int, default=1, help="how many")
    parser.add_argument("--workers", type=int, default=-1, help="processes; -1: one a core")
    parser.add_argument("--out", type=Path, default=Path("runs/adaptation_benchmark"))
    results.main(parser, measure, tables)


if __name__ == "__main__":
    main()
