"""Effects: physical causes with parameters that change a simulation, and their registry."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, replace
from typing import ClassVar, Literal

import mujoco
import numpy as np

from leglab.base import plugins
from leglab.base.errors import LeglabError
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
        unit: SI unit.
        nominal: Value at which the effect changes nothing, or, of a shape, where fits start.
        lower: Smallest value that makes sense, same unit.
        upper: Largest value that makes sense, same unit.
        trials: Values that screening tries; a few, from barely noticeable to severe, on each side
            that is possible. Those of a shape are not tried, they say by what steps it matters.
        tolerance: Standard deviation that is normal between two good machines, same unit. Above
            zero the baseline refits the parameter under this prior, and only a change beyond it
            is named. 0: anything that can be told from noise is named.
        role: A "strength" at its nominal value switches the effect off; a "shape" means nothing
            while all strengths are nominal.
        faults: On which side of the nominal value they lie. Beyond it on the other side is a
            better part than the model's: edges do not get sharper as they wear.
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

    def __post_init__(self) -> None:
        if not self.lower <= self.nominal <= self.upper:
            raise LeglabError(
                f"effect parameter {self.name!r}: nominal {self.nominal:g} lies outside "
                f"[{self.lower:g}, {self.upper:g}] {self.unit}"
            )

    @property
    def scale(self) -> float:
        """Distance from nominal that matters: what finite differences and fits step by."""
        steps = [abs(trial - self.nominal) for trial in self.trials if trial != self.nominal]
        return min(steps) if steps else 0.1 * (self.upper - self.lower)

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
        """How severe a value is: 1 for a barely noticeable distance from `nominal`, more beyond.

        Distance over the smallest trial's, or the trials that it passes where these are more: a
        bandwidth can fall by no more than itself.
        """
        distance = abs(value - nominal)
        side = sorted(
            abs(t - self.nominal) for t in self.trials if (t - self.nominal) * (value - nominal) > 0
        )
        passed = np.interp(distance, [0.0, *side], range(len(side) + 1)) if side else 0.0
        return max(distance / self.scale, float(passed))


class Effect(ABC):
    """A physical cause that a simulation may lack.

    Subclasses set the class attributes, say on which elements of a machine they can sit, with
    which parameters, and apply values to a `Change`. They keep no state of their own. Effects
    on cylinders, joints and commands have bases: `CylinderEffect`, `JointEffect`, `CommandEffect`.

    Attributes:
        name: As reports print it; variants (on a cylinder, on a plain joint) may share it, as long
            as no element of a machine is served by two of them.
        group: Heading under which it is listed.
        physics: One sentence: what happens, with the equation.
        source: Where equation and bounds come from.
        excitation: Motion that a recording must contain to show it.
        order: Effects are applied by rising order, then by name: one that builds on parameters
            which others change comes later.
        gradual: Whether a little of it changes little. A little of an effect that inserts a moving
            part does: no fit of something else can let it follow.
        nameable: Whether a diagnosis looks for it. What is not, the shape of a law in which good
            machines differ, is fitted on machines that differ from their model everywhere.
        contains: Names of simpler effects that are special cases of it. Where one of them at the
            same joint does as well, it is that one.
        by_direction: Pairs of parameters, one a direction, that it says depart differently. On a
            machine whose laws are not the model's it has its name only where they do.
    """

    name: ClassVar[str]
    group: ClassVar[Group]
    physics: ClassVar[str]
    source: ClassVar[str]
    excitation: ClassVar[str]
    order: ClassVar[int] = 0
    gradual: ClassVar[bool] = True
    nameable: ClassVar[bool] = True
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

    def guesses(self, machine: Machine, element: str, left: ForceLeft) -> tuple[Values, ...]:
        """Values to screen instead of the trials, from the force left over on the element's joint.

        Only an effect whose shape a few trials cannot find (a period) needs to override this.
        """
        del machine, element, left
        return ()

    def write(self, spec: mujoco.MjSpec, machine: Machine, element: str, values: Values) -> None:
        """Writes what `apply` does beside spec edits and plugin parameters into a patched model.

        Those two are written for every effect. Only an effect on the command or sensor path needs
        to override this.
        """
        del spec, machine, element, values


_REGISTRY: dict[tuple[str, str], Effect] = {}
_plugins_loaded = False


def register_effect(effect: type[Effect]) -> type[Effect]:
    """Adds an effect to those that the diagnosis can name; a class decorator.

    Raises:
        LeglabError: A class attribute is missing.
    """
    for attribute in ("name", "group", "physics", "source", "excitation"):
        if not getattr(effect, attribute, ""):
            raise LeglabError(f"effect class {effect.__qualname__} has no {attribute!r}")
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
