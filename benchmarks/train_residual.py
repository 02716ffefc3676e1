"""Trains the residual policy of examples/train_residual.py and tells how it ended.

`python benchmarks/train_residual.py --write docs/data/train_residual.json`; the learning curve goes
to docs/images/train_residual.webp with `--figure`, from kept results with `--render`. Interrupted,
the training goes on in runs/train_residual.
"""

import argparse
import json
import subprocess
import sys
from typing import Any

import results

FOLDER = results.ROOT / "runs" / "train_residual"
FIGURE = results.ROOT / "docs" / "images" / "train_residual.webp"
SHOWN = (1, 5, 10, 20, 40)  # generations of the table, beside the last


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Trains, with the example's own settings."""
    del options
    script = results.ROOT / "examples" / "train_residual.py"
    subprocess.run([sys.executable, str(script), "--out", str(FOLDER)], check=True)
    return json.loads((FOLDER / "result.json").read_text())


def tables(found: dict[str, Any]) -> str:
    """The curve, and the judgement."""
    curve = found["curve_median_best_mrad"]
    shown = [n for n in SHOWN if n < len(curve)] + [len(curve)]
    rows = [(str(n), *(f"{value:.2f}" for value in curve[n - 1])) for n in shown]
    head = ["generation", "median candidate, mrad", "best candidate, mrad"]
    return results.table(head, rows) + "\n" + judgement(found, "with the trained residual")


def judgement(found: dict[str, Any], name: str) -> str:
    """Errors on machines that training did not see, without and with a policy of this name."""
    alone, policy = found["static_feedforward_mrad"], found["policy_mrad"]
    better = sum(p < a for a, p in zip(alone, policy, strict=True))
    rows = [
        ("`static_feedforward`", f"{sum(alone) / len(alone):.2f}", f"{max(alone):.2f}", ""),
        (
            name,
            f"{sum(policy) / len(policy):.2f}",
            f"{max(policy):.2f}",
            f"{better} of {len(alone)}",
        ),
    ]
    head = ["machines that training did not see", "mean, mrad", "worst, mrad", "better on"]
    return results.table(head, rows)


def draw() -> None:
    """Draws the learning curve from the kept results."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    record = json.loads((results.DATA / "train_residual.json").read_text())
    found = record["results"]
    median, best = zip(*found["curve_median_best_mrad"], strict=True)
    alone = found["static_feedforward_mrad"]
    figure, axis = plt.subplots(figsize=(6.4, 3.2), layout="constrained")
    generations = range(1, len(median) + 1)
    axis.semilogy(generations, median, color="0.6", label="median candidate")
    axis.semilogy(generations, best, color="tab:blue", label="best candidate")
    axis.axhline(sum(alone) / len(alone), color="k", linestyle="--", label="static_feedforward")
    axis.set(xlabel="generation", ylabel="RMS error with worn seals [mrad]")
    axis.legend()
    figure.savefig(FIGURE, dpi=90)


def main() -> None:
    """Trains, prints what is kept, or draws it."""
    if sys.argv[1:] == ["--figure"]:
        draw()
        return
    results.main(argparse.ArgumentParser(description=__doc__.partition("\n")[0]), measure, tables)


if __name__ == "__main__":
    main()
