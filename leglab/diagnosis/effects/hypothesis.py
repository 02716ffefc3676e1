"""Hypotheses (effects that a machine may have, with their values), and the library of effects."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from leglab.diagnosis.effects.base import Effect, EffectParameter, all_effects
from leglab.diagnosis.plant.model import Change, Machine

# Number of bisections in the search for a bound, enough for the last bit of a double.
_HALVINGS = 60

# Name of an effect, and of the element of the machine that has it.
Key = tuple[str, str]


@dataclass(frozen=True, eq=False)
class Site:
    """An effect on one element of a machine, with its parameters on that element."""

    effect: Effect
    element: str
    parameters: tuple[EffectParameter, ...]
    #: Values of the specimen (calibrated machine), (parameters,); None for the model's values.
    own: np.ndarray | None = None

    @property
    def nominal(self) -> np.ndarray:
        """Values of the specimen if it has any, else of the model, (parameters,)."""
        return self.model if self.own is None else self.own.copy()

    @property
    def model(self) -> np.ndarray:
        """Values of the model, (parameters,)."""
        return np.array([p.nominal for p in self.parameters])

    def changes(self, values: np.ndarray) -> bool:
        """Tests whether the value of a strength parameter differs from the model's value."""
        each = zip(self.parameters, values.tolist(), strict=True)
        return any(p.role == "strength" and value != p.nominal for p, value in each)

    @property
    def lower(self) -> np.ndarray:
        """Lower bounds, (parameters,)."""
        return np.array([p.lower for p in self.parameters])

    @property
    def upper(self) -> np.ndarray:
        """Upper bounds, (parameters,)."""
        return np.array([p.upper for p in self.parameters])

    @property
    def slowest(self) -> float:
        """Longest delay or lag of all trials [s]; infinite if any is neither time nor frequency."""
        return max((p.slowest for p in self.parameters if p.trials), default=np.inf)

    @property
    def differences(self) -> np.ndarray:
        """Matrix that converts values to the differences of directions, (pairs, parameters)."""
        names = [p.name for p in self.parameters]
        pairs = self.effect.by_direction
        rows = [[(n == first) - (n == second) for n in names] for first, second in pairs]
        return np.array(rows, dtype=float).reshape(len(pairs), len(names))

    def named(self, values: np.ndarray) -> dict[str, float]:
        """Returns values, (parameters,), by the names of the parameters."""
        return {p.name: float(v) for p, v in zip(self.parameters, values, strict=True)}


class Hypothesis(Mapping[Key, np.ndarray]):
    """Values of effects by effect and element; every other effect is absent. Immutable.

    `onsets` holds the times [s] at which effects begin, (recordings,): -inf if an effect is present
    from the start, inf if it is never present. An effect without onsets is present throughout.
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
        """Returns the hypothesis with an effect's values replaced or added."""
        return Hypothesis({**self._values, key: values}, self.onsets)

    def with_onset(self, key: Key, onset: np.ndarray) -> "Hypothesis":
        """Returns the hypothesis with an effect's onsets, (recordings,)."""
        return Hypothesis(self._values, {**self.onsets, key: onset})

    def only(self, keys: Iterable[Key]) -> "Hypothesis":
        """Returns the hypothesis restricted to the given effects."""
        wanted = set(keys)
        return Hypothesis({k: v for k, v in self.items() if k in wanted}, self.onsets)

    def without(self, *keys: Key) -> "Hypothesis":
        """Returns the hypothesis without some effects."""
        return self.only(set(self._values) - set(keys))


def _taken(
    effect: Effect, machine: Machine, element: str, parameters: tuple[EffectParameter, ...]
) -> tuple[EffectParameter, ...]:
    """Restricts bounds and trials of parameters to values that the plugins accept.

    Bounds and trials scale with the machine's forces and may exceed the bounds of a plugin.
    """
    usual = {p.name: p.nominal for p in parameters}

    def takes(name: str, value: float) -> bool:
        change = Change(machine)
        effect.apply(change, element, {**usual, name: value})
        return not change.beyond

    def reached(p: EffectParameter, end: float) -> float:
        if end == p.nominal or takes(p.name, end) or not takes(p.name, p.nominal):
            return end
        inside, outside = p.nominal, end
        for _ in range(_HALVINGS):
            middle = 0.5 * (inside + outside)
            inside, outside = (middle, outside) if takes(p.name, middle) else (inside, middle)
        return inside

    def bounded(p: EffectParameter) -> EffectParameter:
        lower, upper = reached(p, p.lower), reached(p, p.upper)
        if (lower, upper) == (p.lower, p.upper):
            return p
        trials = tuple(t for t in p.trials if lower <= t <= upper)
        return replace(p, lower=lower, upper=upper, trials=trials)

    usual |= {p.name: p.trials[0] for p in parameters if p.trials and takes(p.name, p.trials[0])}
    return tuple(bounded(p) for p in parameters)


class Library:
    """Effects that a machine can have.

    Effects in `names`, or all for None, are searched for except those in `excluded`. `specimen`
    holds the values of the calibrated machine; effects without them have the model's values. Trials
    of delays and lags begin at `shortest`, the shortest time [s] that the recordings resolve.
    """

    def __init__(
        self,
        machine: Machine,
        *,
        names: Collection[str] | None = None,
        excluded: Collection[str] = (),
        specimen: Mapping[Key, np.ndarray] | None = None,
        shortest: float = 0.0,
    ) -> None:
        self._driven = machine.driven
        # Levers of cylinders on their joints [m, or 1 on a slide].
        self._levers = {
            cylinder: abs(machine.moment(cylinder, joint))
            for cylinder in machine.cylinders
            for joint in machine.driven[cylinder][:1]
        }
        self.specimen = dict(specimen or {})
        #: Effects to search for, effects of the specimen, and all effects that cannot be named.
        self.sites: dict[Key, Site] = {}
        searched: set[Key] = set()
        for effect in all_effects():
            wanted = names is None or effect.name in names
            used = wanted and effect.nameable and effect.name not in excluded
            for element in effect.elements(machine):
                key = effect.name, element
                if used:
                    searched.add(key)
                if used or key in self.specimen or not effect.nameable:
                    given = effect.parameters(machine, element)
                    parameters = _taken(
                        effect, machine, element, tuple(p.stretched(shortest) for p in given)
                    )
                    self.sites[key] = Site(effect, element, parameters, self.specimen.get(key))
        #: Effects that are not searched for because all their delays or lags are below `shortest`.
        self.too_fast = frozenset(k for k in searched if self.sites[k].slowest < shortest)
        self.searched = frozenset(searched) - self.too_fast  #: effects to search for

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects to search for."""
        return tuple(sorted({name for name, _ in self.searched}))

    def contains(self, larger: Key, simpler: Key) -> bool:
        """Tests whether `simpler` is a special case of `larger` at the same joint."""
        joints = {self._driven.get(element, (element,))[0] for _, element in (larger, simpler)}
        known = larger in self.sites and simpler[0] in self.sites[larger].effect.contains
        return known and len(joints) == 1

    def as_simpler(self, larger: tuple[Key, int], simpler: tuple[Key, int]) -> float:
        """Returns the factor that converts a parameter to a parameter of a simpler effect.

        Arguments are effect and parameter number; the factor is 0 if the units differ in kind.
        Between joint and cylinder, forces scale with the lever, damping with the lever squared.
        """
        if not self.contains(larger[0], simpler[0]) or larger[0] == simpler[0]:
            return 0.0
        units = [self.sites[key].parameters[i].unit for key, i in (larger, simpler)]
        first, second = (unit.replace("N m", "N").replace("rad", "m") for unit in units)
        if first != second:
            return 0.0
        lever = self._levers.get(simpler[0][1], 1.0) / self._levers.get(larger[0][1], 1.0)
        return float(lever ** -(2.0 if "s/" in first else 1.0))

    def with_sites(self, sites: Mapping[Key, Site]) -> "Library":
        """Returns the library with other parameters and other values of the specimen."""
        other = copy(self)
        other.sites = dict(sites)
        other.specimen = {key: site.own for key, site in sites.items() if site.own is not None}
        return other

    def neutral(self) -> Hypothesis:
        """Returns the hypothesis that the machine equals its model, whatever the specimen."""
        return Hypothesis({key: self.sites[key].model for key in self.specimen})

    def whole(self, hypothesis: Mapping[Key, np.ndarray]) -> dict[Key, np.ndarray]:
        """Returns the values of a hypothesis, and the specimen's values of all other effects."""
        return {**self.specimen, **hypothesis}

    def change(
        self, hypothesis: Mapping[Key, np.ndarray], machine: Machine, *, written: bool = False
    ) -> Change:
        """Converts a hypothesis to a change of a machine, or of its model file if `written`.

        Effects are applied by their attribute `order`, then by name.
        """
        change = Change(machine)
        whole = self.whole(hypothesis)
        for key in sorted(whole, key=lambda k: (self.sites[k].effect.order, k)):
            site = self.sites[key]
            if not site.changes(whole[key]):
                continue
            act = site.effect.write if written else site.effect.apply
            act(change, site.element, site.named(whole[key]))
        return change
