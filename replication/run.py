"""`replicate`, which runs all parts of the replication in order and writes one page."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from leglab.base.errors import SettingsError
from replication import deployed, experiments, page, paper
from replication.online import BETTER_FIT
from replication.plant import simulate

REALISATIONS = 30
"""Noise realisations of the spread and of the deployed identifier's free run."""
CHANGE_SEEDS = 20
LONG_RUN = 6000
"""Samples after which theta is compared with theta at 1500."""


@dataclass(frozen=True, kw_only=True)
class Replication:
    """Results of `replicate`."""

    comparison: experiments.ModelComparison  #: Scores of all five models under paper mode
    #: ARX against BSNN-ARX, with paper mode's learning constant and the printed one.
    orders: list[experiments.Order]
    #: Mean, standard deviation, least and largest RMS of each model over realisations.
    spread: list[experiments.Errors]
    online_seconds: float  #: Run time of Table 1's three online models, 100 instances, one core
    page: Path  #: The page written
    figures: tuple[Path, ...]  #: Figures written

    @property
    def table(self) -> str:
        """Table 1 with the paper's values, as Markdown."""
        return paper.table_1(self.comparison.scores)

    @property
    def worst_deviation(self) -> float:
        """Largest relative deviation of a validation mean from Table 1."""
        return paper.worst_deviation(self.comparison.scores)

    def to_json(self) -> dict[str, Any]:
        """Returns the scores by set and model and the path of the page, as JSON values."""
        return {
            "scores": {
                part: {model: score.to_json() for model, score in models.items()}
                for part, models in self.comparison.scores.items()
            },
            "worst_deviation": self.worst_deviation,
            "spread": {
                model: {"rms_mean": mean, "rms_std": std} for model, mean, std, *_ in self.spread
            },
            "orders": [order._asdict() for order in self.orders],
            "online_seconds": self.online_seconds,
            "page": str(self.page),
            "figures": [str(figure) for figure in self.figures],
        }


def replicate(
    instances: int = paper.INSTANCES,
    out: str | Path = "out/replication",
    seed: int = paper.SEED,
    progress: Callable[[str], None] | None = None,
) -> Replication:
    """Replicates the paper and writes `replication.md` with its figures.

    Args:
        instances: Instances of each model, M of the paper.
        out: Folder for the page and the figures; made if missing.
        seed: Seed of the noise realisation and of the initial parameters.
        progress: Called with one line before each part.

    Raises:
        LeglabError: `instances` is no positive integer or `seed` is negative.
    """
    for name, value, least in (("instances", instances, 1), ("seed", seed, 0)):
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            told = f"{name} is {value!r}: must be "
            raise SettingsError(told, given=value, allowed=f"an integer of at least {least}")
    say = progress or (lambda line: None)
    sheet = page.Page(Path(out), "The paper's experiment replicated")

    say("the plant of Eq. 23")
    long_u, long_y = (signal[0] for signal in simulate([seed], LONG_RUN))
    u, y = long_u[: paper.N_SAMPLES], long_y[: paper.N_SAMPLES]
    comparison = experiments.compare(u, y, instances, seed, progress=say)
    page.comparison(sheet, comparison, y[paper.N_TRAINING :], instances, seed)

    say("convergence")
    page.convergence(sheet, y, experiments.converge(long_u, long_y, instances, seed))

    say("sensitivity")
    all_u, all_y = simulate(range(REALISATIONS), paper.N_SAMPLES)
    readings = experiments.readings(u, y, instances, seed)
    page.sensitivities(
        sheet,
        readings,
        experiments.input_variance(instances, seed),
        experiments.initial_gain(all_u, all_y, 10, seed),
        experiments.learning_constant(u, y, instances, seed),
        comparison.online.free_run_scores(y),
    )
    orders = experiments.orders(all_u, all_y, 10, seed)
    page.printed_constant(sheet, orders, readings, REALISATIONS)
    spread = experiments.spread(all_u, all_y, 5, seed)
    page.spread(sheet, spread, REALISATIONS)
    near, settings = BETTER_FIT
    u_near, y_near = (signal[0] for signal in simulate([near], paper.N_SAMPLES))
    better = experiments.compare(u_near, y_near, instances, near, settings=settings, progress=say)
    page.better_fit(sheet, better)

    say("cost")
    seconds = experiments.table_time(u, y, seed)
    page.costs(sheet, experiments.update_times(), seconds)

    say("the deployed identifier")
    page.deployed(sheet, *deployed.free_runs(range(REALISATIONS)), REALISATIONS)
    page.readaptation(sheet, deployed.readaptation(range(CHANGE_SEEDS)))
    return Replication(
        comparison=comparison,
        orders=orders,
        spread=spread,
        online_seconds=seconds,
        page=sheet.write(),
        figures=tuple(sheet.figures),
    )
