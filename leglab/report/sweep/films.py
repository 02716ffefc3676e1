"""Films of the worst runs of a sweep."""

from collections.abc import Callable, Sequence
from pathlib import Path

from leglab.report.film import render_film
from leglab.runs import record
from leglab.runs.record import CONFIGURATION, RunConfiguration
from leglab.runs.sweeps.engine import read_sweep, record_runs

# Default time shown before the change of the machine, and default length of a film [s].
_BEFORE, LENGTH = 2.0, 8.0


def film_runs(
    folder: Path,
    numbers: Sequence[int],
    place: Path,
    *,
    start: float | None = None,
    duration: float | None = None,
    camera: str,
    progress: Callable[[float], None] = lambda _: None,
) -> dict[int, Path]:
    """Repeats single runs of a sweep, with recordings, and films them.

    Args:
        folder: Folder of the sweep; recordings go to its folder `recordings`.
        numbers: Numbers of the runs.
        place: Folder for the films, each `run-NUMBER.mp4`.
        start: Time at which the films start [s]; None for two seconds before the change.
        duration: Duration of a film [s]; None for `LENGTH`.
        camera: Name of a camera of the models.
        progress: Function called with the share of the work that is done.

    Returns:
        Paths of the films, by the number of the run.

    Raises:
        LeglabError: A run fails without a recording, or `leglab.report.film.render_film` fails.
    """
    plan, films = read_sweep(folder).plan, {}
    for done, number in enumerate(numbers):
        (recorded,) = record_runs(plan, folder, [number])
        first = start
        if first is None:
            told = record.read(RunConfiguration, recorded / CONFIGURATION)
            changes = [change.start for change in told.changes]
            first = max(min(changes, default=0.0) - _BEFORE, 0.0)

        def tell(share: float, done: int = done) -> None:
            progress((done + share) / len(numbers))

        films[number] = render_film(
            [recorded],
            place / f"run-{number}.mp4",
            start=first,
            duration=LENGTH if duration is None else duration,
            camera=camera,
            progress=tell,
        )
    return films
