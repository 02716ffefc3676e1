"""What limits re-adaptation: `python benchmarks/readaptation_limit.py`.

Learning is stopped some time after the change; the error of the last 5 s tells how much of the
changed machine had been seen by then. A stride takes 1.2 s: what a joint does in the rest of it has
not been seen before. RMS tracking errors in mrad.
"""

import argparse

import numpy as np
import results

from leglab import RunSettings, run_scenario

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


def measure(options: argparse.Namespace) -> dict[str, list[float]]:
    """Errors in the order of `SEEN`, by scenario."""
    del options
    return {scenario: [end_error(scenario, seen) for seen in SEEN] for scenario in CASES}


def tables(errors: dict[str, list[float]]) -> str:
    """A row a scenario."""
    head = ["learned after the change", *("all" if t is None else f"{t:g} s" for t in SEEN)]
    return results.table(
        head, [(name, *(results.number(x, 2) for x in row)) for name, row in errors.items()]
    )


def main() -> None:
    """Measures, or prints what is kept."""
    results.main(argparse.ArgumentParser(description=__doc__.partition("\n")[0]), measure, tables)


if __name__ == "__main__":
    main()
