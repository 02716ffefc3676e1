"""Growth of a sweep: a plan that contains all runs of an earlier plan takes over their rows."""

import json
from dataclasses import asdict
from pathlib import Path

from leglab.base.output import remove, write_json
from leglab.runs.run_settings import RunSettings
from leglab.runs.sweeps import store
from leglab.runs.sweeps.plan import SweepPlan
from leglab.runs.sweeps.rows import settings_row

_BUILT = ".grown.partial"  # folder in which the rows get their new numbers
_BATCH = 1000  # rows that are converted at a time


def grow(folder: Path, record: store.SweepRecord, plan: SweepPlan) -> str:
    """Replaces the sweep in a folder by a larger one that keeps all rows, with new numbers.

    Args:
        folder: Folder of the earlier sweep, made by the same code with the same models.
        record: Record of the new sweep.
        plan: Plan of the new sweep.

    Returns:
        The reason why the sweep cannot grow, and nothing has changed; "" if it has grown.

    Raises:
        LeglabError: A file of the earlier sweep is damaged, or a file cannot be written.
    """
    earlier = store.read_plan_of(folder)
    if earlier.tuned or plan.tuned:
        return "points that are proposed depend on the runs before"
    if not set(plan.keep) <= set(earlier.keep) or "recordings" in earlier.keep:
        return "it keeps recordings, or less of each run than asked now"
    numbers = {_key(run): number for number, run in enumerate(plan)}
    renumbered = [numbers.get(_key(run)) for run in earlier]
    if None in renumbered:
        return f"its run {renumbered.index(None)} is not in the new plan"
    built = folder / _BUILT
    remove([built])
    built.mkdir()
    write_json(built / store.SWEEP, record.model_dump(), indent=1)
    kept = store.Store(built, plan)
    for batch in store.read_rows(folder).to_batches(batch_size=_BATCH):
        for row in batch.to_pylist():
            number = renumbered[row["run"]]
            assert number is not None
            kept.keep({**row, **settings_row(plan, number)})
    kept.close()
    store.put_aside(folder)
    for path in built.iterdir():
        if not path.name.startswith("."):
            path.rename(folder / path.name)
    remove([built])
    return ""


def _key(settings: RunSettings) -> str:
    return json.dumps(asdict(settings), sort_keys=True, default=str)
