"""Comparisons: all runs of scenarios, controllers and seeds, in parallel and resumable."""

import itertools
import json
import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from leglab import __version__
from leglab.base.errors import FileError, LeglabError, SettingsError
from leglab.base.input import read_json
from leglab.base.notebook import data_frame, data_index, html_table, panels
from leglab.base.output import claimed_folder, write_atomically
from leglab.base.units import error_unit
from leglab.jobs.engine import Progress, Results, executor, make_missing
from leglab.machine.changes import check_tolerance
from leglab.runs.folder import content_with
from leglab.runs.preparation import RunSettings, basis_of, check_controllers, scenario_of
from leglab.runs.sweeps.making import made
from leglab.runs.sweeps.outcome import traces

_MOST_SEEDS = 100_000

# File with the result of `compare`.
SUMMARY = "compare.json"
# Folder of the runs.
RUNS = "runs"

# Settings in which the runs of a comparison differ.
_VARIED = ("scenarios", "controllers", "seeds")
# Entries that a valid summary must have.
_SHARED = ("seeds", "model", "duration", "ramp_duration", "tolerance", "vary", "unit", "version")
_ESTIMATES = ("before_rad", "after_rad", "end_rad", "ratio", "recovered", "t90_s")


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Plan of a comparison: every scenario with every controller and every seed.

    Attributes:
        scenarios: Names of scenarios.
        controllers: Names of controllers; ratios refer to the first.
        seeds: Number of seeds, from 0 on.
        model: Name of a model or path of an MJCF file.
        duration: Duration of each run [s]; None for the scenario's default.
        severity: Magnitude of the changes; None for the scenario's default.
        ramp_duration: Duration of the changes [s]; 0 is a step.
        element: The only joint at which the changes happen; None for all joints.
        reference: Name of the reference; None for the scenario's default.
        tolerance: Relative standard deviation of each seed's machine from the nominal machine [1].
        vary: Whether each seed also draws the time of the change and the phase of the motion.
    """

    scenarios: tuple[str, ...]
    controllers: tuple[str, ...]
    seeds: int = 1
    model: str = "leg"
    duration: float | None = None
    severity: float | None = None
    ramp_duration: float = 0.0
    element: str | None = None
    reference: str | None = None
    tolerance: float = 0.0
    vary: bool = False

    def __post_init__(self) -> None:
        if not 1 <= self.seeds <= _MOST_SEEDS:
            text = f"seeds is {self.seeds}; allowed: "
            raise SettingsError(text, given=self.seeds, allowed=f"1 to {_MOST_SEEDS}")
        check_tolerance(self.tolerance)
        for kind in ("scenarios", "controllers"):
            names = getattr(self, kind)
            if not names:
                raise SettingsError(f"no {kind} to compare; give ", allowed="one or more")
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                raise SettingsError(f"{kind}: {twice[0]!r} is given twice", given=twice[0])
        check_controllers(self.controllers)
        for run in self.runs():
            scenario_of(run)

    def runs(self) -> list[RunSettings]:
        """Returns the settings of all runs, ordered by scenario, controller and seed."""
        shared = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in _VARIED}
        return [
            RunSettings(scenario=scenario, controller=controller, seed=seed, **shared)
            for scenario in self.scenarios
            for controller in self.controllers
            for seed in range(self.seeds)
        ]


def run_all(
    runs: Sequence[RunSettings],
    folder: Path,
    *,
    jobs: int = -1,
    scheduler: str | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """Makes all runs that the folder does not hold yet.

    Each run is stored in one file, written completely or not at all, so the same call continues
    after an interruption. A stored run is reused only if its settings, code and model, including
    the model's other files and assets, are the same. A run that cannot be set up, raises an error,
    takes longer than an hour, or whose process dies does not stop the others and is not stored.

    Args:
        runs: Settings of the runs.
        folder: Folder of the stored results.
        jobs: Number of processes; -1 for one per core, 1 for this process. Not with a scheduler.
        scheduler: Address of a Dask scheduler whose workers make the runs.
        overwrite: Whether to repeat stored runs.
        progress: Called after each run.

    Returns:
        One dict per run, as from `result_of`. For a failed run, `metrics` has `completed` False,
        `failure` (the reason) and no phases.

    Raises:
        LeglabError: All runs failed, the folder cannot be written to, another process writes to
            it, or the scheduler cannot be reached.
        KeyboardInterrupt: The user interrupts; finished runs are kept.
    """
    bases = [basis_of(run) for run in runs]

    def keep(number: int, result: dict[str, Any]) -> dict[str, Any]:
        kept = {**result, **bases[number]}
        text = json.dumps(kept, allow_nan=False).encode()
        write_atomically(_path(runs[number], folder), lambda file: file.write(text))
        return kept

    with claimed_folder(folder):
        found = {
            number: content_with({"settings": asdict(run), **bases[number]}, _path(run, folder))
            for number, run in enumerate(() if overwrite else runs)
        }
        results = Results({n: result for n, result in found.items() if result}, keep)
        problems = make_missing(
            executor(result_of, jobs, scheduler),
            range(len(runs)),
            results,
            lambda n: {"settings": asdict(runs[n]), "model_digest": bases[n]["model_digest"]},
            told=lambda n: f"{runs[n].scenario} · {runs[n].controller} · seed {runs[n].seed}",
            progress=progress,
        )
    if problems and len(problems) == len(runs):
        raise next(iter(problems.values()))
    results |= {number: _failed(runs[number], str(why)) for number, why in problems.items()}
    return [results[number] for number in range(len(runs))]


def _path(settings: RunSettings, folder: Path) -> Path:
    model = Path(settings.model).stem
    return folder / f"{settings.scenario}-{settings.controller}-{model}-{settings.seed}.json"


@dataclass(frozen=True, kw_only=True)
class StoredRun:
    """One run of a comparison and the file in which it is stored."""

    scenario: str
    controller: str
    seed: int
    path: Path
    #: Result as from `result_of`; None if the file is missing or damaged.
    result: dict[str, Any] | None


def is_comparison(folder: Path) -> bool:
    """Tests whether a folder holds a comparison."""
    return (folder / SUMMARY).is_file()


def read_comparison(folder: Path) -> "ComparisonResult":
    """Reads the summary of a comparison.

    Raises:
        FileError: The folder holds no comparison, or the file does not have the required form.
    """
    content = read_json(folder / SUMMARY)
    try:
        if not 1 <= int(content["seeds"]) <= _MOST_SEEDS:
            raise ValueError
        for name in _SHARED:
            content[name]
        for scenario in content["scenarios"]:
            for controller in content["controllers"]:
                cell = content["results"][scenario][controller]
                cell["runs"], cell["failures"], cell["never_undone"]
                for name in _ESTIMATES:
                    for part in ("mean", "half_width"):
                        if cell[name][part] is not None:
                            float(cell[name][part])
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        path = folder / SUMMARY
        raise FileError(f"{path} does not have the form of a comparison", given=path) from error
    return ComparisonResult(content)


def stored_runs(summary: Mapping[str, Any], folder: Path) -> list[StoredRun]:
    """Reads the stored runs of a comparison, in the order of its table.

    Args:
        summary: Summary from `read_comparison`.
        folder: Folder of the comparison.
    """
    found = []
    seeds = range(summary["seeds"])
    for names in itertools.product(summary["scenarios"], summary["controllers"], seeds):
        told = dict(zip(("scenario", "controller", "seed"), names, strict=True))
        path, result = _path(RunSettings(**told, model=summary["model"]), folder / RUNS), None
        with suppress(LeglabError, LookupError, TypeError):
            content = read_json(path)
            if content["settings"]["seed"] == told["seed"] and "metrics" in content:
                result = content
        found.append(StoredRun(**told, path=path, result=result))
    return found


def result_of(given: dict[str, Any]) -> dict[str, Any]:
    """Makes a run and returns its result.

    Args:
        given: Dict with the run's `settings` and the required `model_digest`.

    Returns:
        Dict of `settings`; `metrics`; `changes`, the times of changes [s]; `window`, a stride [s];
        `time` [s] with RMS errors over the stride (`windowed_error_rad`) and the 2 s
        (`safety_error_rad`) that end then, or None; `travel_rad`, the reference's range by joint.

    Raises:
        LeglabError: The run cannot be set up, or the model's files have changed.
    """
    run = made(given["settings"], given["model_digest"])
    kept = traces(run)
    return {
        "settings": asdict(run.settings),
        "metrics": run.metrics,
        "changes": kept["changes_s"],
        "window": kept["window_s"],
        "time": kept["trace_s"],
        "windowed_error_rad": kept["windowed_rad"],
        "safety_error_rad": kept["worst_rad"],
        "travel_rad": json.loads(kept["travel_rad"]),
    }


def _failed(run: RunSettings, problem: str) -> dict[str, Any]:
    """Returns the result entry of a run that failed."""
    metrics = {"scenario": run.scenario, "controller": run.controller, "seed": run.seed}
    metrics |= {"completed": False, "failure": problem, "phases": []}
    empty = dict.fromkeys(("changes", "time", "windowed_error_rad", "safety_error_rad"), ())
    return {"settings": asdict(run), "metrics": metrics, "window": None, "travel_rad": {}, **empty}


_CONFIDENCE = 0.95


class ComparisonResult(dict[str, Any]):
    """Content of `compare.json`, as returned by `compare`, with display as table and plot."""

    def __repr__(self) -> str:
        return (
            f"ComparisonResult({', '.join(self['scenarios'])} by {', '.join(self['controllers'])} "
            f"on {self['model']}, {self['seeds']} seed{'s' * (self['seeds'] > 1)})"
        )

    def _cells(self) -> dict[tuple[str, str], dict[str, Any]]:
        return {(s, c): cell for s, cells in self["results"].items() for c, cell in cells.items()}

    def _repr_html_(self) -> str:
        def told(one: dict[str, Any], factor: float = 1.0) -> str:
            if one["mean"] is None:
                return ""
            half = one["half_width"]
            return f"{factor * one['mean']:.3g}" + (f" ± {factor * half:.2g}" if half else "")

        rows = [
            (
                *names,
                *(told(cell[f"{name}_rad"], 1e3) for name in ("before", "after", "end")),
                told(cell["recovered"], 100.0),
                told(cell["t90_s"]),
            )
            for names, cell in self._cells().items()
        ]
        head = ("scenario", "controller", "before", "after", "end", "undone [%]", "90 % undone [s]")
        return html_table(f"{self!r}; RMS error [{self['unit']}], mean ± half of 95 %", head, rows)

    def plot(self) -> list[Any]:
        """Draws the error after the change, or of the whole run, by scenario and controller.

        Returns:
            The axes, one per scenario, of a new `matplotlib.pyplot` figure.
        """
        axes = panels(len(self["scenarios"]), height=0.5 + 0.3 * len(self["controllers"]))
        for axis, (scenario, cells) in zip(axes, self["results"].items(), strict=True):
            known = {n: c["after_rad"] for n, c in cells.items() if c["after_rad"]["mean"]}
            means = [1e3 * one["mean"] for one in known.values()]
            ends = [1e3 * (one["half_width"] or 0.0) for one in known.values()]
            axis.barh(list(known), means, xerr=ends, color="0.6")
            axis.set_title(scenario, fontsize="medium", loc="left")
            axis.invert_yaxis()
        axes[-1].set_xlabel(f"RMS tracking error after the change [{self['unit']}]")
        return axes

    def to_pandas(self) -> Any:
        """Returns means and half widths of the 95 % intervals as a `pandas.DataFrame`.

        One row per scenario and controller; columns as in `compare`, `..._half` for half widths.

        Raises:
            LeglabError: pandas is missing.
        """
        rows = {}
        for names, cell in self._cells().items():
            row: dict[str, Any] = {}
            for name, value in cell.items():
                if isinstance(value, dict):
                    row |= {name: value["mean"], f"{name}_half": value["half_width"]}
            rows[names] = {**row, "runs": cell["runs"]}
        return data_frame(list(rows.values()), index=data_index(rows, ("scenario", "controller")))


def compare(comparison: Comparison, results: Iterable[dict[str, Any]]) -> ComparisonResult:
    """Summarises results over seeds: the content of `compare.json`.

    Args:
        comparison: Plan of the comparison.
        results: Results from `run_all`.

    Returns:
        `unit` in which errors are reported, a thousandth of the stored unit. `results`: by
        scenario and controller, each an estimate (`estimate`): the errors `before_rad`,
        `after_rad` (of the whole run without a change) and `end_rad`, `damage_rad`, `recovered`,
        `t90_s` (of runs that removed 90 % of the damage), all as defined in `leglab.runs.clock`;
        `excess_error_area_rad_s`; and `ratio`, the error after the change divided by the first
        controller's error with the same seed. `never_undone` counts the runs that never removed
        90 % of their damage, `runs` all runs; `failures` lists the reasons of runs that ended
        early, which are left out of all estimates, `untold` why figures of other runs are missing.
    """
    cells: defaultdict[tuple[str, str], dict[int, dict[str, Any]]] = defaultdict(dict)
    results = list(results)
    for metrics in (result["metrics"] for result in results):
        cells[metrics["scenario"], metrics["controller"]][metrics["seed"]] = metrics
    first = comparison.controllers[0]
    return ComparisonResult(
        **asdict(comparison),
        version=__version__,
        unit=unit_of_results(results),
        results={
            scenario: {
                controller: _summary(cells[scenario, controller], cells[scenario, first])
                for controller in comparison.controllers
            }
            for scenario in comparison.scenarios
        },
    )


def unit_of_results(results: Iterable[dict[str, Any]]) -> str:
    """Returns the unit of reported errors for `run_all` results: "mrad", "mm", or "mrad or mm"."""
    every = [result["metrics"] for result in results]
    if not any(metrics.get("slides") for metrics in every):
        return error_unit(())
    return error_unit(
        joint in metrics.get("slides", ())
        for metrics in every
        for phase in metrics["phases"][:1]
        for joint in phase["rms_rad"]
        if joint != "all"
    )


def estimate(values: Iterable[float | None]) -> dict[str, Any]:
    """Computes the mean of independent runs with its confidence interval by Student's t.

    Args:
        values: One value per run; None for a run without a value.

    Returns:
        `values` without None; their `mean`, None if there are none; and `half_width` of the 95 %
        interval, t s/sqrt(n) with n - 1 degrees of freedom, None for fewer than two values.
    """
    numbers = [value for value in values if value is not None]
    mean = float(np.mean(numbers)) if numbers else None
    half_width = None
    if len(numbers) > 1:
        from scipy import stats  # imported late: takes a second, not needed for a single run

        quantile = float(stats.t.ppf((1 + _CONFIDENCE) / 2, len(numbers) - 1))
        half_width = quantile * float(np.std(numbers, ddof=1)) / math.sqrt(len(numbers))
    return {"mean": mean, "half_width": half_width, "values": numbers}


def _summary(cell: dict[int, dict], first: dict[int, dict]) -> dict[str, Any]:
    whole = {seed: metrics for seed, metrics in cell.items() if metrics["completed"]}
    after = {seed: _rms(metrics, "after", "whole") for seed, metrics in whole.items()}
    found = [metrics["adaptation"] for metrics in whole.values()]

    def pooled(key: str) -> dict[str, Any]:
        return estimate(entry[key]["all"] if entry[key] else None for entry in found)

    ratios = []
    for seed, value in after.items():
        base = _rms(first[seed], "after", "whole") if seed in first else None
        if value is not None and base and first[seed]["completed"]:
            ratios.append(value / base)
    return {
        "before_rad": pooled("before_rad"),
        "after_rad": estimate(after.values()),
        "end_rad": pooled("end_rad"),
        "ratio": estimate(ratios),
        "damage_rad": estimate(entry["damage_rad"] for entry in found),
        "recovered": estimate(entry["recovered"] for entry in found),
        "t90_s": estimate(entry["t90_s"] for entry in found),
        "never_undone": sum(e["t90_s"] is None and e["reason"] is None for e in found),
        "excess_error_area_rad_s": estimate(m["excess_error_area_rad_s"] for m in whole.values()),
        "runs": len(cell),
        "failures": [m["failure"] for m in cell.values() if not m["completed"]],
        "untold": [entry["reason"] for entry in found if entry["reason"]],
    }


def _rms(metrics: dict[str, Any], *phases: str) -> float | None:
    for phase in metrics["phases"]:
        if phase["name"] in phases:
            return phase["rms_rad"]["all"]
    return None
