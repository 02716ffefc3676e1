"""Recordings made unpleasant on purpose, and what the diagnosis makes of them.

`python -m tests.helpers.unpleasant [CASE ...]` diagnoses each case and prints a table. In every
case the fault is known, so that a name, a size and a gap tell whether the gate read the logs
rightly.
"""

import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from leglab import data
from leglab.base.recording import Recording
from leglab.diagnosis.intake.recordings import read_recordings
from leglab.diagnosis.verdict.verdict import diagnose
from rigs import PENDULUM, SLIDE_AXIS, Hidden, Truth, record, record_linkage
from rigs.simulator import Rig

KINDS = ("multisine", "fast", "slow", "stairs")
FRICTION = Truth(forward=8.0, viscous_factor=1.05)
GEAR = Truth(gear_loss=0.15)
BENCH = Path(__file__).parents[1] / "data" / "diagnosis"
# Counts of the encoders that are quantised: a usual one, and one of the slide.
COUNT = {"hinge": 2.0 * np.pi / 16384, "axis": 2e-5}

Spoil = Callable[[Recording, np.random.Generator], Recording]


def even(rate: float, seconds: float = 8.0) -> np.ndarray:
    """Stamps of a uniform clock."""
    return np.arange(round(seconds * rate)) / rate


def jittered(rate: float, share: float, rng: np.random.Generator, seconds: float = 8.0):
    """Stamps of a loop that wakes up early or late by up to a share of its period."""
    stamps = even(rate, seconds)
    return stamps + np.append(0.0, rng.uniform(-share, share, stamps.size - 1)) / rate


def drifting(rate: float, share: float, seconds: float = 8.0) -> np.ndarray:
    """Stamps of a clock whose period grows by a share until the end."""
    stamps = even(rate, seconds)
    return stamps + 0.5 * share * stamps**2 / seconds


def thinned(recording: Recording, keep: np.ndarray) -> Recording:
    """The rows of a mask."""
    columns = {name: samples[keep] for name, samples in recording.columns.items()}
    return Recording(time=recording.time[keep], columns=columns, metadata=recording.metadata)


def dropped(recording: Recording, share: float, rng: np.random.Generator) -> Recording:
    """Without a share of its rows, lost at random."""
    keep = rng.random(len(recording)) >= share
    keep[[0, -1]] = True
    return thinned(recording, keep)


def changed(recording: Recording, column: str, function) -> Recording:
    """With one column changed."""
    return recording.with_columns({column: function(recording[column].copy())})


def wrapped(recording: Recording, column: str, turn: float) -> Recording:
    """An encoder that begins anew after a turn."""
    return changed(recording, column, lambda q: (q + 0.5 * turn) % turn - 0.5 * turn)


def counted(recording: Recording, joint: str) -> Recording:
    """An encoder with counts, which floats do not hold exactly."""
    step = COUNT[joint]
    return changed(recording, f"{joint}_position", lambda q: np.rint(q / step) * step)


def holed(recording: Recording, runs: int, length: int, rng: np.random.Generator) -> Recording:
    """Runs of NaN in every column, each at its own places."""
    columns = {}
    for name, samples in recording.columns.items():
        samples = samples.copy()
        for first in rng.integers(0, len(recording) - length, runs).tolist():
            samples[first : first + length] = np.nan
        columns[name] = samples
    return recording.with_columns(columns)


@dataclass(frozen=True, kw_only=True)
class Spoiled:
    """A case.

    Attributes:
        what: Is unpleasant.
        model: Of the machine.
        recordings: By name.
        held_out: The recording that judges.
        hidden: Name of the effect, parameter and its true value.
    """

    what: str
    model: Path | str
    recordings: Mapping[str, Recording]
    held_out: str
    hidden: tuple[str, str, float]


LOAD = ("load_dependent_friction", "actuator", 0.15)
SIDES = ("asymmetric_friction", "viscous_forward-viscous_backward", 8.0)
LAP = ("valve_deadband", "lap", 0.065)


def of_rig(rig: Rig, truth: Truth, kinds=KINDS, stamps=(None,) * 4) -> dict[str, Recording]:
    """Recordings of a rig, each by a clock of its own."""
    return {
        kind: record(rig, kind, truth, seed=seed, stamps=clock)
        for seed, (kind, clock) in enumerate(zip(kinds, stamps, strict=True))
    }


def axis(kinds=KINDS, stamps=(None,) * 4) -> dict[str, Recording]:
    """Recordings of the slide with friction of two sides."""
    return of_rig(SLIDE_AXIS, FRICTION, kinds, stamps)


def wheel(stamps=(None,) * 4) -> dict[str, Recording]:
    """The pendulum going round and round, with a worn gear."""
    return of_rig(PENDULUM, GEAR, ("turns", "back", "multisine", "fast"), stamps)


def wrapped_wheel_of(turn: float) -> dict[str, Recording]:
    """The same by an encoder that begins anew."""
    return {n: wrapped(r, "hinge_position", turn) for n, r in wheel().items()}


def of_bench(case="d2") -> dict[str, Recording]:
    """Recordings of the hydraulic bench: "nominal", or "d2" with a hidden deadband."""
    return {n: data.read(BENCH / f"{case}_{n}.parquet") for n in ("multisine", "slow", "walk")}


def of_kinds(rig, truth, kinds, *, seconds: float, first: int = 0) -> dict[str, Recording]:
    """Recordings of a rig or linkage by kind of motion, each with a seed of its own."""
    of = record_linkage if isinstance(truth, Hidden) else record
    return {k: of(rig, k, truth, seed=first + i, seconds=seconds) for i, k in enumerate(kinds)}


def on_axis(what: str, recordings: Mapping[str, Recording], held_out="multisine") -> Spoiled:
    return Spoiled(
        what=what,
        model=SLIDE_AXIS.model,
        recordings=recordings,
        held_out=held_out,
        hidden=SIDES,
    )


def on_wheel(what: str, recordings: Mapping[str, Recording]) -> Spoiled:
    return Spoiled(
        what=what,
        model=PENDULUM.model,
        recordings=recordings,
        held_out="multisine",
        hidden=LOAD,
    )


def clean_axis() -> Spoiled:
    return on_axis("nothing: for comparison", axis())


def clean_wheel() -> Spoiled:
    return on_wheel("nothing: a wheel that turns by up to 50 rad, not wrapped", wheel())


def wrapped_wheel() -> Spoiled:
    what = "a wheel turns by up to 50 rad, its encoder begins anew after 2 pi"
    return on_wheel(what, wrapped_wheel_of(2.0 * np.pi))


def geared_encoder() -> Spoiled:
    rng = np.random.default_rng(1)
    found = wrapped_wheel_of(2.0 * np.pi / 5.0)
    what = "encoder before a gear of 5 (begins anew after 1.257 rad), 30 % of the rows lost"
    return on_wheel(what, {n: dropped(r, 0.3, rng) for n, r in found.items()})


def mixed_rates() -> Spoiled:
    clocks = (even(1000), even(500), even(400), even(1000))
    return on_axis("loops at 1000, 500, 400 and 1000 Hz", axis(stamps=clocks))


def uneven() -> Spoiled:
    rng = np.random.default_rng(2)
    clocks = tuple(jittered(1000, share, rng) for share in (0.4, 0.3, 0.5, 0.4))
    what = "every stamp early or late by up to 30 to 50 % of a period"
    return on_axis(what, axis(stamps=clocks))


def lossy() -> Spoiled:
    rng = np.random.default_rng(3)
    found = {n: dropped(r, 0.3, rng) for n, r in axis().items()}
    return on_axis("30 % of all rows lost at random", found)


def own_clocks() -> Spoiled:
    clocks = (even(1000), even(1000.4), even(999.0), drifting(1000, 4e-3))
    found = {
        n: Recording(time=r.time + 1.75e9, columns=r.columns)
        for n, r in axis(stamps=clocks).items()
    }
    what = "clocks of 1000, 1000.4 and 999 Hz, one that slows down by 0.4 %; stamps since 1970"
    return on_axis(what, found)


def resting() -> Spoiled:
    found = axis(("multisine", "rests", "slow", "rests"))
    still = next(iter(found.values()))
    columns = {n: np.full(3000, s[0]) for n, s in still.columns.items()}
    found["idle"] = Recording(
        time=still.time[:3000], columns=columns | {"drive_command": 0.0 * columns["drive_command"]}
    )
    what = "counts of 0.02 mm; two recordings rest half of the time, a third never moves"
    return on_axis(what, {n: counted(r, "axis") for n, r in found.items()})


def junk() -> Spoiled:
    """CSV files with all kinds of columns that nobody needs, two of them of one name."""
    rng = np.random.default_rng(5)
    with tempfile.TemporaryDirectory() as folder:
        paths = []
        for name, r in axis().items():
            junk_columns = {
                "comment": lambda i: "ok" if i % 7 else "limit",
                "motor_temperature": lambda i: "",
                "spare": lambda i: "0",
                "spare_pressure_a": lambda i: "3.2",
                "velocity": lambda i: f"{rng.normal():.3f}",
                "torque": lambda i: "inf" if i % 2 else "1e300",
            }
            header = ["time", *r.columns, *junk_columns, "velocity"]
            rows = zip(r.time.tolist(), *(s.tolist() for s in r.columns.values()), strict=True)
            lines = [
                ",".join([*map(repr, row), *(make(i) for make in junk_columns.values()), "1"])
                for i, row in enumerate(rows)
            ]
            path = Path(folder) / f"{name}.csv"
            path.write_text("\n".join([",".join(header), *lines]) + "\n")
            paths.append(path)
        recordings = read_recordings(paths)
    what = "columns nobody needs: text, empty, constant, infinite, bar for Pa, one name twice"
    return on_axis(what, recordings, "multisine.csv")


def holes() -> Spoiled:
    rng = np.random.default_rng(6)
    found = {n: holed(r, 6, 30, rng) for n, r in axis().items()}
    return on_axis("six runs of 30 ms without numbers in each column", found)


def lost_pressures() -> Spoiled:
    found = of_bench()
    slow = found["slow"]
    columns = dict(slow.columns)
    columns["knee_pressure_b"] = np.full(len(slow), np.nan)
    found["slow"] = Recording(time=slow.time, columns=columns)
    return Spoiled(
        what="hydraulic bench: a pressure is lost in one of three files",
        model="knee_bench",
        recordings=found,
        held_out="walk",
        hidden=LAP,
    )


def degrees() -> Spoiled:
    found = wheel()
    found["back"] = changed(found["back"], "hinge_position", np.rad2deg)
    return on_wheel("one of four files is in degrees by mistake, on a wheel", found)


def everything() -> Spoiled:
    rng = np.random.default_rng(8)
    clocks = (jittered(1000, 0.4, rng), even(1000.4), even(500), drifting(1000, 2e-3))
    found = wheel(clocks)
    found = {n: wrapped(counted(r, "hinge"), "hinge_position", 2 * np.pi) for n, r in found.items()}
    found["turns"] = dropped(found["turns"], 0.3, rng)
    found["fast"] = holed(found["fast"], 4, 30, rng)
    what = "jitter, lost rows, 500 Hz, drift, counts, runs without numbers, wrapped: all at once"
    return on_wheel(what, found)


CASES: dict[str, Callable[[], Spoiled]] = {
    f.__name__: f
    for f in (
        clean_axis,
        mixed_rates,
        uneven,
        lossy,
        own_clocks,
        resting,
        junk,
        holes,
        clean_wheel,
        wrapped_wheel,
        geared_encoder,
        degrees,
        everything,
        lost_pressures,
    )
}


def size_of(result, parameter: str) -> float:
    """Value of a parameter of the first effect, or a difference of two."""
    values = {p.name: p.value for p in result.effects[0].parameters} if result.effects else {}
    first, _, second = parameter.partition("-")
    return values.get(first, np.nan) - (values.get(second, np.nan) if second else 0.0)


def main(names: list[str]) -> None:
    print("| unpleasant | verdict | named | true | found | gap before > after | windows |")
    print("|---|---|---|---|---|---|---|")
    for name in names or CASES:
        case = CASES[name]()
        result, found = diagnose(case.model, case.recordings, held_out=(case.held_out,))
        _, parameter, value = case.hidden
        named = ", ".join(e.name for e in result.effects) or "nothing"
        print(
            f"| {case.what} | {result.verdict} | {named} | {value:g} | "
            f"{size_of(result, parameter):.4g} | {result.gap.before:.3g} > {result.gap.after:.3g} |"
            f" {found.problem.replay.windows} |",
            flush=True,
        )
        for note in result.notes:
            print(f"    {note}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
