"""Makes one run of a sweep, in whatever process it is asked to."""

from pathlib import Path
from typing import Any

from leglab.jobs.work import WorkError
from leglab.runs.folder import write_run
from leglab.runs.preparation import RunSettings, forget_preparations, prepared
from leglab.runs.run import Run, run_scenario
from leglab.runs.sweeps.outcome import outcome_of


def figures_of(given: dict[str, Any]) -> dict[str, Any]:
    """Makes a run.

    Args:
        given: `settings` of the run, the `model_digest`, what to `keep`, and the `folder` of its
            recording or None.

    Returns:
        What `Outcome` holds.

    Raises:
        WorkError: The run ended early.
        LeglabError: It cannot be set up.
    """
    run = made(given["settings"], given["model_digest"])
    if given["folder"] is not None:
        write_run(run, Path(given["folder"]), overwrite=True)
    if run.history.failure:
        memory = "MemoryError" in run.history.failure
        raise WorkError("memory" if memory else "ended early", run.history.failure)
    return outcome_of(run, given["keep"])


def made(settings: dict[str, Any], model_digest: str) -> Run:
    """Makes a run; what runs of the same machine share is prepared once a process.

    Args:
        settings: Those of `RunSettings`.
        model_digest: Of the model as the run is to have it.

    Raises:
        LeglabError: It cannot be set up, or the model is another one by now.
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
