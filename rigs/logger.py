"""Simulates a rig and writes its logger's files: `python -m rigs.logger`.

The rig is the bench of the blind tests with hidden faults; its files are those of somebody else's
data logger: CSV, columns and units of its own, an encoder that counts the other way, a clock with
jitter and lost rows, one row written twice. It serves the tutorial and tries before a real rig is
there.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from leglab.base.errors import LeglabError, SettingsError
from leglab.base.output import cannot_write, write_atomically
from leglab.base.recording import Recording
from rigs.bench import FAULTS, FaultyBench, HiddenValue, detuned, references

JITTER = 1e-5  # s, standard deviation of the logger's clock
LOST = 5e-4  # share of rows that never reach the file
FULL_COMMAND = 10.0  # V
# Name and format in the logger's file; a position counts against ours.
_COLUMNS = {"t_ms": "%.3f", "enc_deg": "%.5f", "valve_V": "%.5f"}
_PRESSURES = {"cap_bar": "%.3f", "rod_bar": "%.3f"}


@dataclass(frozen=True, kw_only=True)
class RigSettings:
    """Hidden faults, motions and sensors of the rig."""

    effects: tuple[str, ...] = ()  #: Names of the hidden faults; severities are drawn by the seed
    #: Which recordings to make, of those of `references`.
    motions: tuple[str, ...] = ("multisine", "slow", "walk")
    seconds: float = 6.0  #: Length of each [s]
    pressures: bool = True  #: Whether the rig has pressure sensors
    seed: int = 0  #: Of everything random


def record(settings: RigSettings) -> tuple[dict[str, Recording], tuple[HiddenValue, ...]]:
    """Runs the rig.

    Returns:
        Recordings by motion, with our names and units, and the hidden severities.

    Raises:
        LeglabError: A fault or a motion is not known, or the time is too short.
    """
    if not settings.seconds >= 1.0:
        told = f"seconds is {settings.seconds:g}; allowed: "
        raise SettingsError(told, given=settings.seconds, allowed="1 or more")
    for name in settings.effects:
        if name not in FAULTS:
            raise SettingsError.unknown("fault of the rig", name, FAULTS)
    rng = np.random.default_rng([settings.seed, 0])
    plant = FaultyBench()
    detuned(plant, rng)
    severities = tuple(FAULTS[name](plant, rng) for name in settings.effects)
    motions = references(rng, settings.seconds)
    for name in settings.motions:
        if name not in motions:
            raise SettingsError.unknown("motion of the rig", name, motions)
    found = {}
    for i, name in enumerate(settings.motions):
        found[name] = plant.record(motions[name], np.random.default_rng([settings.seed, 1, i]))
    return found, severities


def logged(recording: Recording, *, pressures: bool, rng: np.random.Generator) -> bytes:
    """The content of the logger's file: CSV with its own names, units, sign and clock."""
    count = len(recording)
    jitter = np.clip(JITTER * rng.standard_normal(count), -3.0 * JITTER, 3.0 * JITTER)
    time = recording.time + jitter - jitter[0]
    sampled = {
        name: np.interp(time, recording.time, values) for name, values in recording.columns.items()
    }
    # Held over its millisecond, whenever in it the logger looks.
    command = FULL_COMMAND * recording["knee_valve_command"]
    columns = [1e3 * time, -np.degrees(sampled["knee_position"]), command]
    formats = dict(_COLUMNS)
    if pressures:
        columns += [1e-5 * sampled["knee_pressure_a"], 1e-5 * sampled["knee_pressure_b"]]
        formats |= _PRESSURES
    keep = rng.random(count) >= LOST
    keep[[0, -1]] = True
    rows = [
        ",".join(form % value for form, value in zip(formats.values(), row, strict=True))
        for row in np.stack(columns, axis=1)[keep]
    ]
    rows.insert(len(rows) // 2, rows[len(rows) // 2])  # a buffer that was written out twice
    return ("\n".join([",".join(formats), *rows]) + "\n").encode()


def write_rig(settings: RigSettings, folder: Path) -> list[Path]:
    """Writes one CSV file a motion, and `truth.txt`.

    Returns:
        Paths of the recordings.

    Raises:
        LeglabError: As `record`, or the folder cannot be written to.
    """
    recordings, severities = record(settings)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_write(folder, error) from error
    paths = []
    for i, (name, recording) in enumerate(recordings.items()):
        rng = np.random.default_rng([settings.seed, 2, i])
        content = logged(recording, pressures=settings.pressures, rng=rng)
        paths.append(folder / f"{name}.csv")
        _write(paths[-1], content)
    lines = [
        f"{name}: {hidden.parameter or 'size'} = {hidden.value:.5g}\n"
        for name, hidden in zip(settings.effects, severities, strict=True)
    ]
    _write(folder / "truth.txt", ("".join(lines) or "nothing is hidden\n").encode())
    return paths


def _write(path: Path, content: bytes) -> None:
    write_atomically(path, lambda file: file.write(content))


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line."""
    defaults = RigSettings()
    parser = argparse.ArgumentParser(prog="rigs.logger", description=__doc__)
    parser.add_argument("folder", type=Path, help="where the recordings go")
    parser.add_argument("--effect", action="append", default=[], help="hidden fault; repeatable")
    parser.add_argument("--motion", action="append", help="recording to make; repeatable")
    parser.add_argument("--seconds", type=float, default=defaults.seconds, help="of each recording")
    parser.add_argument("--no-pressures", action="store_true", help="a rig with an encoder alone")
    parser.add_argument("--seed", type=int, default=defaults.seed)
    options = parser.parse_args(arguments)
    settings = RigSettings(
        effects=tuple(options.effect),
        motions=tuple(options.motion or defaults.motions),
        seconds=options.seconds,
        pressures=not options.no_pressures,
        seed=options.seed,
    )
    try:
        paths = write_rig(settings, options.folder)
    except LeglabError as error:
        raise SystemExit(f"error: {error}") from None
    for path in paths:
        print(f"written to {path}")


if __name__ == "__main__":
    main()
