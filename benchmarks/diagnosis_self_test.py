"""Blind cases of the diagnosis, scored.

Goes on where a call with the same `--out` was interrupted. With `--rough` on specimens that differ
from their model everywhere a little, with recordings from before the fault; figures are written
beside the outcomes.
"""

import argparse
from pathlib import Path
from typing import Any

from benchmarks import results
from benchmarks.self_test import exact, rough
from benchmarks.self_test.figures import save_figures
from leglab.base.errors import SettingsError
from leglab.base.output import claimed_folder
from leglab.cli.options import check_jobs
from leglab.cli.terminal import progress
from rigs.rough_bench import SIZES


def measure(options: argparse.Namespace) -> Any:
    """Scores, and of rough or visible faults the confidences."""
    for name, least in (("cases", 1), ("seed", 0)):
        if getattr(options, name) < least:
            told = f"{name} is {getattr(options, name)}; allowed: "
            raise SettingsError(told, given=getattr(options, name), allowed=f"{least} or more")
    check_jobs(options.jobs)
    where = {"processes": options.jobs, "scheduler": options.scheduler}
    with claimed_folder(options.out), progress("self-test", options.cases) as show:

        def tell(done: int, total: int, label: str) -> None:
            show(description=label or "self-test", completed=done, total=total)

        if not options.rough and options.sizes == "gross":
            found = exact.self_test(
                options.out, options.cases, seed=options.seed, progress=tell, **where
            )
            return {"scores": exact.scores(found), "missed": exact.missed(found)}
        settings = rough.RoughTestSettings(
            rough=options.rough,
            sizes=options.sizes,
            healthy=options.rough and not options.no_healthy,
            seed=options.seed,
        )
        outcomes = rough.rough_self_test(
            options.out, options.cases, settings, progress=tell, **where
        )
    save_figures(outcomes, options.out, settings.name)
    return {
        "scores": rough.scores(outcomes, settings),
        "missed": rough.missed(outcomes),
        "reliability": rough.reliability_rows(rough.reliability(outcomes)),
    }


def tables(kept: Any) -> str:
    """Scores, what was missed, and how often names of a confidence are right."""
    of = rough if "reliability" in kept else exact
    head = rough.HEAD if of is rough else exact.SCORE_HEAD
    parts = [results.table(head, kept["scores"]), results.table(of.MISSED_HEAD, kept["missed"])]
    if of is rough:
        parts.append(results.table(rough.RELIABILITY_HEAD, kept["reliability"]))
    return "\n".join(parts)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--cases", type=int, default=100, help="with a single effect")
    parser.add_argument("--out", type=Path, default=Path("runs/self_test"))
    parser.add_argument("--rough", action="store_true", help="rough specimens")
    parser.add_argument(
        "--no-healthy", action="store_true", help="no recordings from before the fault"
    )
    parser.add_argument("--sizes", choices=SIZES, default="gross")
    parser.add_argument("--seed", type=int, default=0, help="of the cases")
    parser.add_argument("--jobs", type=int, default=-1, help="cases at a time; -1: one a core")
    parser.add_argument("--scheduler", help="Dask scheduler whose workers do the work")
