"""Unknowns of a diagnosis: all parameters of all effects, and parameters that elements share."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from leglab.diagnosis.effects.base import Effect
from leglab.diagnosis.effects.hypothesis import Hypothesis, Key, Library
from leglab.diagnosis.thresholds import FINE

# A parameter of the library: key (effect, element), and index among the effect's parameters.
Place = tuple[Key, int]
# Element in the key of an effect that all like elements share.
EVERY = "every"


@dataclass(frozen=True, kw_only=True, eq=False)
class Unknowns:
    """Departures from the specimen (the machine as identified), in smallest trials, (unknowns,).

    "Single" unknowns come first, each for one parameter of one element. A "tied" unknown moves one
    parameter of all like elements by the same number of trials, as a bus delays all commands. A
    parameter's departure is the sum of its single and its tied unknown.
    """

    library: Library  #: Effects whose parameters are the unknowns
    places: tuple[tuple[Place, ...], ...]  #: Parameters that each unknown moves
    keys: tuple[Key, ...]  #: Effect and element; the element of a tied unknown is `EVERY`
    scale: np.ndarray  #: Smallest trial in units of `from_nominal`; 1 for tied unknowns
    #: Standard deviation between good machines, in smallest trials; 0 if unknown.
    tolerance: np.ndarray
    lower: np.ndarray  #: Least allowed departure, in smallest trials
    upper: np.ndarray  #: Largest allowed departure, in smallest trials
    shape: np.ndarray  #: Whether it is a shape parameter: no influence while strengths are nominal
    nameable: np.ndarray  #: Whether a departure can be named as a fault
    gradual: np.ndarray  #: Whether a good machine may have a small amount of the effect
    above: np.ndarray  #: Whether faults lie above the parameter's nominal value
    below: np.ndarray  #: Whether faults lie below the parameter's nominal value
    limits: np.ndarray  #: Whether it is a limit of a command or force

    @classmethod
    def of(cls, library: Library) -> "Unknowns":
        """Builds all unknowns of a library."""
        rows: list[dict] = []
        for key, site in sorted(library.sites.items()):
            can_be = site.effect.nameable and key in library.searched
            for i, (p, own) in enumerate(zip(site.parameters, site.nominal, strict=True)):
                down, up = (p.from_nominal(end, own) / p.scale for end in (p.lower, p.upper))
                rows.append(
                    {
                        "places": ((key, i),),
                        "keys": key,
                        "scale": p.scale,
                        "tolerance": p.tolerance / p.step(own),
                        "lower": down,
                        "upper": up,
                        "shape": p.role == "shape",
                        "nameable": can_be and p.role == "strength",
                        "gradual": site.effect.gradual,
                        "above": p.faults != "below" and up > 0.0,
                        "below": p.faults != "above" and down < 0.0,
                        "limits": bool(p.limit_of),
                    }
                )
        rows += _tied(library, rows)
        places, keys = (tuple(row.pop(name) for row in rows) for name in ("places", "keys"))
        columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        return cls(library=library, places=places, keys=keys, **columns)

    def __len__(self) -> int:
        return len(self.keys)

    @cached_property
    def single(self) -> int:
        """Number of single unknowns, which come first."""
        return sum(key[1] != EVERY for key in self.keys)

    @cached_property
    def sites(self) -> int:
        """Number of effects, each on one element or on all like elements, that can be faults."""
        return len({key for key, can_be in zip(self.keys, self.nameable, strict=True) if can_be})

    @cached_property
    def _index(self) -> dict[Place, int]:
        return {places[0]: i for i, places in enumerate(self.places[: self.single])}

    def singles(self, unknown: int) -> tuple[int, ...]:
        """Returns the single unknowns that an unknown moves."""
        return tuple(self._index[place] for place in self.places[unknown])

    def names(self, unknowns: Iterable[int]) -> frozenset[Key]:
        """Returns the keys (effect, element) of some unknowns."""
        return frozenset(self.keys[q] for q in unknowns)

    def effect(self, unknown: int) -> Effect:
        """Returns the effect of an unknown, for a tied unknown the effect on its first element."""
        return self.library.sites[self.places[unknown][0][0]].effect

    def library_keys(self, unknown: int) -> frozenset[Key]:
        """Returns effect and element of each parameter that an unknown moves."""
        return frozenset(key for key, _ in self.places[unknown])

    def name(self, unknown: int) -> str:
        """Returns the name of the parameter that an unknown moves."""
        key, i = self.places[unknown][0]
        return self.library.sites[key].parameters[i].name

    def departures(self, hypothesis: Mapping[Key, np.ndarray]) -> np.ndarray:
        """Computes the departures of a hypothesis, (unknowns,); tied unknowns have 0."""
        x = np.zeros(len(self))
        for u in range(self.single):
            ((key, i),) = self.places[u]
            if key in hypothesis:
                site = self.library.sites[key]
                away = site.parameters[i].from_nominal(hypothesis[key][i], site.nominal[i])
                x[u] = away / self.scale[u]
        return x

    def moved(self, hypothesis: Hypothesis, by: Mapping[int, float]) -> Hypothesis:
        """Returns the hypothesis with unknowns moved by departures, within the parameters' bounds.

        An effect that is not `gradual` is present or absent. A step along all unknowns may leave a
        tiny strength of it, so a strength below half of the smallest tangent step becomes nominal.
        """
        new: dict[Key, np.ndarray] = {}
        for u, departure in by.items():
            for key, i in self.places[u]:
                site = self.library.sites[key]
                values = new.setdefault(key, hypothesis.get(key, site.nominal).copy())
                values[i] = site.parameters[i].moved(values[i], departure)
        for key, values in new.items():
            site = self.library.sites[key]
            if not site.effect.gradual:
                for i, p in enumerate(site.parameters):
                    least = 0.5 * FINE[0] * p.scale
                    if p.role == "strength" and abs(values[i] - site.nominal[i]) < least:
                        values[i] = site.nominal[i]
            hypothesis = hypothesis.with_values(key, np.clip(values, site.lower, site.upper))
        return hypothesis


def _tied(library: Library, rows: list[dict]) -> list[dict]:
    """Builds rows of attributes of tied unknowns, each shared by at least three like elements.

    For two elements a tied unknown would save little over two single unknowns, so none is made.
    """
    groups: dict[tuple[str, str, str, int], list[dict]] = {}
    for row in rows:
        ((key, i),) = row["places"]
        if row["nameable"]:
            site = library.sites[key]
            p = site.parameters[i]
            groups.setdefault((type(site.effect).__qualname__, p.name, p.unit, i), []).append(row)
    found = []
    for parts in groups.values():
        if len(parts) < 3:
            continue
        found.append(
            {
                **parts[0],
                "places": tuple(place for row in parts for place in row["places"]),
                "keys": (parts[0]["keys"][0], EVERY),
                "scale": 1.0,
                "tolerance": 0.0,
                "lower": max(row["lower"] for row in parts),
                "upper": min(row["upper"] for row in parts),
                "above": all(row["above"] for row in parts),
                "below": all(row["below"] for row in parts),
            }
        )
    return found
