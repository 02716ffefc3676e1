"""Random episodes of an environment: seed, scenario, severity and time of a change, specimen."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from leglab.base.errors import SettingsError
from leglab.base.scenario import SCENARIOS, Scenario
from leglab.runs.preparation import RunSettings, scenario_of

RANDOM = ("seed", "scenario", "severity", "onset", "ramp_duration", "tolerance")
_SEEDS = 2**31 - 1

# Function of a random generator that returns drawn values by name, with names from `RANDOM`.
Draw = Callable[[np.random.RandomState], Mapping[str, Any]]


@dataclass(frozen=True, kw_only=True)
class Episode:
    """One episode: a run, optionally with another onset of its changes."""

    #: Settings of the run; if `onset` is None, `leglab.runs.run.run_scenario` repeats the episode.
    settings: RunSettings
    #: Time at which the first change begins [s]; None for the scenario's own time.
    onset: float | None = None
    #: Whether the scenario was drawn; a drawn scenario without changes ignores `onset`.
    drawn: bool = False

    def scenario(self) -> Scenario:
        """Builds the scenario, with all changes shifted so that the first begins at `onset`.

        Raises:
            SettingsError: An option is not allowed or a change ends after the episode.
        """
        scenario = scenario_of(self.settings)
        if self.onset is None:
            return scenario
        if not scenario.changes:
            if self.drawn:
                return scenario
            text = f"scenario {scenario.name!r} changes nothing, so it has no onset"
            raise SettingsError(text, given=scenario.name)
        if not (self.onset >= 0 and math.isfinite(self.onset)):
            text = f"onset {self.onset!r} s is not allowed, must be "
            raise SettingsError(text, given=self.onset, allowed=">= 0")
        first = min(change.start for change in scenario.changes)
        changes = tuple(replace(c, start=self.onset + (c.start - first)) for c in scenario.changes)
        return replace(scenario, changes=changes)


class Episodes:
    """Source of random episodes.

    Args:
        base: The episode to vary.
        randomize: None: every episode equals `base`. A mapping of names in `RANDOM`: to ranges
            (low, high), from which values are drawn uniformly; for "scenario" to scenario names, of
            which one is drawn. A function of a `numpy.random.RandomState` that returns values by
            name. With a mapping or function each episode has a new seed unless it has "seed".

    Attributes:
        base: The episode that is varied.
        random: Random generator of the draws; `reseed` replaces it.

    Raises:
        SettingsError: A name or a range is not allowed.
    """

    def __init__(self, base: Episode, randomize: Mapping[str, Any] | Draw | None) -> None:
        self.base = base
        self._draw: Draw | None
        if randomize is None or callable(randomize):
            self._draw = randomize
        else:
            draws = {name: _checked(name, value) for name, value in randomize.items()}
            if "severity" in draws and "scenario" in draws:
                raise SettingsError(
                    "randomize draws severity and scenario, whose severities have different "
                    "units: give a function that returns both"
                )
            self._draw = lambda random: {name: draw(random) for name, draw in draws.items()}
            for name, value in randomize.items():
                self._try_ends(name, value)
        self.random = np.random.RandomState(base.settings.seed)

    def _try_ends(self, name: str, value: Any) -> None:
        """Tries the ends of a range, so that errors are raised now and not in a later episode."""
        for end in (value,) if isinstance(value, str) else value:
            drawn: dict[str, Any] = {name: int(end) if name == "seed" else end}
            try:
                if name == "onset":
                    replace(self.base, onset=float(end)).scenario()
                else:
                    replace(self.base, settings=replace(self.base.settings, **drawn)).scenario()
            except SettingsError as error:
                raise error.at(f"randomize {name!r}") from None

    def reseed(self, seed: int) -> None:
        """Restarts the sequence of episodes from another seed."""
        self.base = replace(self.base, settings=replace(self.base.settings, seed=seed))
        self.random = np.random.RandomState(seed)

    def next(self) -> Episode:
        """Draws the next episode.

        Raises:
            SettingsError: The function `randomize` returned a name that is not allowed.
        """
        if self._draw is None:
            return self.base
        drawn = {"seed": self.random.randint(_SEEDS), **self._draw(self.random)}
        for name in drawn:
            if name not in RANDOM:
                raise SettingsError.unknown("random quantity of an episode", name, RANDOM)
        onset = drawn.pop("onset", self.base.onset)
        drawn["seed"] = int(drawn["seed"])
        settings = replace(self.base.settings, **drawn)
        return Episode(settings=settings, onset=onset, drawn="scenario" in drawn)


def _checked(name: str, value: Any) -> Callable[[np.random.RandomState], Any]:
    """Checks the range of a quantity; returns a function that draws it."""
    if name not in RANDOM:
        raise SettingsError.unknown("random quantity of an episode", name, RANDOM)
    if name == "scenario":
        names = (value,) if isinstance(value, str) else tuple(value)
        for each in names:
            SCENARIOS.get(each)
        if not names:
            raise SettingsError("randomize 'scenario': no name to draw from")
        return lambda random: names[random.randint(len(names))]
    try:
        low, high = (float(end) for end in value)
        if not -math.inf < low <= high < math.inf:
            raise ValueError
    except (TypeError, ValueError):
        text = f"randomize {name!r}: {value!r} is no "
        raise SettingsError(text, given=value, allowed="range (low, high)") from None
    return lambda random: random.uniform(low, high)
