"""One blind case: made from its number, diagnosed, scored."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leglab.base.recording import Recording
from leglab.studies.blind.bench import bench
from leglab.studies.blind.faults import FAULTS, SUDDEN, Severity, detuned
from leglab.studies.blind.plant import Plant
from leglab.studies.blind.references import references


@dataclass(frozen=True, kw_only=True)
class Case:
    """What is hidden.

    Attributes:
        kind: "single", "null", "pair", "removed" or "onset".
        number: Of the case among its kind; with the seed it fixes every random choice.
        effects: Hidden effects.
        onset: s; 0 where they are there throughout.
    """

    kind: str
    number: int
    effects: tuple[str, ...]
    onset: float = 0.0


def cases(counts: Mapping[str, int], seed: int, names: Sequence[str]) -> list[Case]:
    """The cases of a self-test: single ones cycle through all effects.

    Args:
        counts: Number of cases by kind.
        seed: Of the pairs and the removed effects.
        names: Effects that may be hidden.
    """
    found = []
    for kind, count in counts.items():
        for number in range(count):
            rng = np.random.default_rng([seed, _KINDS[kind], number])
            if kind == "null":
                effects: tuple[str, ...] = ()
            elif kind == "single":
                effects = (names[number % len(names)],)
            elif kind == "pair":
                effects = tuple(rng.choice(names, 2, replace=False).tolist())
            else:
                choice = [n for n in names if n in SUDDEN] if kind == "onset" else list(names)
                effects = (choice[int(rng.integers(len(choice)))],)
            onset = 6.0 if kind == "onset" else 0.0
            found.append(Case(kind=kind, number=number, effects=effects, onset=onset))
    return found


_KINDS = {"single": 1, "null": 2, "pair": 3, "removed": 4, "onset": 5}


def make(case: Case, seed: int) -> tuple[dict[str, Recording], tuple[Severity, ...]]:
    """Recordings of a case, and the severities that were drawn."""
    rng = np.random.default_rng([seed, _KINDS[case.kind], case.number, 1])
    plant = Plant(model=bench(), onset=case.onset)
    detuned(plant, rng)
    severities = tuple(FAULTS[name](plant, rng) for name in case.effects)
    return (
        {name: plant.record(values, rng) for name, values in references(rng).items()},
        severities,
    )
