"""Trains the network of examples/train_residual_ppo.py and tells how it ended.

`python benchmarks/train_residual_ppo.py --write docs/data/train_residual_ppo.json`; the learning
curve goes to docs/images/train_residual_ppo.webp with `--figure`, from kept results. Needs the
extra `ppo`.
"""

import argparse
import json
import subprocess
import sys
from typing import Any

import results
from train_residual import judgement

FOLDER = results.ROOT / "runs" / "train_residual_ppo"
FIGURE = results.ROOT / "docs" / "images" / "train_residual_ppo.webp"


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Trains, with the example's own settings."""
    del options
    script = results.ROOT / "examples" / "train_residual_ppo.py"
    subprocess.run([sys.executable, str(script), "--out", str(FOLDER)], check=True)
    return json.loads((FOLDER / "result.json").read_text())


def tables(found: dict[str, Any]) -> str:
    """The judgement."""
    return judgement(found, f"with a network trained for {found['seconds']:.0f} s")


def draw() -> None:
    """Draws the learning curve from the kept results."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    _, steps, reward = zip(*results.load("train_residual_ppo")["curve_s_steps_reward"], strict=True)
    figure, axis = plt.subplots(figsize=(6.4, 3.0), layout="constrained")
    axis.plot([step / 1000 for step in steps], [-value for value in reward])
    axis.set(
        xlabel="steps of 2 ms of all machines together [1000]",
        ylabel="cost a step: mean of\nsqrt(error / 10 mrad)",
        ylim=(0, None),
    )
    figure.savefig(FIGURE, dpi=90)


def main() -> None:
    """Trains, prints what is kept, or draws it."""
    if sys.argv[1:] == ["--figure"]:
        draw()
        return
    results.main(argparse.ArgumentParser(description=__doc__.partition("\n")[0]), measure, tables)


if __name__ == "__main__":
    main()
