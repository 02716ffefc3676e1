"""The self-test of `leglab diagnose`, scored and kept: `python benchmarks/diagnosis_self_test.py`.

Goes on where a call with the same `--out` was interrupted. With `--rough` on specimens that differ
from their model everywhere a little; figures are written beside the outcomes.
"""

import argparse
from pathlib import Path
from typing import Any

import results

from leglab.studies.blind import rough_selftest
from leglab.studies.blind.rough_bench import SIZES
from leglab.studies.blind.selftest import SCORE_HEAD, scores, self_test


def measure(options: argparse.Namespace) -> Any:
    if not options.rough and options.sizes == "gross":
        return scores(self_test(options.out, options.cases))
    from leglab.studies.blind.rough_figures import save_figures

    settings = rough_selftest.RoughTestSettings(
        rough=options.rough,
        sizes=options.sizes,
        healthy=options.rough and not options.no_healthy,
        seed=options.seed,
    )
    outcomes = rough_selftest.rough_self_test(options.out, options.cases, settings)
    save_figures(outcomes, options.out, settings.name)
    return {
        "scores": rough_selftest.scores(outcomes, settings),
        "reliability": rough_selftest.reliability_rows(rough_selftest.reliability(outcomes)),
    }


def tables(kept: Any) -> str:
    if isinstance(kept, list):
        return results.table(SCORE_HEAD, kept)
    confidence = results.table(rough_selftest.RELIABILITY_HEAD, kept["reliability"])
    return results.table(rough_selftest.HEAD, kept["scores"]) + "\n" + confidence


def main() -> None:
    """Runs, or prints what is kept."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--cases", type=int, default=100, help="with a single effect")
    parser.add_argument("--out", type=Path, default=Path("runs/self_test"))
    parser.add_argument("--rough", action="store_true", help="rough specimens")
    parser.add_argument(
        "--no-healthy", action="store_true", help="no recordings from before the fault"
    )
    parser.add_argument("--sizes", choices=SIZES, default="gross")
    parser.add_argument("--seed", type=int, default=0, help="of the rough or drawn specimens")
    results.main(parser, measure, tables)


if __name__ == "__main__":
    main()
