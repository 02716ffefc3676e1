"""Effects: physical causes with parameters that change a simulation, and their registry."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from leglab.base import plugins
from leglab.base.errors import SettingsError
from leglab.diagnosis.plant.model import Change, ForceLeft, Machine

Side = Literal["above", "below", "either"]
Group = Literal["oil and seals", "valve and command", "friction", "mechanics", "sensing"]
# Values of an effect's parameters by name.
Values = Mapping[str, float]


@dataclass(frozen=True)
class EffectParameter:
    """One physical parameter of an effect on one element.

    Attributes:
        name: As the report prints it.
        unit: SI unit of all values.
        nominal: Value at which the effect changes nothing, or, of a shape, where fits start.
        lower: Smallest value that makes sense.
        upper: Largest value that makes sense.
        trials: Values to screen, a few from barely noticeable to severe on each possible side;
            those of a shape are not tried, they say by what steps it matters.
        tolerance: Standard deviation between good machines. Above zero the baseline refits the
            parameter under this prior, and only a change beyond it is named.
        role: A "strength" at its nominal value switches the effect off; a "shape" means nothing
            while all strengths are nominal.
        faults: On which side of the nominal value they lie; the other is a better part's.
        limit_of: Of a limit, of the "command" or "force": its nominal value is the largest that the
            recordings show, and trials are shares of that; "" of what is none.
        inverse: Whether motion departs in proportion to 1/value: a bandwidth acts by its lag, a
            stiffness by how far it gives way.
    """

    name: str
    unit: str
    _: KW_ONLY
    nominal: float = 0.0
    lower: float = 0.0
    upper: float
    trials: tuple[float, ...] = ()
    tolerance: float = 0.0
    role: Literal["strength", "shape"] = "strength"
    faults: Side = "either"
    inverse: bool = False
    limit_of: Literal["", "command", "force"] = ""

    def __post_init__(self) -> None:
        if not self.lower <= self.nominal <= self.upper:
            raise SettingsError(
                f"effect parameter {self.name!r}: nominal {self.nominal:g} lies outside ",
                given=self.nominal,
                allowed=f"[{self.lower:g}, {self.upper:g}] {self.unit}",
            )

    @classmethod
    def shape(
        cls, name: str, unit: str, nominal: float, lower: float, upper: float
    ) -> "EffectParameter":
        """A shape, of which no values are tried."""
        return cls(name, unit, nominal=nominal, lower=lower, upper=upper, role="shape")

    @property
    def scale(self) -> float:
        """Smallest trial, by which differences and fits step; in 1/unit of an inverse."""
        steps = [abs(self.from_nominal(t)) for t in self.trials if t != self.nominal]
        return min(steps) if steps else 0.1 * (self.upper - self.lower)

    def from_nominal(self, value: float, nominal: float | None = None) -> float:
        """How far a value stands above the nominal one, in what acts in proportion."""
        own = self.nominal if nominal is None else nominal
        return 1.0 / own - 1.0 / value if self.inverse else value - own

    def moved(self, value: float, by: float) -> float:
        """A value moved up by so many smallest trials."""
        if not self.inverse:
            return value + by * self.scale
        return 1.0 / min(max(1.0 / value - by * self.scale, 1.0 / self.upper), 1.0 / self.lower)

    def step(self, value: float) -> float:
        """Change of the value by one smallest trial, at a value."""
        return self.scale * value**2 if self.inverse else self.scale

    def usual(self, own: float) -> tuple[float, float]:
        """Ends of the values of 19 of 20 good machines whose model has `own`."""
        return own - 1.96 * self.tolerance, own + 1.96 * self.tolerance

    @property
    def slowest(self) -> float:
        """Longest delay or lag among the trials [s]; infinite for what is no time."""
        if self.unit == "Hz":
            return float(1.0 / (2.0 * np.pi * min(self.trials)))
        return max(self.trials) if self.unit == "s" else np.inf

    def stretched(self, shortest: float) -> "EffectParameter":
        """The same; trials and upper bound of a time are longer where some are below a time [s]."""
        if self.unit != "s" or not self.trials or self.scale >= shortest:
            return self
        factor = shortest / self.scale
        trials = tuple(factor * trial for trial in self.trials)
        return replace(self, upper=factor * self.upper, trials=trials)

    def departure(self, value: float, nominal: float) -> float:
        """How severe a value is, in smallest trials from `nominal`."""
        return abs(self.from_nominal(value, nominal)) / self.scale


class Effect(ABC):
    """A physical cause that a simulation may lack.

    Subclasses keep no state. Those with a table of parameters start from `TableEffect`.

    Attributes:
        name: As reports print it; variants (on a cylinder, on a plain joint) may share it, as long
            as no element of a machine is served by two of them.
        group: Heading under which it is listed.
        physics: One sentence: what happens, with the equation.
        source: Where equation and bounds come from.
        excitation: Motion that a recording must contain to show it.
        order: Effects are applied by rising order, then by name.
        gradual: Whether a little of it changes little; not so where it inserts a moving part.
        nameable: Whether a diagnosis looks for it. What is not, the shape of a law in which good
            machines differ, is fitted on machines that differ from their model everywhere.
        on_bodies: Whether its elements are bodies: their names may be those of joints.
        contains: Simpler effects that are special cases of it: named instead of it where one at
            the same joint does as well.
        by_direction: Pairs of parameters, one a direction. On a machine whose laws are not the
            model's it is named only where they depart differently.
    """

    name: ClassVar[str]
    group: ClassVar[Group]
    physics: ClassVar[str]
    source: ClassVar[str]
    excitation: ClassVar[str]
    order: ClassVar[int] = 0
    gradual: ClassVar[bool] = True
    nameable: ClassVar[bool] = True
    on_bodies: ClassVar[bool] = False
    contains: ClassVar[tuple[str, ...]] = ()
    by_direction: ClassVar[tuple[tuple[str, str], ...]] = ()

    @abstractmethod
    def elements(self, machine: Machine) -> tuple[str, ...]:
        """Names of the joints, actuators, bodies or plugin instances it can sit on."""

    @abstractmethod
    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """Its parameters on an element, strengths first."""

    @abstractmethod
    def apply(self, change: Change, element: str, values: Values) -> None:
        """Records in `change` what these values do; nominal values must change nothing."""

    def guess(self, left: ForceLeft) -> Values | None:
        """Where to fit shapes from that few trials can find, by the force left on the joint."""
        return None

    def write(self, change: Change, element: str, values: Values) -> None:
        """Records the edits and parameters by which an improved model has these values.

        Other than those of `apply` for command and sensor paths, which no replay needs, and where
        MJCF has an attribute that does nearly the same.
        """
        self.apply(change, element, values)


# A parameter of an effect, of machine and element.
Row = Callable[[Machine, str], EffectParameter]


class TableEffect(Effect):
    """Base of effects with a table of parameters."""

    #: Each the same on every element, or a function of machine and element.
    rows: ClassVar[tuple[EffectParameter | Row, ...]] = ()

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """The rows on an element."""
        return tuple(row(machine, element) if callable(row) else row for row in self.rows)


_REGISTRY: dict[tuple[str, str], Effect] = {}
_plugins_loaded = False


def register_effect(effect: type[Effect]) -> type[Effect]:
    """Adds an effect to those that the diagnosis can name; a class decorator.

    Raises:
        LeglabError: A class attribute is missing.
    """
    for attribute in ("name", "group", "physics", "source", "excitation"):
        if not getattr(effect, attribute, ""):
            told = f"effect class {effect.__qualname__} has no {attribute!r}"
            raise SettingsError(told, given=effect.__qualname__)
    plugins.note(effect.__module__)
    _REGISTRY[effect.name, effect.__qualname__] = effect()
    return effect


def all_effects() -> tuple[Effect, ...]:
    """All effects, ordered by name."""
    global _plugins_loaded
    if not _plugins_loaded:
        _plugins_loaded = True
        plugins.load_entry_points("effects", lambda name: any(n == name for n, _ in _REGISTRY))
    return tuple(effect for _, effect in sorted(_REGISTRY.items()))
