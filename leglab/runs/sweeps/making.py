"""Execution of one run of a sweep, in this or a worker process."""

from pathlib import Path
from typing import Any

from leglab.jobs.work import WorkError
from leglab.runs.folder import write_run
from leglab.runs.preparation import RunSettings, forget_preparations, prepared
from leglab.runs.run import Run, run_scenario
from leglab.runs.sweeps.outcome import outcome_of


def figures_of(given: dict[str, Any]) -> dict[str, Any]:
    """Makes a run and returns its figures.

    Args:
        given: Dict with the run's `settings`, `model_digest`, the optional parts to `keep`, and the
            `folder` of its recording or None.

    Returns:
        The fields of an `Outcome`.

    Raises:
        WorkError: The run ended early.
        LeglabError: The run cannot be set up.
    """
    run = made(given["settings"], given["model_digest"])
    if given["folder"] is not None:
        write_run(run, Path(given["folder"]), overwrite=True)
    if run.history.failure:
        memory = "MemoryError" in run.history.failure
        raise WorkError("memory" if memory else "ended early", run.history.failure)
    return outcome_of(run, given["keep"])


def made(settings: dict[str, Any], model_digest: str) -> Run:
    """Makes a run; runs of one machine share a preparation, which each process makes once.

    Args:
        settings: Fields of `RunSettings`.
        model_digest: Required digest of the model's files.

    Raises:
        LeglabError: The run cannot be set up, or the model's files have changed.
        KeyboardInterrupt: The user interrupts.
    """
    wanted = RunSettings(**settings)
    try:
        run = run_scenario(wanted, preparation=prepared(wanted, model_digest))
    except MemoryError:
        forget_preparations()
        raise
    if run.history.failure.startswith("interrupted"):
        raise KeyboardInterrupt
    return run
