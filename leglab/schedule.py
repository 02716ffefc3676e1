"""What happens when: changes of physical parameters, and the phases they divide a run into."""

import math
from dataclasses import dataclass
from fnmatch import fnmatchcase

from leglab.errors import LeglabError

_KINDS = ("scale", "set")


@dataclass(frozen=True, kw_only=True)
class ParameterChange:
    """A physical parameter that changes once, in a step or along a straight ramp.

    Attributes:
        parameter: Name of the parameter, for instance "internal_leakage".
        element: Which elements change: a name or a pattern such as "*" or "ankle_*".
        kind: "scale": the value is a factor on what the parameter was; "set": it is the new value.
        value: Factor [1], or value in the parameter's own unit.
        start: When the change begins [s].
        ramp_duration: How long it takes [s]; 0 is a step.
    """

    parameter: str
    element: str = "*"
    kind: str = "scale"
    value: float
    start: float
    ramp_duration: float = 0.0

    def __post_init__(self) -> None:
        where = f"change of {self.parameter!r}"
        if self.kind not in _KINDS:
            raise LeglabError(f"{where}: unknown kind {self.kind!r}: choose {' or '.join(_KINDS)}")
        if not math.isfinite(self.value):
            raise LeglabError(f"{where}: value {self.value!r} is not finite")
        if self.kind == "scale" and self.value < 0:
            raise LeglabError(f"{where}: factor {self.value!r} is negative, allowed is >= 0")
        for name in ("start", "ramp_duration"):
            seconds = getattr(self, name)
            if not (seconds >= 0 and math.isfinite(seconds)):
                raise LeglabError(f"{where}: {name} {seconds!r} s is not allowed, must be >= 0")

    @property
    def end(self) -> float:
        """When the change is complete [s]."""
        return self.start + self.ramp_duration

    def applies_to(self, element: str) -> bool:
        """Says whether an element changes."""
        return fnmatchcase(element, self.element)

    def value_at(self, time: float, before: float) -> float:
        """Returns the parameter's value.

        Args:
            time: Time [s].
            before: Its value before the change, in its own unit.
        """
        if time >= self.end:
            share = 1.0
        elif time <= self.start:
            share = 0.0
        else:
            share = (time - self.start) / self.ramp_duration
        if share == 0.0:
            return before
        after = before * self.value if self.kind == "scale" else self.value
        return after if share == 1.0 else before + share * (after - before)


@dataclass(frozen=True, kw_only=True)
class Phase:
    """A named part of a run.

    Attributes:
        name: "whole", or "before", "during" and "after" a change.
        start: First time [s].
        end: Last time [s], not included where another phase follows.
    """

    name: str
    start: float
    end: float
