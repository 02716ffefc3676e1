"""Scenarios: the reference motion of a run and the parameter changes of the machine during it."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from glob import escape
from typing import Any, NamedTuple

from leglab.base.errors import SettingsError
from leglab.base.registry import Registry

_KINDS = ("scale", "set")

# Returns the values of a model parameter for the elements that a scenario changes; empty if none.
Healthy = Callable[[str], tuple[float, ...]]


@dataclass(frozen=True, kw_only=True)
class ParameterChange:
    """A physical parameter that changes once, in a step or along a straight ramp.

    Attributes:
        parameter: Name of the parameter, for instance "internal_leakage".
        element: Elements that change: a name or a pattern such as "*" or "ankle_*", or several,
            separated by commas; elements that match a pattern after "!" are excluded.
        kind: "scale": the value is a factor on the previous value; "set": it is the new value.
        value: Factor [1], or value in the parameter's own unit.
        start: Start time of the change [s].
        ramp_duration: Duration of the change [s]; 0 is a step.
        optional: Whether the change is skipped on a machine without the parameter.
        fallback: Whether, on a machine without such an element, the last element that has the
            parameter changes instead: the outermost body or joint.
    """

    parameter: str
    element: str = "*"
    kind: str = "scale"
    value: float
    start: float
    ramp_duration: float = 0.0
    optional: bool = False
    fallback: bool = False

    def __post_init__(self) -> None:
        where = f"change of {self.parameter!r}"
        if self.kind not in _KINDS:
            text = f"{where}: unknown kind {self.kind!r}: choose {' or '.join(_KINDS)}"
            raise SettingsError(text, given=self.kind, allowed=_KINDS)
        if not math.isfinite(self.value):
            text = f"{where}: value {self.value!r} is not finite"
            raise SettingsError(text, given=self.value, allowed="a finite number")
        if self.kind == "scale" and self.value < 0:
            text = f"{where}: factor {self.value!r} is negative, allowed is "
            raise SettingsError(text, given=self.value, allowed=">= 0")
        for name in ("start", "ramp_duration"):
            seconds = getattr(self, name)
            if not (seconds >= 0 and math.isfinite(seconds)):
                text = f"{where}: {name} {seconds!r} s is not allowed, must be "
                raise SettingsError(text, given=seconds, allowed=">= 0")

    @property
    def end(self) -> float:
        """End time of the change [s]."""
        return self.start + self.ramp_duration

    def applies_to(self, element: str) -> bool:
        """Tests whether an element changes."""
        patterns = self.element.split(",")
        left_out = any(fnmatchcase(element, p[1:]) for p in patterns if p.startswith("!"))
        return not left_out and any(fnmatchcase(element, p) for p in patterns)

    def value_at(self, time: float, before: float) -> float:
        """Returns the parameter's value at a time.

        Args:
            time: Time [s].
            before: Value before the change, in the parameter's unit.
        """
        after = before * self.value if self.kind == "scale" else self.value
        if time >= self.end:
            return after
        if time <= self.start:
            return before
        share = (time - self.start) / self.ramp_duration
        return after if share == 1.0 else before + share * (after - before)


@dataclass(frozen=True, kw_only=True)
class Phase:
    """A named time interval of a run."""

    name: str  #: "whole", or "before", "during" and "after" a change
    start: float  #: First time [s]
    end: float  #: Last time [s]; excluded if another phase follows


@dataclass(frozen=True, kw_only=True)
class Severity:
    """Allowed magnitudes of a scenario's change.

    Attributes:
        meaning: Meaning of the number, with its unit, for instance "internal leakage ratio".
        default: Default magnitude.
        lowest: Smallest allowed magnitude.
        highest: Largest allowed magnitude.
    """

    meaning: str
    default: float
    lowest: float
    highest: float


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options from which a scenario is built.

    Attributes:
        duration: Duration of the run [s].
        severity: Magnitude of the change, in the scenario's unit; NaN if it has no severity.
        ramp_duration: Duration of the change [s]; 0 is a step.
        healthy: Function that returns values of model parameters; None without a model.
    """

    duration: float
    severity: float
    ramp_duration: float = 0.0
    healthy: Healthy | None = None

    @property
    def half(self) -> float:
        """Middle of the run [s]."""
        return self.duration / 2

    def set(
        self, parameter: str, value: float, element: str = "*", **where: bool
    ) -> ParameterChange:
        """Returns a change to a new value at the middle of the run.

        Args:
            parameter: Name of the parameter.
            value: New value, in the parameter's unit.
            element: Elements that change, as in `ParameterChange`.
            where: `optional` and `fallback` of the `ParameterChange`.
        """
        return ParameterChange(
            **where,
            parameter=parameter,
            element=element,
            kind="set",
            value=value,
            start=self.half,
            ramp_duration=self.ramp_duration,
        )

    def scale(
        self, parameter: str, factor: float, element: str = "*", **where: bool
    ) -> ParameterChange:
        """Returns a change by a factor at the middle of the run; other arguments as in `set`."""
        return replace(self.set(parameter, factor, element, **where), kind="scale")


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """Reference motion, duration and parameter changes of a run.

    Attributes:
        name: Name under which it is registered.
        summary: One line for listings and reports.
        duration: Duration [s].
        reference: Name of the reference trajectory, unless the user chooses another.
        reference_config: Settings of that trajectory.
        changes: Changes of the machine in the order of their start times. If two apply to the
            same parameter of an element, the second starts from the result of the first.
        severity: Magnitude of the changes; None if the scenario has no severity.
    """

    name: str
    summary: str = ""
    duration: float
    reference: str = "walking_stride"
    reference_config: Mapping[str, Any] = field(default_factory=dict)
    changes: tuple[ParameterChange, ...] = field(default=())
    severity: float | None = None

    def __post_init__(self) -> None:
        where = f"scenario {self.name!r}"
        if not (self.duration > 0 and math.isfinite(self.duration)):
            text = f"{where}: duration {self.duration!r} s is not allowed, must be "
            raise SettingsError(text, given=self.duration, allowed="> 0")
        for earlier, later in zip(self.changes, self.changes[1:], strict=False):
            if later.start < earlier.start:
                raise SettingsError(
                    f"{where}: the schedule goes backwards: {later.parameter!r} changes at "
                    f"{later.start:g} s, listed after {earlier.parameter!r} at {earlier.start:g} s",
                    given=later.start,
                )
        for change in self.changes:
            if change.end > self.duration:
                raise SettingsError(
                    f"{where}: the change of {change.parameter!r} lasts until {change.end:g} s, "
                    f"the run ends at {self.duration:g} s",
                    given=change.end,
                )

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Start and end times of all changes [s], sorted, without duplicates."""
        times = {t for change in self.changes for t in (change.start, change.end)}
        return tuple(sorted(times))

    @property
    def phases(self) -> tuple[Phase, ...]:
        """Phases of the run: "before", "during" and "after" the changes, or "whole" without any.

        "before" ends at the start of the first change, "after" starts at the end of the last. A
        phase without duration is left out, such as "during" for a single step.
        """
        if not self.changes:
            return (Phase(name="whole", start=0.0, end=self.duration),)
        names = ("before", "during", "after")
        edges = (0.0, self.breakpoints[0], self.breakpoints[-1], self.duration)
        return tuple(
            Phase(name=name, start=start, end=end)
            for name, start, end in zip(names, edges, edges[1:], strict=False)
            if start < end
        )

    def changed_from_start(self) -> "Scenario":
        """Returns the scenario with all changes complete from the start of the run."""
        changes = tuple(replace(c, start=0.0, ramp_duration=0.0) for c in self.changes)
        return replace(self, changes=changes)

    def shifted(self, share: float) -> "Scenario":
        """Returns the scenario with its changes shifted in time.

        Args:
            share: Shift as a share in [-1, 1] of the largest one: a tenth of the duration, or less
                if a change would leave the run. The shift is rounded to a millisecond. Changes
                that start at time 0 are not shifted.
        """
        if not self.changes or self.breakpoints[0] == 0:
            return self
        room = (self.breakpoints[0], self.duration - self.breakpoints[-1])
        shift = round(share * min(self.duration / 10, room[share > 0]), 3)
        return replace(self, changes=tuple(replace(c, start=c.start + shift) for c in self.changes))

    def value_at(self, time: float, parameter: str, element: str, nominal: float) -> float:
        """Returns the value of a parameter of one element.

        Args:
            time: Time [s].
            parameter: Name of the parameter.
            element: Name of the element.
            nominal: Value in the unchanged machine, in the parameter's unit.
        """
        value = nominal
        for change in self.changes:
            if change.parameter == parameter and change.applies_to(element):
                value = change.value_at(time, value)
        return value

    def moving(self, previous: float, time: float) -> tuple[ParameterChange, ...]:
        """Returns the changes whose value may change between the times `previous` and `time` [s].

        A simulation writes only these parameters; before its first step `previous` is -inf.
        """
        return tuple(c for c in self.changes if c.start <= time and previous < c.end)


# Builds the changes of a scenario from its options.
Builder = Callable[[Options], tuple[ParameterChange, ...]]


class _Entry(NamedTuple):
    build: Builder
    summary: str
    duration: float
    reference: str
    reference_config: Mapping[str, Any]
    severity: Severity | Callable[[Healthy | None], Severity] | None
    per_joint: bool

    def severity_in(self, healthy: Healthy | None) -> Severity | None:
        """Returns the allowed magnitudes of the change on a machine."""
        return self.severity(healthy) if callable(self.severity) else self.severity


SCENARIOS: Registry[_Entry] = Registry("scenario")


def register_scenario(
    name: str,
    *,
    summary: str,
    duration: float = 20.0,
    reference: str = "walking_stride",
    reference_config: Mapping[str, Any] | None = None,
    severity: Severity | Callable[[Healthy | None], Severity] | None = None,
    per_joint: bool = False,
) -> Callable[[Builder], Builder]:
    """Registers the decorated builder of changes under a name.

    Args:
        name: Name by which users select it.
        summary: One line for listings and reports.
        duration: Default duration [s].
        reference: Default reference trajectory.
        reference_config: Settings of that trajectory; None for its defaults.
        severity: Allowed magnitudes of the change, or a function that returns them for the values
            of a model; None if the magnitude is fixed.
        per_joint: Whether the change can apply to the cylinder, spring or encoder of one joint
            only; oil and supply are common to all.
    """

    def register(build: Builder) -> Builder:
        own = reference_config or {}
        entry = _Entry(build, summary, duration, reference, own, severity, per_joint)
        SCENARIOS.add(name, entry, build)
        return build

    return register


def get_scenario(
    name: str,
    *,
    duration: float | None = None,
    severity: float | None = None,
    ramp_duration: float = 0.0,
    element: str | None = None,
    healthy: Healthy | None = None,
) -> Scenario:
    """Builds a scenario.

    Args:
        name: One of `scenario_names()`.
        duration: Duration [s]; None for the scenario's default.
        severity: Magnitude of the change; None for the scenario's default.
        ramp_duration: Duration of the change [s]; 0 is a step.
        element: The only joint whose cylinder, spring and encoder change; None for all elements
            that the scenario changes.
        healthy: Function that returns parameter values of the machine; None for the plugins'
            defaults, which the shipped models have.

    Raises:
        SettingsError: The name is unknown, or an option is not allowed for this scenario.
    """
    entry = SCENARIOS.get(name)
    if element is not None and not entry.per_joint:
        raise SettingsError(
            f"scenario {name!r} does not happen to one joint alone, but element {element!r} was "
            "given; these do: ",
            given=name,
            allowed=(name for name in SCENARIOS.names() if SCENARIOS.get(name).per_joint),
        )
    chosen = _choose_severity(name, entry.severity_in(healthy), severity)
    scenario = Scenario(  # Rejects an invalid duration before the changes are built from it.
        name=name,
        summary=entry.summary,
        duration=entry.duration if duration is None else duration,
        reference=entry.reference,
        reference_config=entry.reference_config,
        severity=chosen,
    )
    options = Options(
        duration=scenario.duration,
        severity=math.nan if chosen is None else chosen,
        ramp_duration=ramp_duration,
        healthy=healthy,
    )
    changes = entry.build(options)
    if element is not None:
        changes = of_joint(changes, element)
    if ramp_duration and not changes:
        text = f"scenario {name!r} changes nothing, so it has no ramp_duration"
        raise SettingsError(text, given=ramp_duration)
    return replace(scenario, changes=changes)


def of_joint(changes: tuple[ParameterChange, ...], joint: str) -> tuple[ParameterChange, ...]:
    """Returns the changes restricted to the elements of one joint."""
    own = joint_pattern(joint)
    return tuple(replace(change, element=own, fallback=False) for change in changes)


def joint_pattern(joint: str) -> str:
    """Returns the pattern of a joint's elements: its name, and names that start with it and "_"."""
    return f"{escape(joint)},{escape(joint)}_*"


def scenario_names() -> tuple[str, ...]:
    """Returns the names of all scenarios."""
    return SCENARIOS.names()


def scenario_summary(name: str) -> str:
    """Returns the one-line description of a scenario."""
    return SCENARIOS.get(name).summary


def scenario_severity(name: str, healthy: Healthy | None = None) -> Severity | None:
    """Returns the allowed magnitudes of a scenario's change; None if the magnitude is fixed.

    Args:
        name: Name of the scenario.
        healthy: As in `get_scenario`.
    """
    return SCENARIOS.get(name).severity_in(healthy)


def scenario_per_joint(name: str) -> bool:
    """Tests whether a scenario's change can be restricted to one joint."""
    return SCENARIOS.get(name).per_joint


def _choose_severity(name: str, severity: Severity | None, asked: float | None) -> float | None:
    if severity is None:
        if asked is not None:
            text = f"scenario {name!r} has no severity, but {asked!r} was given"
            raise SettingsError(text, given=asked)
        return None
    if asked is None:
        return severity.default
    if not severity.lowest <= asked <= severity.highest:
        allowed = f"[{severity.lowest:g}, {severity.highest:g}]"
        text = f"scenario {name!r}: severity {asked!r} is outside {allowed}; it is the "
        raise SettingsError(text + severity.meaning, given=asked, allowed=allowed)
    return asked
