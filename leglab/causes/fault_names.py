"""Records of the faults and the slow wear that a controller reports, and their texts.

A controller creates the records during a run; `metrics.json` holds them unchanged.
"""

from typing import Annotated

from pydantic import BaseModel, Field, FiniteFloat, StringConstraints

from leglab.causes.table import effect_of

# Element of a fault that all cylinders share, or that belongs to no single cylinder.
ALL = "all"

# Name of a change that no fault of the bank explains.
UNKNOWN = "unknown change"

Name = Annotated[str, StringConstraints(min_length=1, max_length=500)]


class FaultRival(BaseModel):
    """A fault that may be the one in place of what is named."""

    fault: Name  #: Its name
    element: Name  #: Joint, or "all"
    size: FiniteFloat  #: In the fault's own unit
    confidence: FiniteFloat  #: Its probability among all of the bank [1]


class NamedFault(BaseModel):
    """A fault by its name, as a controller tells it at one time."""

    time: FiniteFloat  #: When it was said first [s]
    fault: Name  #: Its name in the bank, "oil_temperature", or "unknown change"
    #: Joint whose cylinder or spring has it, or "all"; joints by commas where unknown.
    element: Name
    size: FiniteFloat | None = None  #: In the fault's own unit; None where unknown
    #: Lower end of the size's 90 % interval; of a condition that joints differ in, the lowest.
    low: FiniteFloat | None = None
    high: FiniteFloat | None = None  #: Upper end; the highest
    meaning: str = ""  #: What the size says, with its unit
    #: Probability of fault and element among all of the bank [1]; of an unknown change, the share
    #: of the squared error that the best fault of the bank leaves.
    confidence: FiniteFloat
    #: Share of the weighted squared error beyond a sound machine's that it takes away [1]; of an
    #: unknown change, what the best fault would.
    explained: FiniteFloat
    #: Faults that are hardly less probable, the most probable first.
    rivals: list[FaultRival] = Field(default_factory=list)

    @property
    def key(self) -> tuple[str, str]:
        """Pair (fault, element), which identifies the name."""
        return self.fault, self.element

    def elements(self, joints: tuple[str, ...]) -> list[bool]:
        """Tests for each joint whether the fault concerns it."""
        own = self.element.split(",")
        return [self.element == ALL or joint in own for joint in joints]

    def _short(self, size: str) -> str:
        where = "" if self.element == ALL else f"{self.element} "
        rivals = "".join(f" or {rival.fault}" for rival in self.rivals)
        return f"{where}{self.fault}{size}{rivals}".replace("_", " ")

    def _cause(self) -> str:
        effect = effect_of(self.fault)
        return f"{self.fault} [{effect}]" if effect else self.fault

    def _sized(self) -> str:
        """Formats magnitude, interval and meaning; empty if the magnitude is unknown."""
        if self.size is None:
            return ""
        inside = [] if self.low is None else [f"{self.low:.3g} to {self.high:.3g}"]
        inside += [self.meaning] if self.meaning else []
        return f" {self.size:.3g}" + (f" ({'; '.join(inside)})" if inside else "")

    def _probability(self) -> str:
        """Formats the probabilities of the fault and of its rivals."""
        text = f", {100 * self.confidence:.0f} %"
        for rival in self.rivals:
            where = "" if rival.element == self.element else f"{_place(rival.element)}: "
            text += f", or {where}{rival.fault} {rival.size:.3g}, {100 * rival.confidence:.0f} %"
        return text


def _place(element: str) -> str:
    return "all cylinders" if element == ALL else element


class FaultName(NamedFault):
    """Name of a change at once."""

    onset: FiniteFloat  #: When the change began [s]
    #: Onset of the change that this one takes back, all or in part [s]; None of a new one.
    undoes: FiniteFloat | None = None


class FaultEvent(BaseModel):
    """A change and what was said of it."""

    #: In the order in which they were said; a name follows where fault or element differ from the
    #: last one's, and the last one, in force, is kept up to date.
    names: Annotated[list[FaultName], Field(min_length=1)]
    #: When the last name was taken back [s]; None if it stands.
    withdrawn: FiniteFloat | None = None

    def short(self) -> str:
        """Formats the latest name in a few words, for figures: "knee seal wear 9.92, 100 %"."""
        name = self.names[-1]
        size = "" if name.size is None else f" {name.size:.3g}, {100 * name.confidence:.0f} %"
        if name.undoes is not None:
            size = f" back to{size}" if size else " undone"
        return name._short(size)

    def told(self) -> str:
        """Formats the latest name in one line: element, cause, magnitude, probability and times."""
        name = self.names[-1]
        line = f"{_place(name.element)}: {name._cause()}{name._sized()}"
        if name.size is not None:
            line += name._probability()
        if name.undoes is not None:
            line += f", goes back on what began at {name.undoes:.2f} s"
        line += f", since {name.onset:.2f} s, said at {name.time:.2f} s"
        if self.withdrawn is not None:
            line += f", withdrawn at {self.withdrawn:.2f} s"
        return line


class FaultTrend(NamedFault):
    """A slow change of the machine."""

    #: Whether a sound machine passes through it, as through temperatures of the oil.
    condition: bool = False
    since: FiniteFloat  #: When it began [s]
    seen: FiniteFloat  #: When it was looked at last, and had its size [s]
    #: Growth of the size in an hour; None where too few looks show it.
    rate: FiniteFloat | None = None
    rate_low: FiniteFloat | None = None  #: Lower end of its 90 % interval
    rate_high: FiniteFloat | None = None  #: Upper end
    #: Size at which the part is worn out; None for a condition.
    end_of_life: FiniteFloat | None = None
    #: Until the line of the sizes is there, from `seen` on [s]; None where it is not on its way
    #: there.
    remaining: FiniteFloat | None = None
    remaining_low: FiniteFloat | None = None  #: Lower end of its 90 % interval [s]
    #: Upper end; None where growth may as well have ended.
    remaining_high: FiniteFloat | None = None

    def short(self) -> str:
        """Formats fault, magnitude and life left, briefly: "knee seal wear 8.54, left 9.2 min"."""
        size = "" if self.size is None else f" {self.size:.3g}"
        left = "" if self.remaining is None else f", left {_duration(self.remaining)}"
        return self._short(size + left)

    def told(self) -> str:
        """Formats the trend in one line: element, cause, latest magnitude, rate, remaining life."""
        where = _place(self.element)
        since = f"since {self.since:.0f} s, said at {self.time:.0f} s"
        if self.size is None:
            return f"{where}: slow {self.fault}, {since}"
        line = f"{where}: {self._cause()}{self._sized()} at {self.seen:.0f} s, slowly {since}"
        line += self._probability()
        if self.condition:
            return line + ("; a condition" if self.rivals else "; a condition, no fault")
        if self.rate is not None:
            line += f", {self.rate:+.3g} an hour"
        if self.remaining is not None and self.remaining_low is not None:
            last = "no end" if self.remaining_high is None else _duration(self.remaining_high)
            line += (
                f"; at {self.end_of_life:g} in {_duration(self.remaining)} "
                f"({_duration(self.remaining_low)} to {last})"
            )
        return line


def _duration(seconds: float) -> str:
    return f"{seconds / 3600:.3g} h" if seconds >= 3600 else f"{seconds / 60:.3g} min"
