"""What differs from one episode to the next: seed, severity, onset and ramp of the change."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from leglab.base.errors import LeglabError, unknown_name
from leglab.base.scenario import Scenario
from leglab.runs.preparation import RunSettings, scenario_of

RANDOM = ("seed", "severity", "onset", "ramp_duration")
_SEEDS = 2**31 - 1

# Draws values by the names in `RANDOM`.
Draw = Callable[[np.random.RandomState], Mapping[str, Any]]


@dataclass(frozen=True, kw_only=True)
class Episode:
    """One episode.

    Attributes:
        settings: Of the run; `leglab.runs.run.run_scenario` repeats it where `onset` is None.
        onset: When the first change begins [s]; None for the scenario's own time.
    """

    settings: RunSettings
    onset: float | None = None

    def scenario(self) -> Scenario:
        """Builds the scenario, all its changes shifted together to the onset.

        Raises:
            LeglabError: If an option is not allowed or a change ends after the episode.
        """
        scenario = scenario_of(self.settings)
        if self.onset is None:
            return scenario
        if not scenario.changes:
            raise LeglabError(f"scenario {scenario.name!r} changes nothing, so it has no onset")
        if not (self.onset >= 0 and math.isfinite(self.onset)):
            raise LeglabError(f"onset {self.onset!r} s is not allowed, must be >= 0")
        first = min(change.start for change in scenario.changes)
        changes = tuple(replace(c, start=self.onset + (c.start - first)) for c in scenario.changes)
        return replace(scenario, changes=changes)


class Episodes:
    """Draws episodes.

    Args:
        base: The episode to vary.
        randomize: None: every episode is the base. A mapping of names in `RANDOM` to ranges
            (low, high), from which values are drawn uniformly, or a callable that is given a
            `numpy.random.RandomState` and returns values by name. Each episode then has a new
            seed too, unless one is given.

    Attributes:
        random: Source of the draws; `reseed` replaces it.

    Raises:
        LeglabError: If a name or a range is not allowed.
    """

    def __init__(
        self, base: Episode, randomize: Mapping[str, tuple[float, float]] | Draw | None
    ) -> None:
        self._base = base
        self._draw: Draw | None
        if randomize is None or callable(randomize):
            self._draw = randomize
        else:
            ranges = {name: _checked_range(name, value) for name, value in randomize.items()}
            self._draw = lambda random: {n: random.uniform(*r) for n, r in ranges.items()}
        self.random = np.random.RandomState(base.settings.seed)

    def reseed(self, seed: int) -> None:
        """Starts the sequence of episodes of another seed."""
        self._base = replace(self._base, settings=replace(self._base.settings, seed=seed))
        self.random = np.random.RandomState(seed)

    def next(self) -> Episode:
        """Draws the next episode.

        Raises:
            LeglabError: If the callable gives a name that is not allowed.
        """
        if self._draw is None:
            return self._base
        drawn = {"seed": self.random.randint(_SEEDS), **self._draw(self.random)}
        for name in drawn:
            if name not in RANDOM:
                raise unknown_name("random quantity of an episode", name, RANDOM)
        onset = drawn.pop("onset", self._base.onset)
        drawn["seed"] = int(drawn["seed"])
        settings = replace(self._base.settings, **drawn)
        return Episode(settings=settings, onset=onset)


def _checked_range(name: str, value: Any) -> tuple[float, float]:
    if name not in RANDOM:
        raise unknown_name("random quantity of an episode", name, RANDOM)
    try:
        low, high = (float(end) for end in value)
        if not -math.inf < low <= high < math.inf:
            raise ValueError
    except (TypeError, ValueError):
        raise LeglabError(f"randomize {name!r}: {value!r} is no range (low, high)") from None
    return low, high
