"""A first day with leglab: the commands of a new user one by one, with all that they print.

`python -m tests.helpers.first_day` writes docs/development/notes/first_day_output.txt anew.
"""

import os
import re
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from leglab import data
from leglab.base.errors import LeglabError
from leglab.runs.sweeps.engine import read_sweep

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "development" / "notes" / "first_day_output.txt"

CONTROLLER = '''"""A controller of my own."""

import leglab
from leglab.control import register_controller


class Settings(leglab.Configuration):
    """Settings of `mine`.

    Attributes:
        gain: Valve command per position error [1/rad].
    """

    gain: float = 1.0


@register_controller("mine", summary="proportional", configuration=Settings)
class Mine:
    def __init__(self, setup, config):
        self.gain = config.gain * setup.machine.direction

    def reset(self, measurement):
        pass

    def command(self, measurement, reference):
        return self.gain * (reference.position - measurement.position)
'''
WRONG_SWEEP = """[fixed]
model = "knee_bench"
"""
SWEEP = """[settings]
model = "knee_bench"
duration = 4.0

[[block]]
grid.scenario = ["nominal", "seal_wear"]
grid.controller = ["mine", "pd"]
grid.seed = { first = 0, count = 3 }
"""
MAP = """[columns]
t = "time"
"valve" = "knee_valve_command"
"knee angle [deg]" = {name = "knee_position", factor = 0.017453292519943295}
"""


@dataclass(frozen=True, kw_only=True)
class Step:
    """One command, what it printed in the order in which it did, and its exit status."""

    command: str
    output: str
    status: int


class Day:
    """Runs commands in a folder and keeps what they print."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.steps: list[Step] = []

    def run(self, command: str, until: Callable[[], bool] | None = None) -> Step:
        """Runs a command of leglab.

        Args:
            command: Without "leglab".
            until: Interrupts it as Ctrl-C does when this holds.
        """
        process = subprocess.Popen(
            [sys.executable, "-m", "leglab", *shlex.split(command)],
            cwd=self.folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env={**os.environ, "COLUMNS": "100", "LEGLAB_CACHE": str(self.folder / "cache")},
        )
        while until and process.poll() is None and not until():
            time.sleep(0.05)
        if until:
            process.send_signal(signal.SIGINT)
        output, _ = process.communicate()
        self.steps.append(Step(command=command, output=output, status=process.returncode))
        return self.steps[-1]

    def write(self, name: str, text: str) -> None:
        """Writes a file as a user does in an editor."""
        (self.folder / name).write_text(text)
        self.steps.append(Step(command=f"# {name}", output=text, status=0))

    def text(self) -> str:
        """All that was printed, without what differs from machine to machine."""
        lines = []
        for step in self.steps:
            head = step.command if step.command.startswith("#") else f"$ leglab {step.command}"
            lines += [head, step.output.rstrip(), *([f"[{step.status}]"] * bool(step.status)), ""]
        text = "\n".join(lines)
        for place in (str(ROOT), str(self.folder)):
            text = text.replace(place, ".")
        return re.sub(r"[ \t]+\n", "\n", text)


def rows(folder: Path) -> int:
    """Number of rows that a sweep has kept."""
    try:
        return read_sweep(folder).done
    except LeglabError:  # Not begun.
        return 0


def first_day(folder: Path) -> Day:
    """Spends the day in an empty folder."""
    day = Day(folder)
    day.run("--version")
    day.run("doctor")
    day.run("list seal_wear")
    day.run("run seal_wear --model knee_bench --controller bsnn_arx --duration 6 --out out/run")
    day.run("run seal_wear --model knee_bench --duration 6 --out out/run")
    day.run("report out/run --no-video")
    compare = "compare nominal seal_wear --model knee_bench --seeds 2 --duration 6"
    day.run(f"{compare} --out out/compare")
    day.run(f"{compare} --out out/compare")
    day.run("report out/compare")
    day.write("mine.py", CONTROLLER)
    own = "run nominal --model knee_bench --controller mine --load mine.py --duration 4"
    day.run(f"{own} --out out/mine")
    day.run(f"{own} --set controller.gian=3 --out out/mine_3")
    day.run("list mine --load mine.py")
    day.write("sweep.toml", WRONG_SWEEP)
    day.run("sweep sweep.toml --load mine.py --out out/sweep")
    day.write("sweep.toml", SWEEP)
    sweep = "sweep sweep.toml --load mine.py --out out/sweep"
    day.run(sweep, until=lambda: rows(folder / "out" / "sweep") >= 3)
    day.run(sweep)
    day.write("mine.py", CONTROLLER.replace("gain: float = 1.0", "gain: float = 1.2"))
    day.run(sweep)
    day.run(f"{sweep} --overwrite")
    day.run('query out/sweep "SELECT * FROM runs LIMIT 1"')
    day.run(
        'query out/sweep "SELECT scenario, controller, count(*) AS runs, '
        '1e3 * median(rms_rad) AS mrad FROM runs GROUP BY ALL ORDER BY ALL"'
    )
    day.run('query out/sweep "SELECT rms FROM runs"')
    day.run("report out/sweep --no-video")
    walk = data.read(ROOT / "tests" / "data" / "knee_bench_walk.parquet")
    angle = np.degrees(walk["knee_position"])
    table = np.column_stack([walk.time, walk["knee_valve_command"], angle])
    names = "t,valve,knee angle [deg]"
    np.savetxt(folder / "log.csv", table, delimiter=",", header=names, comments="", fmt="%.9g")
    day.run("diagnose knee_bench log.csv --out out/diagnosis")
    day.run("inspect log.csv")
    day.write("map.toml", MAP)
    day.run("inspect log.csv --columns map.toml")
    day.run("diagnose knee_bench log.csv --columns map.toml --out out/diagnosis")
    day.run("report out/diagnosis")
    day.run("index out")
    return day


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        PAGE.write_text(first_day(Path(place)).text())
