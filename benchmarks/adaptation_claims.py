"""What adapting gains on a changing machine: `python benchmarks/adaptation_claims.py`.

Runs every scenario with every controller and many seeds (an interrupted call goes on where it was)
and prints one table a claim. `--write FILE` writes them as Markdown, and what they were made from
to docs/data; `--render` prints the page from there without running anything, which is how a test
keeps page and data together. Errors are RMS over joints and time in mrad, of the true positions;
intervals are 95 % over seeds.
"""

import argparse
import re
from dataclasses import dataclass, replace
from pathlib import Path

from adaptation_data import Cells, condense, read, save, stored
from adaptation_tables import claims
from rich.console import Console
from rich.progress import Progress

from leglab import RunSettings
from leglab.base.errors import LeglabError
from leglab.base.scenario import get_scenario, scenario_names
from leglab.runs.sweep import run_all

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
HEADER = """# What adapting gains

Made by `python benchmarks/adaptation_claims.py --render > docs/adaptation_results.md`
from the results of `{command}`; not to be edited.
RMS errors over joints and time in mrad, of the true positions; 95 % intervals over seeds. `before`
starts at 5 s, `end` is the last 5 s.

"""

PEERS = ("arx", "bsnn_arx_paper", "adaptive_backstepping")
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
        seeds: Number of them.
        peer_seeds: Number of them for controllers that no claim but the comparison needs.
        only: Scenarios; None for all.
        tolerance: Of the machine about the one that controllers know.
    """

    model: str
    reference: str | None
    controllers: tuple[str, ...]
    seeds: int = 3
    peer_seeds: int = 3
    only: tuple[str, ...] | None = None
    tolerance: float = 0.0

    def runs(self) -> dict[tuple[str, float | None], list[RunSettings]]:
        """Settings of all runs, by scenario and severity (None for its own)."""
        cases: list[tuple[str, float | None]] = [
            (name, None) for name in self.only or scenario_names() if self._has(name)
        ]
        if self.only is None:
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
                    tolerance=self.tolerance,
                )
                for controller in self._of(name)
                for seed in range(self.peer_seeds if controller in PEERS else self.seeds)
            ]
            for name, severity in cases
        }

    def _has(self, scenario: str) -> bool:
        # The bench's supply is ideal: no pump that could give too little.
        return self.model != "knee_bench" or scenario != "supply_droop"

    def _of(self, scenario: str) -> tuple[str, ...]:
        return ("pd", *self.controllers) if scenario == "nominal" else self.controllers


RIGS = {
    "leg, walking": Rig(model="leg", reference=None, controllers=ALL[1:], seeds=10, peer_seeds=2),
    "leg, squat": Rig(model="leg", reference="squat", controllers=ALL[1:], seeds=10, peer_seeds=2),
    "knee_bench, walking": Rig(
        model="knee_bench", reference=None, controllers=ALL[1:], peer_seeds=2
    ),
    "leg_rail, squat": Rig(model="leg_rail", reference="squat", controllers=SAFETY),
    "leg, walking, specimens 10 % off the drawing": Rig(
        model="leg",
        reference=None,
        controllers=("static_feedforward", "adaptive_backstepping", "bsnn_arx"),
        seeds=5,
        peer_seeds=5,
        only=("nominal", "seal_wear", "cold_oil", "hot_oil", "supply_drop", "payload"),
        tolerance=0.1,
    ),
    "leg, random stride": Rig(model="leg", reference="random_stride", controllers=NEEDED),
}


def gather(rig: Rig, folder: Path, jobs: int, *, as_stored: bool = False) -> Cells:
    """Results by scenario, severity and controller."""
    cells: Cells = {}
    with Progress() as bar:
        cases = rig.runs()
        task = bar.add_task(folder.name, total=sum(len(runs) for runs in cases.values()))
        for (name, severity), runs in cases.items():
            at = folder / (name if severity is None else f"{name}-{severity:g}")
            results = stored(runs, at) if as_stored else run_all(runs, at, jobs=jobs)
            for result in results:
                controller = result["settings"]["controller"]
                cells.setdefault((name, severity, controller), []).append(result)
            bar.advance(task, len(runs))
    return cells


def page(rigs: dict[str, Cells], command: str) -> str:
    """The page of condensed results."""
    tables = [table.markdown() for name, cells in rigs.items() for table in claims(cells, name)]
    return HEADER.format(command=command) + "\n\n".join(tables) + "\n"


def main() -> None:
    """Runs, prints, and writes where asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, help="of all controllers, instead of each rig's own")
    parser.add_argument("--jobs", type=int, default=-1)
    parser.add_argument("--out", type=Path, default=Path("runs/claims"))
    parser.add_argument("--rigs", nargs="*", default=list(RIGS), choices=list(RIGS))
    parser.add_argument("--controllers", nargs="*", help="only these")
    parser.add_argument("--write", type=Path, metavar="FILE")
    parser.add_argument("--render", action="store_true", help="print the page of committed results")
    parser.add_argument(
        "--stored", action="store_true", help="take what --out holds, whatever code made it"
    )
    options = parser.parse_args()
    if options.render:
        command, known = read()
        print(page(known, command), end="")
        return
    console = Console(width=150)
    rigs: dict[str, Cells] = {}
    for name in options.rigs:
        rig = RIGS[name]
        if options.controllers:
            chosen = tuple(c for c in rig.controllers if c in options.controllers)
            rig = replace(rig, controllers=chosen)
        if options.seeds:
            rig = replace(rig, seeds=options.seeds, peer_seeds=options.seeds)
        folder = options.out / re.sub(r"\W+", "-", name)
        try:
            raw = gather(rig, folder, options.jobs, as_stored=options.stored)
        except LeglabError as error:
            raise SystemExit(f"error: {error}") from None
        rigs[name] = condense(raw)
        for table in claims(rigs[name], name):
            console.print(table.rich())
    if options.write:
        command = "python benchmarks/adaptation_claims.py"
        if options.seeds:
            command += f" --seeds {options.seeds}"
        if options.rigs != list(RIGS):
            command += " --rigs " + " ".join(f'"{name}"' for name in options.rigs)
        if options.controllers:
            command += " --controllers " + " ".join(options.controllers)
        save(rigs, command)
        options.write.write_text(page(rigs, command))


if __name__ == "__main__":
    main()
