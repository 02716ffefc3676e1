"""All that measures leglab: one registry for the command, `make results`, the suite and pages."""

import ast
import importlib
import re
import shlex
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from leglab.base.errors import LeglabError, SettingsError

ROOT = Path(__file__).parents[1]
DATA = ROOT / "docs" / "data"


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """A benchmark.

    Its script has `measure(options)`, which gives the results as JSON holds them (None if it shows
    nothing), and `tables(results)`, their Markdown; where needed `add_options(parser)` and
    `wrong(results)`, true where the command must fail. Or it has a `main()` that does all.
    """

    name: str  #: After `python -m benchmarks`; the stem of its file, where it keeps one
    #: About how long it takes on two cores; None where that depends on its options.
    minutes: float | None = None
    kept: bool = False  #: Whether docs/data keeps its results
    script: str = ""  #: Its module in `benchmarks`; empty where that has the benchmark's name
    options: str = ""  #: That come before those of the command line
    #: Options for a look of a few seconds; None where `bench` leaves it out.
    quick: str | None = None
    title: str = ""  #: What it measures; empty where the first line of its script says it

    @property
    def command(self) -> str:
        """Command that runs it."""
        return f"python -m benchmarks {self.name}"

    @property
    def file(self) -> Path:
        """Where its results are kept."""
        return DATA / f"{self.name}.json"

    @property
    def path(self) -> Path:
        """Its script."""
        return Path(__file__).parent / f"{self.script or self.name}.py"

    def measures(self) -> str:
        """Measured quantity, in one line."""
        told = self.title or ast.get_docstring(ast.parse(self.path.read_text())) or ""
        return re.split(r": `python|\. |\n", told)[0].rstrip(".")

    def module(self) -> ModuleType:
        """Its script, imported.

        Raises:
            LeglabError: A package that it needs is not installed.
        """
        try:
            return importlib.import_module(f"benchmarks.{self.path.stem}")
        except ModuleNotFoundError as error:
            told = f"{self.name} needs {error.name}: pip install --group benchmarks"
            raise LeglabError(told) from error


def _kept(name: str, minutes: float, **more: str) -> Benchmark:
    return Benchmark(name=name, minutes=minutes, kept=True, **more)


# Those that docs/data keeps are made in this order: times are not disturbed, the long ones last.
BENCHMARKS = {
    benchmark.name: benchmark
    for benchmark in (
        _kept("speed", 0.2, quick=""),
        _kept("leg_speed", 0.4, quick="--bursts 20 --rounds 3 --duration 3"),
        _kept("newcomer", 15),
        _kept("environment_speed", 2.5, quick="--bursts 3 --rounds 5"),
        _kept("identification_peers", 1.5, quick="--samples 2000"),
        Benchmark(name="bsnn_arx_speed", minutes=0.5, quick="--passes 4"),
        _kept("integration_accuracy", 0.7, quick=""),
        _kept("diagnosis_rollouts", 0.4, quick="--rounds 3"),
        _kept("readaptation_limit", 0.4),
        _kept("never_worse", 4),
        _kept("two_routes", 0.5),
        _kept("identify", 25),
        _kept("replication", 1),
        _kept("sweeps", 2, quick="--short 100 --long 2 --rows 2000"),
        _kept("squat_limits", 1),
        _kept("peers", 1.5),
        _kept("train_residual", 3),
        _kept(
            "train_residual_ppo",
            4,
            script="train_residual",
            options="--ppo",
            title="The residual policy of examples/train_residual_ppo.py, trained by PPO",
        ),
        _kept("long_run", 2.5),
        _kept("live_names", 8),
        _kept("correction_bench", 5),
        _kept(
            "live_names_elsewhere",
            15,
            script="live_names",
            options="--specimens 3 --elsewhere",
            title="Live names under other conditions, and of faults that come and go",
        ),
        _kept("health", 20),
        _kept("microcontroller", 2),
        _kept("pressures", 10),
        _kept("tracking_bound", 8),
        _kept(
            "adaptation_benchmark",
            25,
            script="adaptation",
            options="--faults",
            title="Adaptive controllers in `leglab benchmark adaptation`",
        ),
        _kept("adaptation_results", 90, script="adaptation"),
        Benchmark(name="adaptation_tables", minutes=0.1),
        Benchmark(name="identification_tables", minutes=0.3),
        Benchmark(name="bench"),
        Benchmark(name="diagnosis_self_test"),
        Benchmark(name="diagnosis_calibration"),
        Benchmark(name="diagnosis_joints"),
        Benchmark(name="diagnosis_measured"),
        Benchmark(name="diagnosis_scales"),
        Benchmark(name="diagnosis_unexplained"),
        Benchmark(name="digests"),
        Benchmark(name="fit_gait"),
        Benchmark(name="mutation"),
        Benchmark(name="mutation_core"),
        Benchmark(name="soak"),
    )
}


def benchmark(name: str) -> Benchmark:
    """The benchmark of a name.

    Raises:
        LeglabError: There is none.
    """
    if name not in BENCHMARKS:
        raise SettingsError.unknown("benchmark", name, BENCHMARKS)
    return BENCHMARKS[name]


def shown() -> dict[str, dict[str, str]]:
    """Tables of README.md and docs that benchmarks make: by benchmark, text by page."""
    from tests.tables import made

    found: dict[str, dict[str, str]] = {}
    for part in made():
        program, *words = shlex.split(part.command)
        if program == "python" and words[:2] == ["-m", "benchmarks"]:
            pages = found.setdefault(words[2], {})
            pages[part.page] = pages.get(part.page, "") + part.text
    return found
