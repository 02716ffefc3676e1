"""Digests of fixed runs and the results of fixed diagnoses, to prove that a change changes nothing.

`python -m benchmarks.digests --write FILE` at the commit before a change, `--compare FILE` after
it, on the same machine: other processors and library versions may round differently. Runs must
agree to the last bit; diagnoses in verdict, names and notes, and to 1e-9 in every value.
"""

import argparse
import hashlib
import json
import math
import subprocess
import sys
import tempfile
from dataclasses import asdict, is_dataclass
from pathlib import Path

import pyarrow.parquet as pq
from joblib import Parallel, delayed

from leglab.data import read
from leglab.diagnosis.verdict.verdict import diagnose
from rigs import PENDULUM, SLIDE_AXIS, Truth, record

RECORDINGS = Path(__file__).parent.parent / "tests" / "data" / "diagnosis"
RIG_KINDS = ("multisine", "fast", "slow", "stairs")
TOLERANCE = 1e-9  # relative, of values of a diagnosis

# Options of `leglab run`: together every controller, reference, model and kind of change.
RUNS = {
    "walk_pd": "nominal --controller pd --duration 4",
    "wear_static": "seal_wear --controller static_feedforward --duration 6",
    "wear_adaptive": "seal_wear --controller bsnn_arx --duration 8",
    "bench_oracle": "cold_oil --controller oracle --model knee_bench --duration 6",
    "dropout_arx": "sensor_dropout --controller arx --duration 6",
    "squat_frozen": "payload --controller frozen --model leg_rail --reference squat --duration 6",
    "paper": "encoder_shift --controller bsnn_arx_paper --duration 5",
    "backstepping": "supply_drop --controller adaptive_backstepping --duration 6",
    "bench_pid": "stiction --controller pid --model knee_bench --reference step --duration 6",
    "specimen": "valve_wear --controller bsnn_arx --tolerance 0.1 --ramp 2 --duration 8",
    "random": "supply_droop --controller bsnn_arx --reference random_stride --duration 8",
    "bench_sweep": "viscosity_change --controller adaptive_backstepping --model knee_bench "
    "--reference sine_sweep --timestep 0.0005 --severity 68 --duration 5",
}
SEEDS = (0, 3)
# Figures that measure the machine that computes, not the one that is simulated.
CLOCKS = ("real_time_factor",)


def run_digests(name, options, seed):
    """Digest of every column of a recording, and of the metrics."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        words = [*options.split(), "--seed", str(seed), "--no-figures", "--out", str(out)]
        command = [Path(sys.executable).parent / "leglab", "run", *words]
        subprocess.run(command, check=True, capture_output=True)
        table = pq.read_table(out / "recording.parquet")
        metrics = json.loads((out / "metrics.json").read_text())
    digests = {
        column: hashlib.sha256(table[column].to_numpy().tobytes()).hexdigest()[:16]
        for column in table.column_names
    }
    metrics = {key: value for key, value in metrics.items() if key not in CLOCKS}
    digests["metrics.json"] = hashlib.sha256(json.dumps(metrics).encode()).hexdigest()[:16]
    return f"{name}, seed {seed}", digests


def rig_recordings(rig, **hidden):
    return {
        kind: record(rig, kind, Truth(**hidden), seed=seed, seconds=6.0)
        for seed, kind in enumerate(RIG_KINDS)
    }


def bench_recordings(case, *, pressures=True):
    recordings = {path.stem: read(path) for path in sorted(RECORDINGS.glob(f"{case}_*.parquet"))}
    if pressures:
        return recordings
    return {
        name: r.select([c for c in r.columns if "_pressure_" not in c])
        for name, r in recordings.items()
    }


def diagnoses():
    """By name: model, recordings, name of the recording held out."""
    yield "bench, nothing hidden", "knee_bench", bench_recordings("nominal"), "nominal_walk"
    yield "bench, dead band", "knee_bench", bench_recordings("d2"), "d2_walk"
    without = bench_recordings("d2", pressures=False)
    yield "bench, dead band, no pressures", "knee_bench", without, "d2_walk"
    yield "pendulum, backlash", PENDULUM.model, rig_recordings(PENDULUM, play=0.03), "multisine"
    lossy = rig_recordings(PENDULUM, gear_loss=0.15)
    yield "pendulum, load friction", PENDULUM.model, lossy, "multisine"
    uneven = rig_recordings(SLIDE_AXIS, forward=8.0, viscous_factor=1.05)
    yield "axis, uneven friction", SLIDE_AXIS.model, uneven, "multisine"


def plain(value):
    """The same as JSON holds it; the time that a diagnosis took is left out."""
    if is_dataclass(value):
        return plain({k: v for k, v in asdict(value).items() if k != "seconds"})
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, (str, bool, int)) or value is None:
        return value
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    return str(value)


def differences(kept, now, where=""):
    """Where two results differ, a line each."""
    if isinstance(kept, float) and isinstance(now, (float, int)):
        if not math.isclose(kept, now, rel_tol=TOLERANCE, abs_tol=1e-12):
            yield f"{where}: {kept!r} became {now!r}"
    elif isinstance(kept, dict) and isinstance(now, dict):
        for key in sorted({*kept, *now}):
            if key not in kept or key not in now:
                yield f"{where}.{key}: only {'after' if key in now else 'before'}"
            else:
                yield from differences(kept[key], now[key], f"{where}.{key}")
    elif isinstance(kept, list) and isinstance(now, list) and len(kept) == len(now):
        for i, pair in enumerate(zip(kept, now, strict=True)):
            yield from differences(*pair, f"{where}[{i}]")
    elif kept != now:
        yield f"{where}: {kept!r} became {now!r}"


def measure(runs_only):
    tasks = [(name, text, seed) for name, text in RUNS.items() for seed in SEEDS]
    results = {"runs": dict(Parallel(n_jobs=2)(delayed(run_digests)(*task) for task in tasks))}
    if runs_only:
        return results
    results["diagnoses"] = {}
    for name, model, recordings, held_out in diagnoses():
        result, _ = diagnose(model, recordings, held_out=(held_out,))
        results["diagnoses"][name] = plain(result)
        print(f"{name}: {result.verdict}", *(effect.name for effect in result.effects), flush=True)
    return results


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs-only", action="store_true", help="leave the diagnoses out")
    parser.add_argument("--write", type=Path, metavar="FILE", help="keep the results")
    parser.add_argument("--compare", type=Path, metavar="FILE", help="with results that were kept")
    options = parser.parse_args()
    results = json.loads(json.dumps(measure(options.runs_only)))
    print(", ".join(f"{len(part)} {name}" for name, part in results.items()))
    if options.write:
        options.write.write_text(json.dumps(results, indent=1) + "\n")
    if options.compare:
        kept = json.loads(options.compare.read_text())
        found = [line for name in results for line in differences(kept[name], results[name], name)]
        print("\n".join(found) if found else f"no difference to {options.compare}")
        sys.exit(bool(found))


if __name__ == "__main__":
    main()
