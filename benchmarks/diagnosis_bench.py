"""Hidden effects of data/knee_bench, diagnosed: `python benchmarks/diagnosis_bench.py [CASE...]`.

With `--without-pressures` the pressure columns are taken away first. The recordings come from an
independent simulator; they are looked for in $LEGLAB_DATA and ../shared/data.
"""

import argparse
import time
import tomllib

from leglab.diagnosis.recordings import read_recordings, split_held_out
from leglab.diagnosis.verdict import diagnose
from leglab.verification.bench import nominal_folder

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("cases", nargs="*", default=["nominal", *(f"d{i}" for i in range(1, 8))])
parser.add_argument("--without-pressures", action="store_true")
arguments = parser.parse_args()

print(
    "| case | hidden | verdict | named, confidence | gap before > after | closed | CPU s | wall s |"
)
print("|---|---|---|---|---|---|---|---|")
for case in arguments.cases:
    folder = nominal_folder().parent / case
    truth = tomllib.loads((folder / "truth.toml").read_text())
    recordings = read_recordings(sorted(folder.glob("*.parquet")))
    if arguments.without_pressures:
        recordings = {
            n: r.select(["knee_position", "knee_valve_command"]) for n, r in recordings.items()
        }
    recordings, held = split_held_out("knee_bench", recordings, [])
    began = time.process_time()
    result, _ = diagnose("knee_bench", recordings, held_out=held)
    spent = time.process_time() - began
    named = "; ".join(
        f"{e.name} {e.confidence:.2f} ("
        + ", ".join(
            f"{p.name} {p.value:.4g} ± {0.5 * (p.interval[1] - p.interval[0]):.1g}"
            for p in e.parameters
        )
        + ")"
        for e in result.effects
    )
    gap = result.gap
    closed = "" if gap.closed_fraction is None else f"{gap.closed_fraction:.4f}"
    print(
        f"| {case} | {truth['description']} | {result.verdict} | {named or 'nothing'} "
        f"| {gap.before:.3g} > {gap.after:.3g} | {closed} | {spent:.0f} | {result.seconds:.0f} |",
        flush=True,
    )
