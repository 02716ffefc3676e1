"""What limits re-adaptation: `python benchmarks/readaptation_limit.py`.

Learning is stopped some time after the change; the error of the last 5 s tells how much of the
changed machine had been seen by then. A stride takes 1.2 s: what a joint does in the rest of it has
not been seen before. RMS tracking errors in mrad.
"""

import numpy as np
from rich.console import Console
from rich.table import Table

from leglab.runner import RunSettings, run_scenario

SEEN = (0.3, 0.6, 1.2, 2.4, 4.8, None)  # s of the changed machine
CASES = ("seal_wear", "cold_oil", "hot_oil", "valve_wear")
CHANGE = 10.0


def end_error(scenario: str, seen: float | None) -> float:
    """RMS over joints in the last 5 s of 20 s."""
    settings = {} if seen is None else {"stop_time": CHANGE + seen}
    history = run_scenario(
        RunSettings(
            scenario=scenario, controller="bsnn_arx", duration=20.0, controller_config=settings
        )
    ).history
    return float(1e3 * np.sqrt(np.mean(history.error[history.time >= 15.0] ** 2)))


def main() -> None:
    """Prints the table."""
    table = Table(title="error 5-10 s after the change, by seconds of learning after it, mrad")
    table.add_column("scenario")
    for seen in SEEN:
        table.add_column("all" if seen is None else f"{seen:g} s", justify="right")
    for scenario in CASES:
        table.add_row(scenario, *(f"{end_error(scenario, seen):.2f}" for seen in SEEN))
    Console().print(table)


if __name__ == "__main__":
    main()
