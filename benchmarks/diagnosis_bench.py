"""Hidden effects of data/knee_bench, diagnosed: `python benchmarks/diagnosis_bench.py [CASE...]`.

With `--without-pressures` the pressure columns are taken away first. The recordings come from an
independent simulator; they are looked for in $LEGLAB_DATA and ../shared/data.
"""

import argparse
import sys
import time
import tomllib
from typing import Any

import results

from leglab.diagnosis.intake.recordings import read_recordings, split_held_out
from leglab.diagnosis.result import Diagnosis
from leglab.diagnosis.verdict.verdict import diagnose
from leglab.studies.shared_data import shared_data

CASES = ("nominal", *(f"d{i}" for i in range(1, 8)))
HEAD = (
    "case",
    "hidden",
    "verdict",
    "named, confidence",
    "gap before > after",
    "closed",
    "CPU s",
    "wall s",
)


def named(result: Diagnosis) -> str:
    """Effects with their confidence and the fitted values with half of the 95 % interval."""
    effects = []
    for effect in result.effects:
        values = ", ".join(
            f"{p.name} {p.value:.4g} ± {0.5 * (p.interval[1] - p.interval[0]):.1g}"
            for p in effect.parameters
        )
        effects.append(f"{effect.name} {effect.confidence:.2f} ({values})")
    return "; ".join(effects) or "nothing"


def run(case: str, *, pressures: bool) -> dict[str, Any]:
    """One row."""
    folder = shared_data(f"knee_bench/{case}")
    truth = tomllib.loads((folder / "truth.toml").read_text())
    recordings = read_recordings(sorted(folder.glob("*.parquet")))
    if not pressures:
        recordings = {
            n: r.select(["knee_position", "knee_valve_command"]) for n, r in recordings.items()
        }
    recordings, held = split_held_out("knee_bench", recordings, [])
    began = time.process_time()
    result, _ = diagnose("knee_bench", recordings, held_out=held)
    spent = time.process_time() - began
    print(f"{case}: {result.verdict}, {spent:.0f} s", file=sys.stderr, flush=True)
    return {
        "case": case,
        "hidden": truth["description"],
        "verdict": result.verdict,
        "named": named(result),
        "before": result.gap.before,
        "after": result.gap.after,
        "closed": result.gap.closed_fraction,
        "processor_s": spent,
        "wall_s": result.seconds,
    }


def tables(rows: list[dict[str, Any]]) -> str:
    """A row a case."""
    shown = [
        (
            *(row[key] for key in ("case", "hidden", "verdict", "named")),
            f"{row['before']:.3g} > {row['after']:.3g}",
            "" if row["closed"] is None else f"{row['closed']:.4f}",
            f"{row['processor_s']:.0f}",
            f"{row['wall_s']:.0f}",
        )
        for row in rows
    ]
    return results.table(HEAD, shown)


def main() -> None:
    """Diagnoses, or prints what is kept."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("cases", nargs="*", default=CASES)
    parser.add_argument("--without-pressures", action="store_true")
    results.main(
        parser,
        lambda options: [
            run(case, pressures=not options.without_pressures) for case in options.cases
        ],
        tables,
    )


if __name__ == "__main__":
    main()
