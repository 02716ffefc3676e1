"""Replay of knee-bench recordings by the diagnosis: measured commands drive the model."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from leglab.base.recording import Recording
from leglab.base.scale import rms
from leglab.data import read
from leglab.diagnosis.plant.model import Change, Machine
from leglab.diagnosis.replay.replay import Replay
from leglab.diagnosis.replay.windows import UniformSeries, channels
from leglab.diagnosis.thresholds import Thresholds

# Largest allowed RMS error at a window's end: knee [rad], pressures [Pa].
LIMITS = {
    "multisine": (0.3e-3, 0.6e5),
    "slow": (0.3e-3, 0.6e5),
    "walk": (0.3e-3, 0.6e5),
    "steps": (3e-3, 2e5),
}
_WINDOW = 0.3  # s
_SHIFTS = (0.0, 0.1, 0.2)  # s, so that windows begin every 0.1 s


@dataclass(frozen=True)
class ReplayCheck:
    """Errors at the ends of the windows of one recording."""

    recording: str  #: Name of the recording
    timestep: float  #: Time step of the model [s]
    position: float  #: RMS error of the knee [rad]
    pressure_a: float  #: RMS error [Pa]
    pressure_b: float  #: RMS error [Pa]
    count: int  #: Number of windows

    @property
    def passed(self) -> bool:
        """True if the errors are within the limits of the recording."""
        knee, pressure = LIMITS[self.recording]
        return self.position <= knee and max(self.pressure_a, self.pressure_b) <= pressure


def replay(
    name: str,
    recording: Recording,
    timestep: float,
    parameters: Mapping[tuple[str, str], float] | None = None,
) -> ReplayCheck:
    """Replays windows that start from measured states, about one every 0.1 s.

    Each starts at the calmest sample nearby, because a jump of the command distorts the measured
    states. None starts with vapour in a chamber, since pressure sensors do not show its amount.

    Args:
        name: Name of the recording, one of `LIMITS`.
        recording: Recording of the bench.
        timestep: Time step of the model [s]; divides the sampling period.
        parameters: Plugin parameters that differ from the model, by element and name.
    """
    machine = Machine("knee_bench", timestep=timestep)
    seen = channels(machine, {name: recording})
    columns = (*machine.columns, *(c.column for c in seen if c.chamber))
    start, end = recording.time[0], recording.time[-1] + 1.0
    series = [
        UniformSeries.from_recording(recording.between(start + shift, end), name, columns)
        for shift in _SHIFTS
    ]
    change = Change(machine)
    for (element, parameter), value in (parameters or {}).items():
        change.set_parameter(element, parameter, value)
    cut = Thresholds(window=_WINDOW, bin=series[0].period, still_every=1)
    errors = Replay(machine, series, seen, cut, threads=1).error(change).values[:, :, -1]
    knee, pressure_a, pressure_b = rms(errors, axis=0).tolist()
    return ReplayCheck(name, timestep, knee, pressure_a, pressure_b, len(errors))


def replay_all(folder: Path) -> Iterator[ReplayCheck]:
    """Replays every nominal recording at steps of 0.5 and 1 ms."""
    for name in LIMITS:
        recording = read(folder / f"{name}.parquet")
        for timestep in (0.5e-3, 1e-3):
            yield replay(name, recording, timestep)
