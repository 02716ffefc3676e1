"""The folder that a run leaves behind: metrics, recording, configuration, plots."""

import json
import shutil
from pathlib import Path

from leglab import data
from leglab.errors import LeglabError
from leglab.report.figures import save_run_figures
from leglab.runner import Run


def check_folder(folder: Path, *, overwrite: bool = False, mark: str = "metrics.json") -> None:
    """Refuses a folder that exists, before any work is done.

    Args:
        folder: Where results shall go.
        overwrite: Whether earlier results may be replaced.
        mark: File by which a folder with earlier results is known.

    Raises:
        LeglabError: If it exists and may not be replaced, or holds something else.
    """
    if not folder.exists():
        return
    if not overwrite:
        raise LeglabError(f"output folder {str(folder)!r} exists; remove it or give --overwrite")
    if not folder.is_dir() or (any(folder.iterdir()) and not (folder / mark).exists()):
        raise LeglabError(f"{str(folder)!r} holds no {mark}: it is left as it is")


def write_run(run: Run, folder: Path, *, overwrite: bool = False, figures: bool = True) -> Path:
    """Writes `metrics.json`, `run.json`, `recording.parquet` and plots.

    Everything is written beside the folder first and moved at the end: a folder is there as a
    whole or not at all.

    Args:
        run: The run, complete or not.
        folder: Where to; parents are made.
        overwrite: Whether the folder of an earlier run may be replaced.
        figures: Whether to draw plots.

    Raises:
        LeglabError: If the folder exists or cannot be written.
    """
    check_folder(folder, overwrite=overwrite)
    partial = folder.with_name(f".{folder.name}.partial")
    try:
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        data.write(run.recording, partial / "recording.parquet")
        _write_json(partial / "metrics.json", run.metrics)
        _write_json(partial / "run.json", run.configuration)
        if figures:
            title = (
                f"{run.settings.scenario}, {run.settings.controller}, "
                f"{Path(run.settings.model).stem}, seed {run.settings.seed}"
            )
            save_run_figures(
                run.recording,
                partial,
                phases=run.scenario.phases,
                window=run.window,
                title=title,
            )
        if folder.exists():
            shutil.rmtree(folder)
        partial.rename(folder)
    except OSError as error:
        raise LeglabError(f"{folder}: cannot be written: {error.strerror}") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return folder


def _write_json(path: Path, content: dict) -> None:
    path.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n")
