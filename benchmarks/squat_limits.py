"""What limits adaptation in the squat: `python benchmarks/squat_limits.py`.

First table: the map learned online against the one fitted offline on the changed machine
(`oracle`), the longer the squat goes on after the change. Second table: seals wear further and
further; the part of the last seconds in which some valve is open by more than 95 % tells how far
it is from what the valves can give. RMS tracking errors in mrad.
"""

import numpy as np
from rich.console import Console
from rich.table import Table

from leglab.rollout import History
from leglab.runner import RunSettings, run_scenario

CHANGE, DURATION = 40.0, 80.0  # s
WINDOWS = ((2.0, 4.0), (5.0, 10.0), (15.0, 20.0), (35.0, 40.0))  # s after the change
CASES = ("seal_wear", "hot_oil", "friction_rise", "stiction", "spring_fatigue")
FACTORS = (10.0, 20.0, 30.0, 40.0, 50.0)
OPEN = 0.95


def history(
    scenario: str, controller: str, duration: float, severity: float | None = None
) -> History:
    """A squat of the leg."""
    return run_scenario(
        RunSettings(
            scenario=scenario,
            controller=controller,
            reference="squat",
            duration=duration,
            severity=severity,
        )
    ).history


def error(run: History, start: float, end: float) -> float:
    """RMS over joints and a time span [mrad]."""
    inside = (run.time >= start) & (run.time < end)
    return float(1e3 * np.sqrt(np.mean(run.error[inside] ** 2)))


def longer() -> Table:
    """Error of both maps by time since the change."""
    table = Table(title="bsnn_arx / oracle by seconds after the change, mrad")
    table.add_column("scenario")
    for start, end in WINDOWS:
        table.add_column(f"{start:g}-{end:g} s", justify="right")
    for scenario in CASES:
        runs = [history(scenario, name, DURATION) for name in ("bsnn_arx", "oracle")]
        table.add_row(
            scenario,
            *(
                " / ".join(f"{error(run, CHANGE + a, CHANGE + b):.2f}" for run in runs)
                for a, b in WINDOWS
            ),
        )
    return table


def harder() -> Table:
    """Error of both maps, and how open the valves are, by leakage."""
    table = Table(title="seal_wear, last 5 s of 20 s, by leakage over new")
    for name in ("leakage", "bsnn_arx", "oracle", "ratio", "a valve open, % of the time"):
        table.add_column(name, justify="right")
    for factor in FACTORS:
        runs = [history("seal_wear", name, 20.0, factor) for name in ("bsnn_arx", "oracle")]
        learned, offline = (error(run, 15.0, 20.0) for run in runs)
        open_ = np.abs(runs[0].command[runs[0].time >= 15.0]).max(axis=1) > OPEN
        table.add_row(
            f"{factor:g}",
            f"{learned:.2f}",
            f"{offline:.2f}",
            f"{learned / offline:.2f}",
            f"{100 * open_.mean():.0f}",
        )
    return table


def main() -> None:
    """Prints both tables."""
    console = Console()
    console.print(longer())
    console.print(harder())


if __name__ == "__main__":
    main()
