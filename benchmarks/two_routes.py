"""Inverse or forward model for the feed-forward: `python benchmarks/two_routes.py`.

Both learn the same features online; one says what flow a motion takes, the other what speed a flow
gives, which is then solved for the flow (identification.md). RMS tracking errors in mrad.
"""

import numpy as np
from rich.console import Console
from rich.table import Table

from leglab.runner import RunSettings, run_scenario

CASES = (
    ("leg", None, "seal_wear"),
    ("leg", None, "cold_oil"),
    ("leg", None, "valve_wear"),
    ("leg", None, "supply_drop"),
    ("leg", "squat", "seal_wear"),
    ("leg", "random_stride", "seal_wear"),
    ("leg_rail", "squat", "seal_wear"),
    ("knee_bench", None, "seal_wear"),
    ("knee_bench", None, "hot_oil"),
)
PARTS = ((-5, 0), (0, 2), (2, 4), (5, 10))  # s after the change
SEEDS = range(2)


def errors(model: str, reference: str | None, scenario: str, route: str) -> np.ndarray:
    """RMS over joints, time and seeds in each part."""
    squares = []
    for seed in SEEDS:
        history = run_scenario(
            RunSettings(
                scenario=scenario,
                controller="bsnn_arx",
                model=model,
                reference=reference,
                seed=seed,
                controller_config={"route": route},
            )
        ).history
        after = history.time - 10.0
        squares.append([np.mean(history.error[(after >= a) & (after < b)] ** 2) for a, b in PARTS])
    return 1e3 * np.sqrt(np.mean(squares, axis=0))


def main() -> None:
    """Prints the table."""
    table = Table(title="before / 0-2 / 2-4 / 5-10 s after the change, mrad")
    for column in ("model", "reference", "scenario", "inverse", "forward", "forward / inverse"):
        table.add_column(column)
    ratios = []
    for model, reference, scenario in CASES:
        inverse, forward = (
            errors(model, reference, scenario, route) for route in ("inverse", "forward")
        )
        ratios.append(forward / inverse)
        table.add_row(
            model,
            reference or "walking_stride",
            scenario,
            *(" / ".join(f"{x:.2f}" for x in values) for values in (inverse, forward, ratios[-1])),
        )
    mean = np.exp(np.mean(np.log(ratios), axis=0))
    table.add_row("geometric mean", "", "", "", "", " / ".join(f"{x:.2f}" for x in mean))
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
