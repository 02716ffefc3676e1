"""An unknown torque of position, drawn at random: described with its period, and its gap closed.

The period is drawn between a fifth of the position's range and all of it, amplitude and phase as
well. `python benchmarks/diagnosis_remainder.py` writes a table row by row.
"""

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from leglab.base.recording import Recording
from leglab.diagnosis.improve import improve
from leglab.diagnosis.intake.recordings import split_held_out
from leglab.diagnosis.search.pipeline import DiagnosisSettings
from rigs import PENDULUM, SERVO_JOINT, Hidden, Truth, record, record_linkage
from rigs.bench import FaultyBench, references
from rigs.measured import EMPS_HELD_OUT, EMPS_MODEL, emps, rough_bench

# Effects that would name it, so that its vocabulary is open.
EXCLUDED = ("position_torque", "harmonic_torque", "cogging", "torque_ripple")
KINDS = ("multisine", "fast", "slow", "stairs")


@dataclass(frozen=True)
class Draw:
    """A ripple: amplitude [N m], period [rad], phase."""

    amplitude: float
    period: float
    phase: float


Recorder = Callable[[np.random.Generator], tuple[dict[str, Recording], Draw]]


def draw(rng: np.random.Generator, span: float, low: float, high: float) -> Draw:
    amplitude = math.exp(rng.uniform(math.log(low), math.log(high)))
    return Draw(amplitude, span * rng.uniform(0.2, 1.0), rng.uniform(0.0, 2.0 * math.pi))


def bench(rng: np.random.Generator) -> tuple[dict[str, Recording], Draw]:
    motions = references(rng, duration=8.0)
    span = max(m.max() for m in motions.values()) - min(m.min() for m in motions.values())
    hidden = draw(rng, float(span), 1.5, 10.0)
    plant = FaultyBench()
    plant.fields.append(
        lambda q: hidden.amplitude * math.sin(2.0 * math.pi * q / hidden.period + hidden.phase)
    )
    return {name: plant.record(m, rng) for name, m in motions.items()}, hidden


def pendulum(rng: np.random.Generator) -> tuple[dict[str, Recording], Draw]:
    hidden = draw(rng, 1.8, 0.15, 1.0)
    truth = Truth(ripple=(hidden.amplitude, hidden.period, hidden.phase))
    seed = int(rng.integers(1 << 30))
    return {k: record(PENDULUM, k, truth, seed=seed + i) for i, k in enumerate(KINDS)}, hidden


def servo(rng: np.random.Generator) -> tuple[dict[str, Recording], Draw]:
    hidden = draw(rng, 1.8, 0.15, 1.0)
    truth = Hidden(ripple=(hidden.amplitude, hidden.period, hidden.phase))
    seed = int(rng.integers(1 << 30))
    kinds = enumerate(KINDS)
    return {k: record_linkage(SERVO_JOINT, k, truth, seed=seed + i) for i, k in kinds}, hidden


RIGS: dict[str, tuple[str | Path, Recorder]] = {
    "knee bench": ("knee_bench", bench),
    "pendulum": (PENDULUM.model, pendulum),
    "servo joint": (SERVO_JOINT.model, servo),
}


def measured() -> None:
    """Two machines that differ from their models everywhere; see LEGLAB_DATA."""
    specimen, later = rough_bench("e0")
    cases = {
        "rough bench e0": ("knee_bench", specimen, later),
        "EMPS": (EMPS_MODEL, emps(), (EMPS_HELD_OUT,)),
    }
    print("| machine | held out | noise levels | after 0.3 s | learned |")
    print("|---|---|---|---|---|")
    for name, (model, recordings, held) in cases.items():
        result, _ = improve(model, recordings, held_out=held, effects=False)
        for row in (r for r in result.recordings if r.held_out):
            si = dict(zip(result.units.values(), result.units, strict=True))
            cells = []
            for unit, factor, text in (("rad", 1e3, "mrad"), ("m", 1e3, "mm"), ("Pa", 1e-5, "bar")):
                if unit in si:
                    before, after = (factor * e for e in row.at_horizon[si[unit]])
                    cells.append(f"{before:.2f} > {after:.2f} {text}")
            levels = "{:.0f} > {:.0f}".format(*row.noise_levels)
            print(f"| {name} | {row.recording} | {levels} | {', '.join(cells)} | |", flush=True)
        closed = f"**{result.closed_fraction:.0%} closed**"
        print(f"| {name} | all | {closed} | | {result.words} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--rig", choices=[*RIGS], nargs="*", default=[*RIGS])
    parser.add_argument("--effects", action="store_true", help="look for effects first")
    parser.add_argument("--measured", action="store_true", help="rough bench e0 and EMPS instead")
    options = parser.parse_args()
    if options.measured:
        measured()
        return
    print("| rig | hidden | in words | period off | gap before > after | closed |")
    print("|---|---|---|---|---|---|")
    for name in options.rig:
        model, recorder = RIGS[name]
        right, closed = 0, []
        for seed in range(options.first, options.first + options.draws):
            recordings, hidden = recorder(np.random.default_rng(7000 + seed))
            recordings, held = split_held_out(model, recordings, [])
            result, _ = improve(
                model,
                recordings,
                held_out=held,
                effects=options.effects,
                settings=DiagnosisSettings(excluded=EXCLUDED),
            )
            parts = result.remainder["parts"] if result.remainder else []
            periods = [s["period"]["length"] for p in parts for s in p["shapes"] if s["period"]]
            off = min((abs(p / hidden.period - 1.0) for p in periods), default=math.inf)
            gap = next(r.noise_levels for r in result.recordings if r.held_out)
            right += off <= 0.03
            closed.append(result.closed_fraction)
            print(
                f"| {name} | {hidden.amplitude:.2f} N m every {hidden.period:.3f} rad | "
                f"{result.words} | {off:.2%} | {gap[0]:.1f} > {gap[1]:.2f} | "
                f"{result.closed_fraction:.3f} |",
                flush=True,
            )
        print(
            f"| {name} | **{options.draws} draws** | | **{right} within 3 %** | | "
            f"**median {np.median(closed):.3f}** |",
            flush=True,
        )


if __name__ == "__main__":
    main()
