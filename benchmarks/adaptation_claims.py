"""What adapting gains on a changing machine: `python benchmarks/adaptation_claims.py`.

Runs every scenario with every controller and many seeds (an interrupted call goes on where it was)
and prints one table a claim. A seed draws the specimen about the machine that controllers know, the
phase of the stride, the time of the change and the sensor noise. `--write FILE` keeps what the
tables are made from, with where it comes from; `--render` prints the page from there without
running anything, which is how a test keeps page and data together. Errors are RMS over joints and
time in mrad, of the true positions; intervals are 95 % over seeds.
"""

import argparse
import re
from dataclasses import dataclass
from pathlib import Path

import results
from adaptation_data import DATA, Cells, condense, read, rows, save, stored
from adaptation_tables import claims
from rich.console import Console
from rich.progress import Progress
from specimens import TOLERANCE

from leglab import RunSettings
from leglab.base.errors import LeglabError
from leglab.base.scenario import get_scenario, scenario_names
from leglab.runs.comparison import run_all

PEERS = ("pid", "arx", "bsnn_arx_paper", "adaptive_backstepping")
NEEDED = ("static_feedforward", "bsnn_arx", "oracle")
SAFETY = ("static_feedforward", "bsnn_arx")
HEADER = """# What adapting gains

Made by `python benchmarks/adaptation_claims.py --render > docs/results/adaptation_tables.md`
from docs/data/adaptation_results.json; not to be edited.

A seed draws the specimen (every parameter off the drawing by a factor of standard deviation 10 %),
the phase of the stride, the time of the change (8 to 12 s of 20) and the sensor noise; the exact
machine is a chapter of its own. Controllers know the drawing, never the specimen
([what the calibration knows](../guides/calibration.md)). Errors are RMS over joints and time in mrad, of the
true positions; 95 % intervals over seeds.

- `before` is the whole strides of the 5 s before the change, `end` those of the last 5 s.
- `frozen` is `bsnn_arx` with adaptation stopped just before the change. Its error after the change
  less `before` is the damage; `undone` is the share of it that is gone at the end.
- `90 % after` is the time from the change until no stride that begins later exceeds `before` by
  more than a tenth of the damage.

{origin}

"""

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
        exact: Whether the machine is the one that controllers know, and no seed draws more than
            sensor noise.
    """

    model: str
    reference: str | None
    controllers: tuple[str, ...]
    seeds: int = 3
    peer_seeds: int = 2
    only: tuple[str, ...] | None = None
    exact: bool = False

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
                    tolerance=0.0 if self.exact else TOLERANCE,
                    vary=not self.exact,
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


FULL = (*NEEDED, *PEERS)
EXACT = ("nominal", "seal_wear", "cold_oil", "supply_drop")
FEW = (*EXACT, "friction_rise", "valve_wear")
RIGS = {
    "leg, walking": Rig(model="leg", reference=None, controllers=FULL, seeds=10),
    "leg, walking, exact machine": Rig(
        model="leg", reference=None, controllers=FULL, seeds=1, peer_seeds=1, exact=True, only=EXACT
    ),
    "knee_bench, walking": Rig(model="knee_bench", reference=None, controllers=NEEDED),
    "leg, squat": Rig(model="leg", reference="squat", controllers=NEEDED, seeds=2),
    "leg, random stride": Rig(model="leg", reference="random_stride", controllers=NEEDED, only=FEW),
    "leg_rail, squat": Rig(model="leg_rail", reference="squat", controllers=SAFETY, seeds=2),
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


def page(record: dict, rigs: dict[str, Cells]) -> str:
    """The page of condensed results."""
    tables = [table.markdown() for name, cells in rigs.items() for table in claims(cells, name)]
    return HEADER.format(origin=results.origin_line(record)) + "\n\n".join(tables) + "\n"


def main() -> None:
    """Runs, prints, and writes where asked."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--jobs", type=int, default=-1)
    parser.add_argument("--out", type=Path, default=Path("runs/claims"))
    parser.add_argument("--rigs", nargs="*", default=list(RIGS), choices=list(RIGS))
    parser.add_argument("--write", type=Path, metavar="FILE", help=f"keep results, as {DATA.name}")
    parser.add_argument("--render", action="store_true", help="print the page of kept results")
    parser.add_argument(
        "--stored", action="store_true", help="take what --out holds, whatever code made it"
    )
    options = parser.parse_args()
    if options.render:
        print(page(*read()), end="")
        return
    origin = results.origin_of(results.command("adaptation_claims.py"))
    console = Console(width=150)
    rigs: dict[str, Cells] = {}
    for name in options.rigs:
        folder = options.out / re.sub(r"\W+", "-", name)
        try:
            raw = gather(RIGS[name], folder, options.jobs, as_stored=options.stored)
        except LeglabError as error:
            raise SystemExit(f"error: {error}") from None
        rigs[name] = condense(raw)
        for table in claims(rigs[name], name):
            console.print(table.rich())
    if options.write:
        save(results.kept(origin, rows(rigs)), options.write)


if __name__ == "__main__":
    main()
