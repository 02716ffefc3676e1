"""Table 1 of the paper, as `leglab replicate` finds it.

Below it what the learning constant that the paper prints does to the order of its models.

Page and figures of the same run go to docs/results/replication.
"""

import argparse
from pathlib import Path
from typing import Any

from benchmarks import results
from replication import paper, replicate
from replication.experiments import Order
from replication.page import order_table
from replication.run import REALISATIONS


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Output of `leglab replicate --json`, without paths."""
    found = replicate(options.instances, options.out).to_json()
    return {key: value for key, value in found.items() if key not in ("page", "figures")}


def tables(found: dict[str, Any]) -> str:
    """Table 1, validation set; order of the models by learning constant and F(0)."""
    rows = []
    for model in paper.MODELS:
        got, printed = found["scores"]["validation"][model], paper.TABLE_1["validation"][model]
        spread = found["spread"][model]
        rows.append(
            (
                model,
                f"{got['rms_mean']:.4f} ({printed.rms_mean:.4f})",
                f"{got['r2_mean']:.3f} ({printed.r2_mean:.3f})",
                f"{spread['rms_mean']:.4f} ± {spread['rms_std']:.4f}",
            )
        )
    last = f"RMS, mean and standard deviation over {REALISATIONS} noise realisations"
    table_1 = results.table(("model", "RMS mean", "R² mean", last), rows)
    return f"{table_1}\n{order_table([Order(**row) for row in found['orders']], REALISATIONS)}"


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--instances", type=int, default=paper.INSTANCES)
    parser.add_argument("--out", type=Path, default=Path("docs/results/replication"))
