"""The self-test of `leglab diagnose`, scored and kept: `python benchmarks/diagnosis_self_test.py`.

Goes on where a call with the same `--out` was interrupted.
"""

import argparse
from pathlib import Path

import results

from leglab.studies.blind.selftest import SCORE_HEAD, scores, self_test


def main() -> None:
    """Runs, or prints what is kept."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--cases", type=int, default=100, help="with a single effect")
    parser.add_argument("--out", type=Path, default=Path("runs/self_test"))
    results.main(
        parser,
        lambda options: scores(self_test(options.out, options.cases)),
        lambda rows: results.table(SCORE_HEAD, rows),
    )


if __name__ == "__main__":
    main()
