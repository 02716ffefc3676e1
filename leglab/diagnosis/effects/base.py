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
        name: Name in reports.
        unit: SI unit of all values.
        nominal: Value at which the effect changes nothing; of a shape parameter, the start value.
        lower: Smallest value that makes sense.
        upper: Largest value that makes sense.
        trials: Values to try on each possible side, from barely noticeable to severe. Trials of a
            shape parameter are not tried; they only determine its smallest significant step.
        tolerance: Standard deviation between good machines. If positive, recalibration fits the
            parameter with this prior, and only a larger change is named.
        role: A "strength" at its nominal value switches the effect off; a "shape" has no influence
            while all strengths are nominal.
        faults: Side of nominal on which faults lie; on the other side the machine is better.
        limit_of: "command" or "force" if the parameter limits the drive's command or force: nominal
            is then the largest recorded value, and trials are shares of it; "" for neither.
        inverse: Whether the motion changes in proportion to 1/value, for example to the lag
            1/bandwidth or to the compliance 1/stiffness.
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
        """Returns a shape parameter without trials."""
        return cls(name, unit, nominal=nominal, lower=lower, upper=upper, role="shape")

    @property
    def scale(self) -> float:
        """Least distance of a trial value from nominal, the unit of steps; 1/unit if `inverse`."""
        steps = [abs(self.from_nominal(t)) for t in self.trials if t != self.nominal]
        return min(steps) if steps else 0.1 * (self.upper - self.lower)

    def from_nominal(self, value: float, nominal: float | None = None) -> float:
        """Returns value minus nominal, or 1/nominal - 1/value if `inverse`."""
        own = self.nominal if nominal is None else nominal
        return 1.0 / own - 1.0 / value if self.inverse else value - own

    def moved(self, value: float, by: float) -> float:
        """Returns a value increased by a number `by` of smallest trials."""
        if not self.inverse:
            return value + by * self.scale
        return 1.0 / min(max(1.0 / value - by * self.scale, 1.0 / self.upper), 1.0 / self.lower)

    def step(self, value: float) -> float:
        """Returns the change of a value by one smallest trial."""
        return self.scale * value**2 if self.inverse else self.scale

    def usual(self, own: float) -> tuple[float, float]:
        """Returns the 95 % range of good machines whose model has the value `own`."""
        return own - 1.96 * self.tolerance, own + 1.96 * self.tolerance

    @property
    def slowest(self) -> float:
        """Longest delay or lag among the trials [s]; infinite if the unit is neither s nor Hz."""
        if self.unit == "Hz":
            return float(1.0 / (2.0 * np.pi * min(self.trials)))
        return max(self.trials) if self.unit == "s" else np.inf

    def stretched(self, shortest: float) -> "EffectParameter":
        """Scales up trials and upper bound of a time until no trial is below `shortest` [s]."""
        if self.unit != "s" or not self.trials or self.scale >= shortest:
            return self
        factor = shortest / self.scale
        trials = tuple(factor * trial for trial in self.trials)
        return replace(self, upper=factor * self.upper, trials=trials)

    def departure(self, value: float, nominal: float) -> float:
        """Returns the magnitude of a departure from `nominal`, in smallest trials."""
        return abs(self.from_nominal(value, nominal)) / self.scale


class Effect(ABC):
    """A physical cause that a simulation may lack.

    Subclasses keep no state. Those with a table of parameters derive from `TableEffect`.

    Attributes:
        name: Name in reports. Variants of an effect (for cylinders, for plain joints) may share a
            name if no element of a machine can have two of the variants.
        group: Heading under which it is listed.
        physics: One sentence on the mechanism, with the equation.
        source: Source of equation and bounds.
        excitation: Motion that a recording must contain to show it.
        order: Effects are applied by rising order, then by name.
        gradual: Whether small values change little; false if, say, a moving part is inserted.
        nameable: Whether a diagnosis searches for the effect. Otherwise good machines differ in it
            (in the form of a law), so that it is fitted with all other effects but never named.
        on_bodies: Whether its elements are bodies, whose names may equal names of joints.
        contains: Simpler effects that are special cases of this one. If a simpler effect at the
            same joint fits equally well, the simpler one is named.
        by_direction: Pairs of parameters for the two directions. If the machine's laws differ from
            the model's, the effect is named only if the parameters of a pair depart differently.
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
        """Returns the joints, actuators, bodies or plugin instances that can have the effect."""

    @abstractmethod
    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """Returns the effect's parameters on an element, strengths first."""

    @abstractmethod
    def apply(self, change: Change, element: str, values: Values) -> None:
        """Records the effect of the values in `change`; nominal values must change nothing."""

    def guess(self, left: ForceLeft) -> Values | None:
        """Estimates start values of shape parameters from residual forces; None if it cannot."""
        return None

    def write(self, change: Change, element: str, values: Values) -> None:
        """Records the edits and parameters by which the file of an improved model gets the values.

        These edits differ from the edits of `apply` for command and sensor paths, which replays
        apply to samples, and for effects that an MJCF attribute nearly reproduces.
        """
        self.apply(change, element, values)


# Function of machine and element that returns a parameter of an effect.
Row = Callable[[Machine, str], EffectParameter]


class TableEffect(Effect):
    """Base of effects with a table of parameters."""

    #: Parameters: each is equal for all elements, or a function of machine and element.
    rows: ClassVar[tuple[EffectParameter | Row, ...]] = ()

    def parameters(self, machine: Machine, element: str) -> tuple[EffectParameter, ...]:
        """Returns the parameters on an element."""
        return tuple(row(machine, element) if callable(row) else row for row in self.rows)


_REGISTRY: dict[tuple[str, str], Effect] = {}
_plugins_loaded = False


def register_effect(effect: type[Effect]) -> type[Effect]:
    """Registers an effect that the diagnosis can name; a class decorator.

    Raises:
        LeglabError: A class attribute is missing.
    """
    for attribute in ("name", "group", "physics", "source", "excitation"):
        if not getattr(effect, attribute, ""):
            text = f"effect class {effect.__qualname__} has no {attribute!r}"
            raise SettingsError(text, given=effect.__qualname__)
    plugins.note(effect.__module__)
    _REGISTRY[effect.name, effect.__qualname__] = effect()
    return effect


def all_effects() -> tuple[Effect, ...]:
    """Returns all effects, ordered by name."""
    global _plugins_loaded
    if not _plugins_loaded:
        _plugins_loaded = True
        plugins.load_entry_points("effects", lambda name: any(n == name for n, _ in _REGISTRY))
    return tuple(effect for _, effect in sorted(_REGISTRY.items()))
