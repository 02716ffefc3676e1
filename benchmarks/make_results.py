"""Makes all of docs/data anew, then the tables of README.md and docs: `make results`.

One command after the other, so that times are not disturbed by each other, the long ones last;
`python benchmarks/make_results.py NAME...` makes only some. Needs the benchmarks group
(`pip install --group benchmarks`) and the recordings in $LEGLAB_DATA or ../shared/data.
"""

import argparse
import shlex
import subprocess
import sys
import time
from dataclasses import dataclass

import results


@dataclass(frozen=True, kw_only=True)
class Job:
    """A file of docs/data.

    Attributes:
        name: Its stem.
        command: What makes it.
        minutes: About how long that takes on two cores.
    """

    name: str
    command: str
    minutes: float


def _job(name: str, minutes: float, script: str = "", options: str = "") -> Job:
    words = ["python", f"benchmarks/{script or name}.py", *shlex.split(options)]
    command = shlex.join([*words, "--write", f"docs/data/{name}.json"])
    return Job(name=name, command=command, minutes=minutes)


JOBS = (
    _job("speed", 0.2),
    _job("leg_speed", 0.4),
    _job("newcomer", 15),
    _job("environment_speed", 2.5, options="--rounds 100"),
    _job("identification_peers", 1.5),
    _job("integration_accuracy", 0.7),
    _job("diagnosis_rollouts", 0.4),
    _job("readaptation_limit", 0.4),
    _job("never_worse", 4, options="--specimens 2"),
    _job("two_routes", 0.5),
    _job("real_data", 0.2),
    _job("replication", 1),
    _job("sweeps", 2, options="--short 1000 --long 6 --rows 20000"),
    _job("squat_limits", 1),
    _job("peers", 1.5),
    _job("train_residual", 3),
    _job("train_residual_ppo", 4),
    _job("long_run", 2.5),
    _job("live_names", 8, options="--jobs 2"),
    _job("correction_bench", 5, options="--jobs 2"),
    _job(
        "live_names_elsewhere",
        15,
        "live_names",
        "--specimens 3 --jobs 2 --elsewhere "
        "'12-bit encoders with 15 times the noise,squat,squat on the ground,"
        "another fault 5 s before'",
    ),
    _job("health", 20, options="--specimens 1"),
    _job("microcontroller", 2),
    _job("pressures", 10, options="--specimens 3"),
    _job("tracking_bound", 8),
    _job("adaptation_benchmark", 25),
    _job("adaptation_results", 90, "adaptation_claims"),
)


def make(job: Job) -> bool:
    """Runs a command in the repository's root; says whether it ended well."""
    print(f"{job.name}: about {job.minutes:g} min: {job.command}", flush=True)
    began = time.monotonic()
    words = shlex.split(job.command)
    done = subprocess.run([sys.executable, *words[1:]], cwd=results.ROOT, stdout=subprocess.DEVNULL)
    spent = (time.monotonic() - began) / 60
    print(f"{job.name}: {'made' if done.returncode == 0 else 'FAILED'} in {spent:.1f} min")
    return done.returncode == 0


def listing() -> str:
    """All jobs, as Markdown."""
    rows = [(f"`docs/data/{j.name}.json`", f"`{j.command}`", f"{j.minutes:g}") for j in JOBS]
    return results.table(("file", "command", "minutes"), rows)


def main() -> None:
    """Makes all, or those that are named; everything else is tried if one fails."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    known = [job.name for job in JOBS]
    parser.add_argument("names", nargs="*", metavar="NAME", help="of docs/data; default: all")
    parser.add_argument("--list", action="store_true", help="print the commands with their minutes")
    options = parser.parse_args()
    if unknown := [name for name in options.names if name not in known]:
        parser.error(f"{', '.join(unknown)}: allowed are {', '.join(known)}")
    if options.list:
        print(listing(), end="")
        return
    jobs = [job for job in JOBS if job.name in (options.names or known)]
    failed = [job.name for job in jobs if not make(job)]
    print("tables of README.md and docs", flush=True)
    tables = subprocess.run([sys.executable, "-m", "tests.tables", "--write"], cwd=results.ROOT)
    if failed:
        raise SystemExit(f"error: not made: {', '.join(failed)}")
    raise SystemExit(tables.returncode)


if __name__ == "__main__":
    main()
