"""Folders of sweeps with made-up figures, written by the real books."""

from pathlib import Path
from statistics import median

from leglab.base.output import write_json
from leglab.runs.sweeps import store
from leglab.runs.sweeps.plan import SweepPlan

SIZES, SEEDS = (3.0, 25.0), 3


def write_sweep(
    folder: Path,
    controllers=("pd", "bsnn_arx"),
    *,
    failed=(),
    untold=None,
    scenario="seal_wear",
    more=None,
):
    """Writes a sweep over controllers, sizes and specimens.

    Args:
        folder: Where to; must not be there.
        controllers: Their names.
        failed: Numbers of runs that failed.
        untold: Reasons by the numbers of runs that have no figures of damage.
        scenario: Its name.
        more: Further settings with their values.

    Returns:
        Made-up t90 [s] by controller and size, one a specimen; None for never.
    """
    grid = {
        "controller": list(controllers),
        "severity": list(SIZES),
        "seed": {"count": SEEDS},
        **(more or {}),
    }
    shared = {"scenario": scenario, "model": "knee_bench", "duration": 10.0}
    plan = SweepPlan({"settings": shared, "block": [{"grid": grid}]})
    record = store.SweepRecord(
        plan=plan.content,
        digest=plan.digest,
        code="0" * 64,
        models={},
        runs=len(plan),
        axes=list(plan.axes),
        version="0.1.0",
        load=["it's.py"],
    )
    folder.mkdir(parents=True)
    write_json(folder / store.SWEEP, record.model_dump(), indent=1)
    books, times = store.Store(folder, plan), {}
    for number, settings in enumerate(plan):
        t90 = round(0.2 + 0.1 * number, 3) if number % 5 else None
        if number in failed:
            answer = {"error": f"no <b>figures</b> of {settings.controller}", "kind": "died"}
        else:
            times.setdefault((settings.controller, settings.severity), []).append(t90)
            figures = {"rms_rad": 0.01, "end_rad": 0.01 * (number + 1), "peak_rad": 0.1}
            figures |= {"recovered": 1.0 - 0.02 * number, "t90_s": t90, "came_to_s": 10.0}
            if number in (untold or {}):
                figures |= {"recovered": None, "t90_s": None, "not_told": untold[number]}
                times[settings.controller, settings.severity].pop()
            answer = {"result": {**figures, "valve_travel": 5.0, "effort": 0.1}}
        books.add(number, answer, "here")
    books.finish()
    return times


def middle(times) -> float | None:
    """Median of times; None for never, where half of them or more never came."""
    if times.count(None) >= len(times) / 2:
        return None
    return median(1e9 if time is None else time for time in times)
