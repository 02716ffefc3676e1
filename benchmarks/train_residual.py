"""The residual policies of examples/, trained: by evolution, or with `--ppo` by PPO.

PPO trains the network of examples/train_residual_ppo.py and needs the extra `ppo`.

`--figure` draws the learning curve of kept results to docs/images. Interrupted, the training goes
on in runs/train_residual.
"""

import argparse
import json
import subprocess
import sys
from typing import Any

from benchmarks import results
from benchmarks.registry import ROOT

SHOWN = (1, 5, 10, 20, 40)  # generations of the table, beside the last


def measure(options: argparse.Namespace) -> dict[str, Any] | None:
    """Trains, with the example's own settings; with `--figure` draws only."""
    name = "train_residual_ppo" if options.ppo else "train_residual"
    if options.figure:
        _draw(name)
        return None
    script, folder = ROOT / "examples" / f"{name}.py", ROOT / "runs" / name
    subprocess.run([sys.executable, str(script), "--out", str(folder)], check=True)
    return json.loads((folder / "result.json").read_text())


def tables(found: dict[str, Any]) -> str:
    """The curve, and errors on machines that training did not see."""
    if "curve_s_steps_reward" in found:
        return _judgement(found, f"with a network trained for {found['seconds']:.0f} s")
    curve = found["curve_median_best_mrad"]
    shown = [n for n in SHOWN if n < len(curve)] + [len(curve)]
    rows = [(str(n), *(f"{value:.2f}" for value in curve[n - 1])) for n in shown]
    head = ["generation", "median candidate, mrad", "best candidate, mrad"]
    return results.table(head, rows) + "\n" + _judgement(found, "with the trained residual")


def _judgement(found: dict[str, Any], name: str) -> str:
    """Errors on machines that training did not see, without and with a policy of this name."""
    alone, policy = found["static_feedforward_mrad"], found["policy_mrad"]
    better = sum(p < a for a, p in zip(alone, policy, strict=True))
    rows = [
        (label, f"{sum(errors) / len(errors):.2f}", f"{max(errors):.2f}", of)
        for label, errors, of in (
            ("`static_feedforward`", alone, ""),
            (name, policy, f"{better} of {len(alone)}"),
        )
    ]
    head = ["machines that training did not see", "mean, mrad", "worst, mrad", "better on"]
    return results.table(head, rows)


def _draw(name: str) -> None:
    """Draws the learning curve from the kept results."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    found, ppo = results.load(name), name.endswith("ppo")
    figure, axis = plt.subplots(figsize=(6.4, 3.0 if ppo else 3.2), layout="constrained")
    if ppo:
        _, steps, reward = zip(*found["curve_s_steps_reward"], strict=True)
        axis.plot([step / 1000 for step in steps], [-value for value in reward])
        axis.set(
            xlabel="steps of 2 ms of all machines together [1000]",
            ylabel="cost a step: mean of\nsqrt(error / 10 mrad)",
            ylim=(0, None),
        )
    else:
        median, best = zip(*found["curve_median_best_mrad"], strict=True)
        alone, generations = found["static_feedforward_mrad"], range(1, len(median) + 1)
        axis.semilogy(generations, median, color="0.6", label="median candidate")
        axis.semilogy(generations, best, color="tab:blue", label="best candidate")
        axis.axhline(sum(alone) / len(alone), color="k", linestyle="--", label="static_feedforward")
        axis.set(xlabel="generation", ylabel="RMS error with worn seals [mrad]")
        axis.legend()
    figure.savefig(ROOT / "docs" / "images" / f"{name}.webp", dpi=90)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--ppo", action="store_true", help="the network of train_residual_ppo.py")
    parser.add_argument("--figure", action="store_true", help="draw the curve of kept results")
