"""Execution of a sweep: makes its missing runs, on this machine or on a Dask cluster."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import pyarrow as pa

from leglab import __version__
from leglab.base import plugins
from leglab.base.errors import FileError, RecordingError, SettingsError
from leglab.base.notebook import html_table, panels
from leglab.base.output import cannot_write, claimed_folder, remove, write_json
from leglab.jobs.engine import Progress, executor, make_missing
from leglab.jobs.fingerprint import fingerprint
from leglab.machine.files import model_digest
from leglab.runs.folder import make_runs
from leglab.runs.sweeps import store, tuning
from leglab.runs.sweeps.growth import grow
from leglab.runs.sweeps.making import figures_of
from leglab.runs.sweeps.outcome import recording_folder
from leglab.runs.sweeps.plan import SweepPlan
from leglab.runs.sweeps.query import ask
from leglab.runs.sweeps.rows import column

_ERRORS = "SELECT scenario, controller, {0} FROM runs WHERE {0} IS NOT NULL ORDER BY run"
_MEDIANS = """SELECT scenario, controller, count(*), count(*) FILTER (status = 'failed'),
 1e3 * median(rms_rad), 1e3 * median(end_rad), 100 * median(recovered), median(t90_s)
 FROM runs GROUP BY scenario, controller ORDER BY scenario, min(run)"""

_HEAD = (
    "scenario", "controller", "runs", "failed", "whole [mrad or mm]", "end [mrad or mm]",
    "undone [%]", "90 % undone [s], where it was",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class SweepResult:
    """Result of a sweep, complete or not.

    Attributes:
        folder: Folder of the sweep.
        plan: Plan of the sweep.
        made: Number of runs made by this call.
        done: Number of rows.
        failed: Number of rows of failed runs.
        damaged: Messages on damaged files, whose runs were made again.
    """

    folder: Path
    plan: SweepPlan
    made: int
    done: int
    failed: int
    damaged: tuple[str, ...] = ()

    def __repr__(self) -> str:
        text = f"{self.done} of {len(self.plan)} runs, {self.failed} failed"
        return f"SweepResult({text}; {self.folder})"

    def _repr_html_(self) -> str:
        rows = [
            (*row[:4], *("" if figure is None else f"{figure:.3g}" for figure in row[4:]))
            for row in ask(self.folder, _MEDIANS).rows
        ]
        return html_table(f"{self!r}; medians", _HEAD, rows)

    def plot(self) -> list[Any]:
        """Draws the RMS tracking error of every run by controller, with the median as a bar.

        The error is `end_rad`, or `rms_rad` of the whole run if no run has an `end_rad`.

        Returns:
            The axes, one per scenario, of a new `matplotlib.pyplot` figure.

        Raises:
            LeglabError: No run has an error yet.
        """
        asked = {"end_rad": "at the end", "rms_rad": "of the whole run"}
        found = {told: ask(self.folder, _ERRORS.format(name)).rows for name, told in asked.items()}
        told, rows = next((one for one in found.items() if one[1]), ("", ()))
        if not rows:
            told = f"{str(self.folder)!r} holds no run with an error to draw"
            raise RecordingError(told, given=self.folder)
        scenarios = list(dict.fromkeys(row[0] for row in rows))
        axes = panels(len(scenarios), height=0.5 + 0.3 * len({row[1] for row in rows}))
        for axis, scenario in zip(axes, scenarios, strict=True):
            errors: dict[str, list[float]] = {}
            for _, controller, error in (row for row in rows if row[0] == scenario):
                errors.setdefault(controller, []).append(1e3 * error)
            axis.barh(list(errors), [median(each) for each in errors.values()], color="0.8")
            for controller, each in errors.items():
                axis.plot(each, [controller] * len(each), "k|", markersize=8)
            axis.set_title(scenario, fontsize="medium", loc="left")
            axis.invert_yaxis()
        axes[-1].set_xlabel(f"RMS tracking error {told} [mrad or mm]")
        return axes

    def table(self) -> pa.Table:
        """Returns all rows in the order of the runs, as a `pyarrow.Table`."""
        return store.read_rows(self.folder).to_table().sort_by("run")

    def tuned(self) -> list[tuning.Tuned]:
        """Returns the best point (values of the tuned settings) of each tuned block."""
        return tuning.tuned(self.plan, _tuning_rows(self.folder, self.plan))

    def to_pandas(self) -> Any:
        """Returns all rows as a `pandas.DataFrame`."""
        return self.table().to_pandas()


def run_sweep(
    plan: SweepPlan,
    folder: str | Path,
    *,
    workers: int = -1,
    scheduler: str | None = None,
    retry_failed: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> SweepResult:
    """Makes all runs of a plan that a folder does not hold yet.

    A row is stored as soon as its run is over: an interruption loses only the runs in progress,
    and the same call makes exactly the missing ones. A plan that contains all runs of the folder's
    sweep keeps their rows and makes the others. A failed run (figures that are not finite, an
    exception, a time-out, too much memory, a process that dies twice) gets a row with its failure
    and does not stop the sweep.

    Args:
        plan: Plan from `read_plan`, or made in Python.
        folder: Folder of the dataset; it is created.
        workers: Number of processes; -1 for one per core. Not with a scheduler.
        scheduler: Address of a Dask scheduler, for instance "tcp://10.0.0.1:8786", whose workers
            make the runs.
        retry_failed: Whether failed runs are made again.
        overwrite: Whether an existing sweep in the folder is replaced; it stays in the hidden
            folder `.earlier` there until the new one is complete.
        progress: Called with the number of rows, the number of all runs, and a status text.

    Raises:
        LeglabError: A run cannot be set up; the folder holds a run that is not in the plan, was
            begun with other code, or is being written to by another process; a process cannot be
            started; the scheduler cannot be reached.
        KeyboardInterrupt: The user interrupts; finished runs are kept.
    """
    folder = Path(folder)
    if plan.tuned:
        tuning.check_optuna({points.block.draw for points in plan.tuned})
    made_by = executor(
        figures_of, workers, scheduler, timeout=plan.timeout, memory=plan.memory, apart=True
    )
    models = plan.check(progress)
    with _begun(plan, folder, models, overwrite=overwrite) as kept:
        if retry_failed and kept.failed:
            kept.forget_failed()
        _recall(plan, folder)
        failed, before = kept.failed, kept.done
        make_missing(
            made_by,
            range(len(plan)),
            kept,
            partial(_request, plan, folder.resolve(), models),
            ready=partial(_ready, plan, folder, kept),
            told=lambda _: f"{kept.failed} failed" if kept.failed > failed else "sweeping",
            progress=progress,
        )
        kept.finish()
        store.forget_earlier(folder)
    counts = {"made": kept.done - before, "done": kept.done, "failed": kept.failed}
    return SweepResult(folder=folder, plan=plan, damaged=tuple(kept.damaged), **counts)


def record_runs(
    plan: SweepPlan, folder: str | Path, numbers: Sequence[int], *, progress: Progress | None = None
) -> list[Path]:
    """Repeats single runs of a sweep and writes their folders with recordings, to inspect them.

    Args:
        plan: Plan of the sweep.
        folder: Folder of the sweep; the runs go to `recordings` in it, its rows do not change.
        numbers: Numbers of the runs.
        progress: Called with the number of finished runs and the number of all.

    Returns:
        The folders in the order of the numbers.

    Raises:
        LeglabError: A number or a model's digest does not fit the sweep, or as in `make_runs`.
    """
    _recall(plan, Path(folder))
    for number in numbers:
        if not 0 <= number < len(plan):
            text = f"there is no run {number}; allowed: "
            raise SettingsError(text, given=number, allowed=f"0 to {len(plan) - 1}")
    places = [recording_folder(Path(folder).resolve(), number) for number in numbers]
    settings = [plan.settings(number) for number in numbers]
    models = store.read_record(Path(folder)).models
    for model in {run.model for run in settings}:
        if model_digest(model) != models[model]:
            text = f"{Path(model).name} has changed since this sweep: its runs cannot be made again"
            raise FileError(text, given=model)
    return make_runs(settings, places, overwrite=True, timeout=plan.timeout, progress=progress)


def read_sweep(folder: str | Path) -> SweepResult:
    """Reads a sweep, also one that is being made.

    Raises:
        LeglabError: The folder holds no sweep, or one of its files is damaged.
    """
    folder = Path(folder)
    plan = store.read_plan_of(folder)
    names = ["status"]
    status = store.read_rows(folder, names).to_table(names)["status"].to_pylist()
    failed = status.count(store.FAILED)
    return SweepResult(folder=folder, plan=plan, made=0, done=len(status), failed=failed)


@contextmanager
def _begun(
    plan: SweepPlan, folder: Path, models: dict[str, str], *, overwrite: bool
) -> Iterator[store.Store]:
    """Claims the folder of a sweep and yields its store of rows; `models` are digests."""
    record = store.SweepRecord(
        plan=plan.content,
        digest=plan.digest,
        code=fingerprint(),
        models=models,
        runs=len(plan),
        axes=list(plan.axes),
        version=__version__,
        load=[source for source, named in plugins.carried()["sources"].items() if named],
    )
    with claimed_folder(folder):
        _begin(folder, record, plan, overwrite=overwrite)
        with closing(store.Store(folder, plan)) as kept:
            yield kept


def _begin(folder: Path, record: store.SweepRecord, plan: SweepPlan, *, overwrite: bool) -> None:
    """Writes the record of a new sweep; an existing sweep must be the same, or it grows."""
    store.bring_back(folder)
    if overwrite and store.is_sweep(folder):
        store.put_aside(folder)
    if store.is_sweep(folder):
        there = store.read_record(folder)
        other = "give another folder, or --overwrite to begin anew"
        changed = {
            "code of leglab or of a plug-in": there.code != record.code,
            "files of its models": any(
                record.models.get(model, digest) != digest for model, digest in there.models.items()
            ),
        }
        for what in (name for name, differs in changed.items() if differs):
            text = f"{str(folder)!r} was begun with other {what}: {other}"
            raise FileError(text, given=folder)
        if there.digest != record.digest and (reason := grow(folder, record, plan)):
            text = f"{str(folder)!r} holds another sweep, and {reason}: {other}"
            raise FileError(text, given=folder)
        return
    try:
        others = [p.name for p in folder.iterdir() if not p.name.startswith(".")]
    except OSError as error:
        raise cannot_write(folder, error) from error
    if not all(map(store.is_own, others)) and not store.replaces(folder):
        text = f"{str(folder)!r} holds no sweep but other files: give another"
        raise FileError(text, given=folder)
    remove(store.own(folder))
    write_json(folder / store.SWEEP, record.model_dump(), indent=1)


def _ready(plan: SweepPlan, folder: Path, kept: store.Store) -> Iterator[int]:
    """Proposes points whose earlier runs are done; returns missing runs with known settings."""
    rows = _tuning_rows(folder, plan) if plan.tuned else []
    for points in plan.tuned:
        batch = tuning.due(points)
        if not all(n in kept for p in tuning.before(points) for n in points.runs(p)):
            continue
        figures = {row["run"]: tuning.figure_of(row, points.tune.metric) for row in rows}
        for point in batch:
            values = tuning.propose(points, figures)
            kept.propose(points.runs(point)[0], values)
            points.proposals[point] = values
    return (number for number in kept.missing() if plan.is_known(number))


def _recall(plan: SweepPlan, folder: Path) -> None:
    """Restores the stored proposals of tuned blocks into the plan, up to the first missing one."""
    kept = store.read_proposals(folder) if plan.tuned else {}
    for points in plan.tuned:
        points.proposals.clear()
        for point in range(1, points.points):
            values = kept.get(points.runs(point)[0])
            if values is None or set(values) != set(points.ranges):
                break
            points.proposals[point] = values


def _tuning_rows(folder: Path, plan: SweepPlan) -> list[dict[str, Any]]:
    names = {column(name) for points in plan.tuned for name in points.ranges}
    names |= {"run", "status", *(points.tune.metric for points in plan.tuned)}
    return store.read_rows(folder, sorted(names)).to_table(sorted(names)).to_pylist()


def _request(
    plan: SweepPlan, folder: Path, models: Mapping[str, str], number: int
) -> dict[str, Any]:
    """Returns the argument of `figures_of` for a run; `folder` is absolute."""
    settings = plan.settings(number)
    place = recording_folder(folder, number) if "recordings" in plan.keep else None
    return {
        "settings": asdict(settings),
        "model_digest": models[settings.model],
        "keep": list(plan.keep),
        "folder": None if place is None else str(place),
    }
