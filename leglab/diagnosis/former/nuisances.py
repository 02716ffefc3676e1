"""Parameters that differ between machines without a fault, and follow every fit under a prior."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leglab.diagnosis.effects.hypothesis import Key, Library, Site

# Groups of effects on the way of commands and measurements.
_PATHS = frozenset({"valve and command", "sensing"})


@dataclass(frozen=True, kw_only=True)
class Nuisance:
    """One parameter that differs between good machines.

    Attributes:
        key: Effect and element it belongs to.
        index: Its place among the effect's parameters.
        nominal: Expected value.
        tolerance: Prior standard deviation.
    """

    key: Key
    index: int
    nominal: float
    tolerance: float

    def value(self, hypothesis: Mapping[Key, np.ndarray]) -> float:
        """Its value under a hypothesis."""
        return hypothesis[self.key][self.index] if self.key in hypothesis else self.nominal


def departures(hypothesis: Mapping[Key, np.ndarray], nuisances: Sequence[Nuisance]) -> np.ndarray:
    """Departures of nuisances from their expected values, in tolerances, (nuisances,)."""
    return np.array([(n.value(hypothesis) - n.nominal) / n.tolerance for n in nuisances])


def within_tolerance(library: Library, share: float = 1.0) -> tuple[Nuisance, ...]:
    """Parameters that differ between good machines, by a share of their tolerances."""
    return tuple(
        Nuisance(key=key, index=i, nominal=float(nominal), tolerance=share * p.tolerance)
        for key, site in library.sites.items()
        for i, (p, nominal) in enumerate(zip(site.parameters, site.nominal, strict=True))
        if p.tolerance > 0.0
    )


def rough_nuisances(
    library: Library, share: float, imperfect: float, tolerances: float
) -> tuple[Nuisance, ...]:
    """Parameters that differ on a rough machine of which nothing is known.

    Beside tolerances, what every real command path and sensor has a little of: delay, hysteresis,
    offset. Any strength of the mechanism would be wider than some of its faults. Shapes of laws in
    which good machines differ, which no diagnosis names, follow within all that is barely
    noticeable.

    Args:
        library: Effects.
        share: Standard deviation as a share of what is barely noticeable.
        imperfect: The same of what the model lacks altogether and can only be added.
        tolerances: That of parameters that have a tolerance, in tolerances.
    """
    found = list(within_tolerance(library, tolerances))
    for key, site in library.sites.items():
        if not site.effect.nameable:
            found += _strengths(key, site, 1.0, 0.0)
        elif site.effect.group in _PATHS and site.effect.gradual:
            perfect = any(
                p.role == "strength" and p.lower == nominal
                for p, nominal in zip(site.parameters, site.nominal, strict=True)
            )
            found += _strengths(key, site, imperfect if perfect else share, 0.0)
    unique = {(n.key, n.index): n for n in reversed(found)}  # a tolerance comes first
    return tuple(sorted(unique.values(), key=lambda n: (n.key, n.index)))


def all_strengths(library: Library, share: float, tolerances: float) -> tuple[Nuisance, ...]:
    """All strengths, within a share of what is barely noticeable.

    All of it is what a healthy specimen may have.

    Args:
        library: Effects.
        share: Standard deviation as a share of what is barely noticeable.
        tolerances: The least standard deviation of those that have a tolerance, in tolerances.
    """
    return tuple(
        nuisance
        for key, site in library.sites.items()
        if site.effect.gradual
        for nuisance in _strengths(key, site, share, tolerances)
    )


def _strengths(key: Key, site: Site, share: float, tolerances: float) -> list[Nuisance]:
    return [
        Nuisance(
            key=key,
            index=i,
            nominal=float(nominal),
            tolerance=max(tolerances * p.tolerance, share * p.scale),
        )
        for i, (p, nominal) in enumerate(zip(site.parameters, site.nominal, strict=True))
        if p.role == "strength"
    ]
