"""The benchmark of adaptation: sixteen faults of three magnitudes on specimens, for any controller.

The seed draws machines, motions, times of the change and noise, so that they are the same for every
controller. Two controllers run for comparison: `static_feedforward`, whose error must not be
exceeded, and `pd`, for valve travel and energy.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from leglab.base.errors import LeglabError, ModelError, SettingsError
from leglab.causes.table import CAUSES
from leglab.machine.changes import healthy_values
from leglab.runs.preparation import RunSettings, check_controllers, prepared
from leglab.runs.sweeps.plan import SweepPlan, check_run

STATIC, PD = "static_feedforward", "pd"

# Standard deviation of the logarithm of every parameter about its nominal value; run length [s].
TOLERANCE, DURATION = 0.1, 20.0
# Start of the comparison of windows [s], because earlier windows contain the start of learning.
SAFE_FROM = 7.0
_MOST_SPECIMENS = 1000


def faults(model: str = "leg") -> dict[str, tuple[float, ...]]:
    """Returns three magnitudes of each fault on a model, the largest beyond the fault bank's.

    Scenarios to which a controller cannot adapt, a cold start and faults of encoders, are left out.
    """
    machine = prepared(RunSettings(scenario="", model=model)).nominal
    sizes = {}
    for name, cause in sorted(CAUSES.items()):
        if cause.summary and cause.sides:
            healthy = cause.healthy_magnitude(partial(healthy_values, machine))
            sizes[name] = cause.magnitudes(cause.sides[0].benchmark, healthy)
    return sizes


def adaptation_plan(
    controllers: Sequence[str],
    *,
    model: str = "leg",
    specimens: int = 10,
    only: Sequence[str] | None = None,
) -> tuple[SweepPlan, tuple[str, ...]]:
    """Returns the sweep of the benchmark, and the faults that the model cannot have.

    Args:
        controllers: Names of controllers; the two for comparison are added.
        model: Name of a model or path of an MJCF file.
        specimens: Number of specimens, one seed each.
        only: Names of faults; None for all.

    Raises:
        LeglabError: A controller or fault is not known or given twice, or the model cannot run.
    """
    check_controllers(controllers)
    if not controllers:
        raise SettingsError("no controllers to compare; give ", allowed="one or more")
    if not 1 <= specimens <= _MOST_SPECIMENS:
        told = f"specimens is {specimens}; allowed: "
        raise SettingsError(told, given=specimens, allowed=f"1 to {_MOST_SPECIMENS}")
    settings: dict[str, Any] = {
        "model": model,
        "duration": DURATION,
        "tolerance": TOLERANCE,
        "vary": True,
    }
    check_run(RunSettings(scenario="nominal", **settings))
    possible, missing = {}, []
    known = faults(model)
    chosen = known if only is None else only
    for name in chosen:
        if name not in known:
            raise SettingsError.unknown("fault of the benchmark", name, known)
    for name, sizes in known.items():
        if name not in chosen:
            continue
        try:
            check_run(RunSettings(scenario=name, severity=sizes[0], **settings))
            possible[name] = sizes
        except LeglabError:  # The model has no such part: the bench has no pump.
            missing.append(name)
    if not possible:
        told = f"model {model!r} can have none of {', '.join(missing) or 'no faults'}"
        raise ModelError(told, given=model)
    names = list(dict.fromkeys([STATIC, PD, *controllers]))
    shared: dict[str, Any] = {"controller": names, "seed": {"count": specimens}}
    blocks = [
        {"grid": {"scenario": [name], "severity": list(sizes), **shared}}
        for name, sizes in possible.items()
    ]
    return SweepPlan({"settings": settings, "block": blocks, "keep": ["traces"]}), tuple(missing)


@dataclass(frozen=True, kw_only=True)
class Score:
    """Results of a controller under one fault, or under all of them."""

    controller: str  #: Name of the controller
    fault: str  #: Name of the scenario; "all" for all together
    runs: int  #: Number of runs
    failed: int  #: Number of failed runs, which the figures below exclude
    before_mrad: float | None  #: Median of the error before the change: the nominal error [mrad]
    recovered: float | None  #: Median share of the added error that is undone at the end
    #: Median time until 90 % of the added error are undone [s]; infinite if most runs never do it.
    t90_median_s: float | None
    t90_worst_s: float | None  #: Longest finite time [s]
    never: int  #: Number of runs that never undo 90 % of the added error
    told: int  #: Number of runs whose error the change raised, on which the figures above are based
    #: Largest ratio, from 7 s on, of the error over 2 s to the error of `static_feedforward` over
    #: the same 2 s.
    worst_over_static: float | None
    travel_over_pd: float | None  #: Median ratio of valve travel to the travel with `pd`
    energy_over_pd: float | None  #: Median ratio of supply energy to the energy with `pd`


def scores(rows: Sequence[Mapping[str, Any]]) -> list[Score]:
    """Summarises the rows of the benchmark's sweep by controller and fault, all faults first.

    Args:
        rows: Rows of the dataset, with traces.
    """
    machines: dict[tuple[Any, ...], dict[str, Mapping[str, Any]]] = defaultdict(dict)
    for row in rows:
        place = row["scenario"], row["severity"], row["seed"]
        machines[place][row["controller"]] = row
    figures: dict[tuple[str, str], list[dict[str, Any]]] = defaultdict(list)
    for (fault, _, _), by_controller in machines.items():
        for controller, row in by_controller.items():
            found = _figures(row, by_controller.get(STATIC), by_controller.get(PD))
            for group in ("all", fault):
                figures[controller, group].append(found)
    order = sorted(figures, key=lambda key: (key[1] != "all", key[1]))
    return [_score(*key, figures[key]) for key in order]


def _figures(
    row: Mapping[str, Any], static: Mapping[str, Any] | None, pd: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Returns the figures that a run adds to its group; None for a missing one."""
    if row["status"] != "ok":
        return {"failed": True}
    found: dict[str, Any] = {"failed": False, "before": row["before_rad"], "told": False}
    if row["recovered"] is not None:
        t90 = np.inf if row["t90_s"] is None else row["t90_s"]
        found |= {"told": True, "recovered": row["recovered"], "t90": t90}
    if static is not None and static["status"] == "ok":
        found["worst"] = worst_window(row, static)
    if pd is not None and pd["status"] == "ok":
        found["travel"] = row["valve_travel"] / pd["valve_travel"]
        if row["energy_j"] is not None and pd["energy_j"]:
            found["energy"] = row["energy_j"] / pd["energy_j"]
    return found


def worst_window(row: Mapping[str, Any], other: Mapping[str, Any]) -> float | None:
    """Returns the largest ratio of two runs' errors over the same 2 s, from 7 s on, or None."""
    pairs = zip(row["trace_s"], row["worst_rad"], other["worst_rad"], strict=True)
    ratios = [ours / theirs for t, ours, theirs in pairs if t >= SAFE_FROM and ours and theirs]
    return max(ratios, default=None)


def _score(controller: str, fault: str, found: Sequence[Mapping[str, Any]]) -> Score:
    def values(name: str) -> np.ndarray:
        return np.array([one[name] for one in found if one.get(name) is not None], dtype=float)

    def middle(name: str, factor: float = 1.0) -> float | None:
        known = values(name)
        return factor * float(np.median(known)) if known.size else None

    times, worst = values("t90"), values("worst")
    done = times[np.isfinite(times)]
    return Score(
        controller=controller,
        fault=fault,
        runs=len(found),
        failed=sum(one["failed"] for one in found),
        before_mrad=middle("before", 1e3),
        recovered=middle("recovered"),
        t90_median_s=middle("t90"),
        t90_worst_s=float(done.max()) if done.size else None,
        never=int(len(times) - len(done)),
        told=len(times),
        worst_over_static=float(worst.max()) if worst.size else None,
        travel_over_pd=middle("travel"),
        energy_over_pd=middle("energy"),
    )


HEAD = (
    "controller", "runs", "failed", "before, mrad", "undone, %", "90 % after, s", "worst", "never",
    "worst 2 s over static", "valve travel over pd", "energy over pd",
)  # fmt: skip


def cells(score: Score) -> list[str]:
    """Formats a line of the table with the columns `HEAD`."""
    undone = None if score.recovered is None else 100.0 * score.recovered
    numbers = (
        score.before_mrad,
        undone,
        score.t90_median_s,
        score.t90_worst_s,
        score.worst_over_static,
        score.travel_over_pd,
        score.energy_over_pd,
    )
    shown = ["" if x is None else "never" if np.isinf(x) else f"{x:.3g}" for x in numbers]
    never = f"{score.never} of {score.told}" if score.told else ""
    failed = str(score.failed) if score.failed else ""
    return [score.controller, str(score.runs), failed, *shown[:4], never, *shown[4:]]


def as_json(found: Sequence[Score]) -> list[dict[str, Any]]:
    """Returns the scores as JSON values; an infinite median becomes None."""
    return [
        {k: None if isinstance(v, float) and np.isinf(v) else v for k, v in asdict(one).items()}
        for one in found
    ]
