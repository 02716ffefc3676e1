"""What adapting gains on a changing machine: `python benchmarks/adaptation_claims.py`.

Runs every scenario with every controller and many seeds (an interrupted call goes on where it was)
and prints one table a claim; `--write FILE` writes them as Markdown. Errors are RMS over joints and
time in mrad, of the true positions; intervals are 95 % over seeds.
"""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

from adaptation_tables import Cells, Table, claims
from rich.console import Console
from rich.progress import Progress

from leglab.errors import LeglabError
from leglab.runner import RunSettings
from leglab.scenario import get_scenario, scenario_names
from leglab.sweep import run_all

ALL = (
    "pd",
    "static_feedforward",
    "frozen",
    "bsnn_arx",
    "oracle",
    "arx",
    "bsnn_arx_paper",
    "adaptive_backstepping",
)
NEEDED = ("static_feedforward", "frozen", "bsnn_arx", "oracle")
SAFETY = ("static_feedforward", "bsnn_arx")

# Beside the defaults, as the scenario's documentation names them.
SEVERITIES = {"seal_wear": (2.0, 50.0)}


@dataclass(frozen=True, kw_only=True)
class Rig:
    """A machine with a motion.

    Attributes:
        model: Name of the model.
        reference: Name of the reference; None for the scenario's own.
        controllers: Which ones run in every scenario.
        without: Scenarios that this machine does not have.
    """

    model: str
    reference: str | None
    controllers: tuple[str, ...]
    without: tuple[str, ...] = ()

    def runs(self, seeds: int) -> dict[tuple[str, float | None], list[RunSettings]]:
        """Settings of all runs, by scenario and severity (None for its own)."""
        cases: list[tuple[str, float | None]] = [
            (name, None) for name in scenario_names() if name not in self.without
        ]
        cases += [(name, value) for name, values in SEVERITIES.items() for value in values]
        return {
            (name, severity): [
                RunSettings(
                    scenario=name,
                    severity=severity,
                    controller=controller,
                    model=self.model,
                    reference=self.reference,
                    seed=seed,
                    duration=max(20.0, get_scenario(name).duration),
                )
                for controller in self._of(name)
                for seed in range(seeds)
            ]
            for name, severity in cases
        }

    def _of(self, scenario: str) -> tuple[str, ...]:
        return ("pd", *self.controllers) if scenario == "nominal" else self.controllers


RIGS = {
    "leg, walking": Rig(model="leg", reference=None, controllers=ALL[1:]),
    "leg, squat": Rig(model="leg", reference="squat", controllers=NEEDED),
    "leg, random stride": Rig(model="leg", reference="random_stride", controllers=NEEDED),
    "knee_bench, walking": Rig(
        model="knee_bench", reference=None, controllers=ALL[1:], without=("supply_droop",)
    ),
    "leg_rail, squat": Rig(model="leg_rail", reference="squat", controllers=SAFETY),
}


def gather(rig: Rig, seeds: int, folder: Path, jobs: int) -> Cells:
    """Results by scenario, severity and controller."""
    cells: Cells = {}
    with Progress() as bar:
        cases = rig.runs(seeds)
        task = bar.add_task(folder.name, total=sum(len(runs) for runs in cases.values()))
        for (name, severity), runs in cases.items():
            at = folder / (name if severity is None else f"{name}-{severity:g}")
            for result in run_all(runs, at, jobs=jobs):
                controller = result["settings"]["controller"]
                cells.setdefault((name, severity, controller), []).append(result)
            bar.advance(task, len(runs))
    return cells


def main() -> None:
    """Runs, prints, and writes where asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--jobs", type=int, default=-1)
    parser.add_argument("--out", type=Path, default=Path("runs/claims"))
    parser.add_argument("--rigs", nargs="*", default=list(RIGS), choices=list(RIGS))
    parser.add_argument("--controllers", nargs="*", help="only these")
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    console = Console(width=150)
    page = []
    for name in options.rigs:
        rig = RIGS[name]
        if options.controllers:
            chosen = tuple(c for c in rig.controllers if c in options.controllers)
            rig = replace(rig, controllers=chosen)
        folder = options.out / name.replace(", ", "-").replace(" ", "_")
        try:
            cells = gather(rig, options.seeds, folder, options.jobs)
        except LeglabError as error:
            raise SystemExit(f"error: {error}") from None
        for table in claims(cells, name):
            console.print(table.rich())
            page.append(table.markdown())
    if options.write:
        options.write.write_text(header(options.seeds) + "\n\n".join(page) + "\n")


def header(seeds: int) -> str:
    """First lines of the page."""
    return (
        "# What adapting gains\n\n"
        f"Made by `python benchmarks/adaptation_claims.py --seeds {seeds} --write FILE`; not to be "
        "edited by hand. Errors\nin mrad, RMS over joints and time; every row has "
        f"{seeds} seeds.\n\n"
    )


__all__ = ["Table", "main"]

if __name__ == "__main__":
    main()
