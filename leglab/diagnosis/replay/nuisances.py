"""Parameters that differ between machines without a fault, and follow every fit under a prior."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leglab.diagnosis.effects.hypothesis import Key, Library


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
