"""Machines that differ from their model: `python benchmarks/diagnosis_rough.py [CASE...]`.

The rough benches of data/rough_bench, with their healthy recordings and without, and the measured
axis of data/emps. They are looked for in $LEGLAB_DATA and ../shared/data.
"""

import argparse
import sys
import tomllib
from pathlib import Path
from typing import Any

import results
from diagnosis_bench import named

from leglab.base.recording import Recording
from leglab.diagnosis.intake.recordings import read_recordings, split_held_out
from leglab.diagnosis.result import shown_unit
from leglab.diagnosis.verdict.verdict import diagnose
from leglab.studies.shared_data import shared_data

sys.path.insert(0, str(Path(__file__).parents[1]))

from rigs.measured import EMPS_HELD_OUT, EMPS_MODEL, emps

BENCHES = tuple(f"e{i}" for i in range(7))
HEAD = (
    "machine",
    "hidden",
    "healthy recordings",
    "verdict",
    "named, confidence",
    "smaller",
    "explained",
    "left after 0.3 s",
    "noise levels before > after",
    "s",
)


def bench(case: str) -> tuple[dict[str, Recording], tuple[str, ...], dict[str, Recording], str]:
    """Recordings, those held out, healthy ones, and what is hidden."""
    folder = shared_data(f"rough_bench/{case}")
    truth = tomllib.loads((folder / "truth.toml").read_text())
    told = [f"{k} {v:g}" for k, v in truth.items() if k != "effects"]
    hidden = ", ".join([*truth["effects"], *told]) or "nothing"
    recordings, held = split_held_out(
        "knee_bench", read_recordings(sorted(folder.glob("*.parquet"))), []
    )
    return recordings, held, read_recordings(sorted(folder.glob("healthy/*.parquet"))), hidden


def run(case: str, *, healthy: bool) -> dict[str, Any]:
    """One row."""
    if case == "EMPS":
        model, recordings, held = str(EMPS_MODEL), emps(), (EMPS_HELD_OUT,)
        before: dict[str, Recording] = {}
        hidden = "friction by direction: 165 to 172 and 240 to 249 N s/m"
    else:
        model = "knee_bench"
        recordings, held, before, hidden = bench(case)
    result, _ = diagnose(model, recordings, held_out=held, healthy=before if healthy else None)
    print(f"{case}: {result.verdict}, {result.seconds:.0f} s", file=sys.stderr, flush=True)
    left: dict[str, str] = {}
    for one in result.remaining:
        factor, unit = shown_unit(one.unit)
        left.setdefault(unit, f"{factor * one.before:.2f} > {factor * one.after:.2f} {unit}")
    return {
        "case": case,
        "hidden": hidden,
        "healthy": healthy,
        "verdict": result.verdict,
        "named": named(result),
        "smaller": ", ".join(e.name for e in result.smaller),
        "explained": result.gap.explained,
        "left": ", ".join(left.values()),
        "before": result.gap.before,
        "after": result.gap.after,
        "wall_s": result.seconds,
    }


def tables(rows: list[dict[str, Any]]) -> str:
    """A row a case."""
    shown = [
        (
            row["case"],
            row["hidden"],
            "yes" if row["healthy"] else "no",
            *(row[key] for key in ("verdict", "named", "smaller")),
            "" if row["explained"] is None else f"{row['explained']:.2f}",
            row["left"],
            f"{row['before']:.3g} > {row['after']:.3g}",
            f"{row['wall_s']:.0f}",
        )
        for row in rows
    ]
    return results.table(HEAD, shown)


def main() -> None:
    """Runs the cases given, or all, or prints what is kept."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("cases", nargs="*", default=[*BENCHES, "EMPS"])
    results.main(
        parser,
        lambda options: [
            run(case, healthy=healthy)
            for healthy in (True, False)
            for case in options.cases
            if not (healthy and case == "EMPS")
        ],
        tables,
    )


if __name__ == "__main__":
    main()
