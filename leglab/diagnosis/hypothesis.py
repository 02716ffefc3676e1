"""Hypotheses: which effects are there, with which values."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from leglab.diagnosis.effects.base import Effect, EffectParameter, all_effects
from leglab.diagnosis.model import Change, Machine

# Effect and element.
Key = tuple[str, str]


@dataclass(frozen=True, kw_only=True, eq=False)
class Site:
    """An effect on one element of a machine, with its parameters there."""

    effect: Effect
    element: str
    parameters: tuple[EffectParameter, ...]

    @property
    def key(self) -> Key:
        """Name of the effect and element."""
        return self.effect.name, self.element

    @property
    def nominal(self) -> np.ndarray:
        """Values that change nothing, (parameters,)."""
        return np.array([p.nominal for p in self.parameters])

    @property
    def lower(self) -> np.ndarray:
        """Bounds, (parameters,)."""
        return np.array([p.lower for p in self.parameters])

    @property
    def upper(self) -> np.ndarray:
        """Bounds, (parameters,)."""
        return np.array([p.upper for p in self.parameters])

    def named(self, values: np.ndarray) -> dict[str, float]:
        """Values, shape (parameters,), by the names of the parameters."""
        return {p.name: float(v) for p, v in zip(self.parameters, values, strict=True)}

    def trials(self) -> list[np.ndarray]:
        """Values to screen, each (parameters,): one strength off its nominal value."""
        found = []
        for i, parameter in enumerate(self.parameters):
            for trial in parameter.trials if parameter.role == "strength" else ():
                values = self.nominal
                values[i] = np.clip(trial, parameter.lower, parameter.upper)
                if values[i] != parameter.nominal:
                    found.append(values)
        return found


class Hypothesis(Mapping[Key, np.ndarray]):
    """Values of effects by effect and element; every other effect is absent. Immutable.

    Attributes:
        onsets: Time [s] in every recording at which an effect begins, shape (recordings,), by
            effect; -inf where it is there from the start, inf where it never is. Effects without
            an entry are there throughout.
    """

    def __init__(
        self,
        values: Mapping[Key, np.ndarray] | None = None,
        onsets: Mapping[Key, np.ndarray] | None = None,
    ) -> None:
        self._values = {key: np.array(v, dtype=float) for key, v in (values or {}).items()}
        self.onsets = {k: v for k, v in (onsets or {}).items() if k in self._values}

    def __getitem__(self, key: Key) -> np.ndarray:
        return self._values[key]

    def __iter__(self) -> Iterator[Key]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def with_values(self, key: Key, values: np.ndarray) -> "Hypothesis":
        """The same with an effect set."""
        return Hypothesis({**self._values, key: values}, self.onsets)

    def with_onset(self, key: Key, onset: np.ndarray | None) -> "Hypothesis":
        """The same with an effect that begins at times, or throughout for None."""
        others = {k: v for k, v in self.onsets.items() if k != key}
        return Hypothesis(self._values, others if onset is None else {**others, key: onset})

    def only(self, keys: Iterable[Key]) -> "Hypothesis":
        """The same with nothing but some effects."""
        wanted = set(keys)
        return Hypothesis({k: v for k, v in self._values.items() if k in wanted}, self.onsets)

    def without(self, *keys: Key) -> "Hypothesis":
        """The same with effects absent."""
        return self.only(set(self._values) - set(keys))


class Library:
    """The effects that can sit on a machine.

    Args:
        machine: The unmodified machine.
        names: Effects to use; None for all.
        excluded: Effects to leave out.

    Attributes:
        sites: By effect and element.
    """

    def __init__(
        self, machine: Machine, *, names: Iterable[str] | None = None, excluded: Iterable[str] = ()
    ) -> None:
        wanted = None if names is None else set(names)
        barred = set(excluded)
        self._driven = machine.driven
        self.sites: dict[Key, Site] = {}
        for effect in all_effects():
            if effect.name in barred or (wanted is not None and effect.name not in wanted):
                continue
            for element in effect.elements(machine):
                own = effect.parameters(machine, element)
                site = Site(effect=effect, element=element, parameters=own)
                self.sites[site.key] = site

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(sorted({name for name, _ in self.sites}))

    def contains(self, larger: Key, simpler: Key) -> bool:
        """Whether an effect has another, at the same joint, as a special case."""
        (_, one), (name, other) = larger, simpler
        joints = (self._driven.get(element, (element,)) for element in (one, other))
        return name in self.sites[larger].effect.contains and len({j[0] for j in joints}) == 1

    def change(self, hypothesis: Mapping[Key, np.ndarray], machine: Machine) -> Change:
        """The change that a hypothesis makes; effects apply by their order, then by name."""
        change = Change(machine)
        for key in sorted(hypothesis, key=lambda k: (self.sites[k].effect.order, k)):
            site = self.sites[key]
            site.effect.apply(change, site.element, site.named(hypothesis[key]))
        return change
