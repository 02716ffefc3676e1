"""Limits of re-adaptation.

Learning is stopped some time after the change; the error of the last strides tells how much of the
changed machine had been seen by then. A stride takes 1.2 s: what a joint does in the rest of it has
not been seen before. The last columns are learning that goes on, and the map of the same structure
fitted offline: where going on is better than both, one fixed map is not enough. RMS tracking errors
in mrad, over specimens.
"""

import argparse

import numpy as np

from benchmarks import results
from benchmarks.specimens import FEW, first_change, run_specimen

SEEN = (0.3, 0.6, 1.2, 2.4, 4.8, 7.2, None)  # s of the changed machine
CASES = ("seal_wear", "cold_oil", "hot_oil", "valve_wear", "supply_droop")


def end_errors(scenario: str, seed: int) -> list[float]:
    """Errors in the last strides [mrad], in the order of `SEEN`, then the oracle's."""

    def error(controller: str, **settings: float) -> tuple[float, float]:
        run = run_specimen(
            seed, scenario=scenario, controller=controller, controller_config=settings
        )
        end = run.record.adaptation.end_rad
        assert end is not None
        return 1e3 * end["all"], first_change(run)

    going_on, change = error("bsnn_arx")
    stopped = [error("bsnn_arx", stop_time=change + t)[0] for t in SEEN if t is not None]
    return [*stopped, going_on, error("oracle")[0]]


def measure(options: argparse.Namespace) -> dict[str, list[float]]:
    """Means over specimens, by scenario."""
    del options
    return {
        scenario: np.mean([end_errors(scenario, seed) for seed in FEW], axis=0).tolist()
        for scenario in CASES
    }


def tables(errors: dict[str, list[float]]) -> str:
    """A row a scenario."""
    spans = ("all" if t is None else f"{t:g} s" for t in SEEN)
    head = ["learned after the change", *spans, "oracle"]
    return results.table(
        head, [(name, *(results.number(x, 2) for x in row)) for name, row in errors.items()]
    )
