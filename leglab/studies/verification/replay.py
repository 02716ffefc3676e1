"""Replay of knee-bench recordings: the measured command drives the model over short windows."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.table import Table

from leglab.studies.verification.bench import (
    SAMPLING_PERIOD,
    WINDOW,
    KneeBench,
    Recording,
    read_recording,
    reconstruct,
)

# RMS at a window's end that is asked for: knee [rad], pressures [Pa].
LIMITS = {
    "multisine": (0.3e-3, 0.6e5),
    "slow": (0.3e-3, 0.6e5),
    "walk": (0.3e-3, 0.6e5),
    "steps": (3e-3, 2e5),
}
# A chamber this low may hold vapour, whose amount no pressure sensor tells.
_CAVITATION = 0.0  # Pa gauge


@dataclass(frozen=True, kw_only=True)
class Replay:
    """Errors at the ends of the windows of one recording.

    Attributes:
        recording: Its name.
        windows: "tiling" or "every 0.1 s".
        timestep: s.
        position: RMS error of the knee [rad].
        pressure_a: RMS error [Pa].
        pressure_b: RMS error [Pa].
        count: Number of windows.
        vapour: Starts in s of windows that begin with a chamber at or below atmospheric pressure.
        position_without_vapour: RMS error of the knee without those [rad].
        asked: Whether the limits of the recording apply.
    """

    recording: str
    windows: str
    timestep: float
    position: float
    pressure_a: float
    pressure_b: float
    count: int
    vapour: tuple[float, ...]
    position_without_vapour: float
    asked: bool

    @property
    def passed(self) -> bool:
        """Whether the errors, those of vapour windows included, are within the limits."""
        knee, pressure = LIMITS[self.recording]
        good = self.position <= knee and max(self.pressure_a, self.pressure_b) <= pressure
        return good or not self.asked


def replay(recording: Recording, timestep: float) -> tuple[Replay, Replay]:
    """Replays windows that tile the recording, and windows that start every 0.1 s.

    Args:
        recording: Measured on the bench.
        timestep: Of the model [s]; divides the sampling period.

    Returns:
        Errors of the tiling windows, which are held against the limits, and of all windows.
    """
    rig = KneeBench(timestep)
    starts = reconstruct(recording, rig)
    # Raw samples: a filter would smear what a stepped valve does to the pressures.
    measured = np.stack([recording.position, recording.pressure_a, recording.pressure_b], axis=1)
    firsts = np.arange(0, len(recording.position) - WINDOW, 100)
    errors = np.array(
        [rig.run(starts, recording.command, int(k)) - measured[k + WINDOW] for k in firsts]
    )
    low = np.minimum(starts.pressure_a, starts.pressure_b)[firsts] <= _CAVITATION

    def result(chosen: np.ndarray, windows: str, asked: bool) -> Replay:
        def rms(values: np.ndarray) -> np.ndarray:
            return np.sqrt(np.mean(values**2, axis=0))

        knee, pressure_a, pressure_b = rms(errors[chosen])
        return Replay(
            recording=recording.name,
            windows=windows,
            timestep=timestep,
            position=float(knee),
            pressure_a=float(pressure_a),
            pressure_b=float(pressure_b),
            count=int(chosen.sum()),
            vapour=tuple((SAMPLING_PERIOD * firsts[chosen & low]).round(1).tolist()),
            position_without_vapour=float(rms(errors[chosen & ~low])[0]),
            asked=asked,
        )

    return (
        result(firsts % WINDOW == 0, "tiling", True),
        result(np.ones(len(firsts), dtype=bool), "every 0.1 s", False),
    )


def replay_all(folder: Path) -> Iterator[Replay]:
    """Replays every nominal recording at steps of 0.5 and 1 ms."""
    for name in LIMITS:
        recording = read_recording(folder / f"{name}.parquet")
        for timestep in (0.5e-3, 1e-3):
            yield from replay(recording, timestep)


def table(results: list[Replay]) -> Table:
    """RMS errors at window ends beside what is asked, failures in red."""
    grid = Table(title="Replay of knee_bench/nominal over 0.3 s windows", title_justify="left")
    for heading in (
        "recording",
        "windows",
        "step ms",
        "knee mrad",
        "pA bar",
        "pB bar",
        "asked",
        "start in vapour at s",
        "knee without",
    ):
        grid.add_column(heading)
    for r in results:
        knee, pressure = LIMITS[r.recording]
        grid.add_row(
            r.recording,
            f"{r.windows} ({r.count})",
            f"{r.timestep * 1e3:g}",
            f"{r.position * 1e3:.3f}",
            f"{r.pressure_a / 1e5:.2f}",
            f"{r.pressure_b / 1e5:.2f}",
            f"{knee * 1e3:g} / {pressure / 1e5:g}" if r.asked else "",
            ", ".join(f"{t:g}" for t in r.vapour),
            f"{r.position_without_vapour * 1e3:.3f}" if r.vapour else "",
            style=None if r.passed else "bold red",
        )
    return grid
