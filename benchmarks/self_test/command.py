"""A diagnosis as a user has it: `leglab diagnose` on files. A result that it loses is an error."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import mujoco

from leglab import data
from leglab.base.errors import SimulationError
from leglab.base.recording import Recording
from leglab.machine.plugin import load_plugin


def diagnosed(
    model: str | Path,
    recordings: Mapping[str, Recording],
    *,
    healthy: Mapping[str, Recording] | None = None,
    effects: Iterable[str] = (),
) -> dict[str, Any]:
    """Runs the command on one thread, and returns the content of diagnosis.json.

    `sets` in it is the content of sets.json.

    Args:
        model: MJCF file, or the name of a model that ships with leglab.
        recordings: By name.
        healthy: Recordings from before the fault, by name; None for none.
        effects: Names of those to consider; none for all.

    Raises:
        SimulationError: The command fails, a file is missing, or improved.xml does not load.
    """
    with tempfile.TemporaryDirectory() as name:
        folder, out = Path(name), Path(name) / "out"
        words = ["diagnose", str(model), "--out", str(out), "--keep"]
        for option, logs in (("", recordings), ("--healthy", healthy or {})):
            place = folder / (option or "recordings")
            place.mkdir()
            for log, recording in logs.items():
                path = place / f"{log}.parquet"
                data.write(recording, path)
                words += [option, str(path)] if option else [str(path)]
        for effect in effects:
            words += ["--effect", effect]
        done = subprocess.run(
            [sys.executable, "-m", "leglab", *words],
            env={**os.environ, "OMP_NUM_THREADS": "1"},
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            told = " ".join(done.stderr.split()[-60:])
            raise SimulationError(f"leglab diagnose ends with status {done.returncode}: {told}")
        content: dict[str, Any] = json.loads((out / "diagnosis.json").read_text())
        content["sets"] = json.loads((out / "sets.json").read_text())
        for lost, reason in (content["missing"] or {}).items():
            raise SimulationError(f"{lost} is missing: {reason}")
        if content["model"]:
            load_plugin()
            try:
                mujoco.MjModel.from_xml_path(str(out / content["model"]))
            except (ValueError, mujoco.FatalError) as error:
                raise SimulationError(f"{content['model']} does not load: {error}") from error
        return content
